"""Many photographs: what is written, what is done again, and what is passed over."""

import json
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path

import hypothesis.strategies as st
import pytest
import torch
from hypothesis import given
from PIL import Image
from skimage.data import astronaut

from skylight.cli import main
from skylight.errors import InputError, OutputError
from skylight.estimation import _folder as batch
from skylight.estimation._folder import estimate_folder, time_left_s
from skylight.estimation._manifest import (
    MANIFEST,
    Entry,
    folder_name,
    left_out,
    list_photos,
    read_manifest,
)
from skylight.estimation._photos import Pictures
from skylight.estimation._settings import EstimateSettings
from skylight.imaging._photo import PHOTO_SUFFIXES
from skylight.io._files import read_environment_map
from skylight.models._ground import KnownGround
from skylight.work._resumable import locked
from tests.estimated import RESULTS
from tests.sunny_face import sunny_estimate, sunny_face

SH9 = EstimateSettings(light="sh9")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """(photos, out) of one run by the command: one that goes well and two that do not."""
    folder = tmp_path_factory.mktemp("batch")
    photos, out = folder / "photos", folder / "out"
    (photos / "more").mkdir(parents=True)
    Image.fromarray(sunny_face(40.0, 50.0).encoded).save(photos / "me.png")
    Image.new("RGB", (64, 64), (200, 120, 40)).save(photos / "more" / "no_face.png")
    (photos / "bad.png").write_bytes(b"nothing")
    arguments = ["estimate", str(photos), "--light", "sh9", "--out", str(out), "--workers", "2"]
    assert main(arguments) == 0
    return photos, out


@pytest.fixture
def copied(finished: tuple[Path, Path], tmp_path: Path) -> tuple[Path, Path]:
    photos, out = (shutil.copytree(one, tmp_path / one.name) for one in finished)
    return photos, out


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Work is done in this process, for tests of what is done; the sources that were."""
    sources: list[str] = []

    def share(work: Callable, arguments: Iterable[tuple], **_: object) -> Iterable:
        for one in arguments:
            sources.append(one[0].source)
            yield work(*one)

    monkeypatch.setattr(batch, "share_work", share)
    return sources


def lines(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / MANIFEST).read_text().splitlines()]


class TestResults:
    def test_every_photo_has_a_line_and_the_good_ones_a_folder(
        self, finished: tuple[Path, Path]
    ) -> None:
        _, out = finished
        there = {line["source"]: line for line in lines(out)}
        assert len(there) == len(lines(out))
        assert {source: line["status"] for source, line in there.items()} == {
            "bad.png": "failed",
            "me.png": "done",
            "more/no_face.png": "failed",
        }
        assert there["bad.png"]["error"].startswith("bad.png: no picture known here")
        assert there["more/no_face.png"]["error"].startswith("more/no_face.png: no face")
        assert {p.name for p in out.iterdir()} == {
            ".lock",
            MANIFEST,
            "settings.json",
            "me_png",
            "more",
        }
        assert {p.name for p in (out / "me_png").iterdir()} == RESULTS
        assert list((out / "more").iterdir()) == []

    def test_lines_say_what_the_results_say(self, finished: tuple[Path, Path]) -> None:
        _, out = finished
        for line in lines(out):
            if line["status"] == "done":
                told = json.loads((out / line["results"] / "estimate.json").read_text())
                assert line["sun"] == told["sun"]
                assert line["verdict"] == told["verdict"]["summary"]
                assert line["versions"] == told["versions"]
                assert told["sources"] == [line["source"]]
                assert line["seconds"] > sum(told["seconds"].values())

    def test_a_photo_gets_the_light_that_it_gets_alone(self, finished: tuple[Path, Path]) -> None:
        _, out = finished
        written = read_environment_map(out / "me_png" / "probe.exr").radiance
        alone = sunny_estimate().probe.radiance
        torch.testing.assert_close(written, alone, rtol=1e-3, atol=1e-4)


class TestGoingOn:
    def test_nothing_is_done_twice(
        self, copied: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
    ) -> None:
        photos, out = copied
        before = {path: path.stat().st_mtime_ns for path in out.glob("me_*/*")}
        arguments = ["estimate", str(photos), "--light", "sh9", "--out", str(out)]
        assert main(arguments) == 0
        told = capsys.readouterr()
        assert told.out == f"{out}: 1 of 3 pictures done, see {MANIFEST}\n"
        assert [line.split(":")[:3] for line in told.err.splitlines()] == [
            ["skylight", " failed", " bad.png"],
            ["skylight", " failed", " more/no_face.png"],
        ]
        assert all(path.stat().st_mtime_ns == then for path, then in before.items())

    def test_failed_ones_are_tried_again_when_asked(
        self, copied: tuple[Path, Path], here: list[str]
    ) -> None:
        photos, out = copied
        estimate_folder(photos, out, SH9)
        assert here == []
        estimate_folder(photos, out, SH9, retry_failed=True)
        assert here == ["bad.png", "more/no_face.png"]
        assert sorted(line["source"] for line in lines(out)) == list_photos(photos, out)

    def test_a_changed_photo_is_done_again(
        self, copied: tuple[Path, Path], here: list[str]
    ) -> None:
        photos, out = copied
        (photos / "bad.png").write_bytes(b"nothing else")
        (photos / "me.png").write_bytes(b"nothing any more")
        entries = estimate_folder(photos, out, SH9)
        assert here == ["bad.png", "me.png"]
        assert [entry.status for entry in entries] == ["failed", "failed", "failed"]
        assert sorted(line["source"] for line in lines(out)) == list_photos(photos, out)

    @pytest.mark.parametrize("kept", [0.01, 0.5, 0.99, 1.0])
    def test_a_torn_last_line_is_mended(
        self, copied: tuple[Path, Path], here: list[str], kept: float
    ) -> None:
        photos, out = copied
        (photos / "me.png").unlink()
        whole = (out / MANIFEST).read_bytes()
        bad = next(line for line in whole.splitlines(keepends=True) if b'"bad.png"' in line)
        rest = whole.replace(bad, b"")
        cut = rest + bad[: int(kept * (len(bad) - 1))]
        (out / MANIFEST).write_bytes(cut)
        estimate_folder(photos, out, SH9)
        assert here == ["bad.png"]
        assert (out / MANIFEST).read_bytes().startswith(rest)
        assert len(lines(out)) == 3

    @pytest.mark.parametrize(
        "damage",
        [
            "{",
            "[" * 10**5 + "\n",
            '{"source": [], "sha256": "", "settings": "", "status": "done"}\n',
        ],
    )
    def test_another_damaged_line_is_named(self, copied: tuple[Path, Path], damage: str) -> None:
        photos, out = copied
        text = (out / MANIFEST).read_text()
        (out / MANIFEST).write_text(damage + text)
        with pytest.raises(InputError, match=r"manifest\.jsonl, line 1: ") as caught:
            estimate_folder(photos, out, SH9)
        assert "\n" not in str(caught.value)
        assert (out / MANIFEST).read_text() == damage + text

    def test_other_settings_want_another_folder(self, copied: tuple[Path, Path]) -> None:
        photos, out = copied
        with pytest.raises(InputError, match="other settings"):
            estimate_folder(photos, out, EstimateSettings(light="sh25"))

    def test_notes_tell_of_a_solver_that_is_not_the_usual_one(self) -> None:
        """Folders of runs before there was another go on."""
        assert "solver" not in EstimateSettings().facts()
        assert EstimateSettings(solver="thesis").facts()["solver"] == "thesis"
        with pytest.raises(InputError, match="not for sunsky"):
            EstimateSettings(solver="thesis", light="sunsky")

    def test_notes_tell_of_a_ground_that_is_known(self) -> None:
        assert "ground" not in EstimateSettings().facts()
        ground = KnownGround(albedo=(0.5, 0.4, 0.3))
        told = EstimateSettings(ground=ground).facts()["ground"]
        assert told == {"albedo": (0.5, 0.4, 0.3), "spread": 0.1}
        with pytest.raises(InputError, match="sh9 has none"):
            EstimateSettings(ground=ground, light="sh9")

    def test_what_a_killed_worker_left_goes(self, copied: tuple[Path, Path]) -> None:
        photos, out = copied
        (out / "me_png" / ".partial-abc").mkdir()
        (out / "me_png" / ".partial-abc" / "probe.exr").touch()
        (out / ".partial-def.jsonl").touch()
        estimate_folder(photos, out, SH9)
        assert not list(out.rglob(".partial-*"))

    def test_two_runs_do_not_share_a_folder(self, copied: tuple[Path, Path]) -> None:
        photos, out = copied
        with locked(out), pytest.raises(InputError, match="another run"):
            estimate_folder(photos, out, SH9)
        assert len(estimate_folder(photos, out, SH9)) == 3


class TestFailures:
    @pytest.fixture
    def one_photo(self, tmp_path: Path) -> tuple[Path, Path]:
        (tmp_path / "photos").mkdir()
        Image.fromarray(astronaut()[:256, 128:384]).save(tmp_path / "photos" / "me.png")
        (tmp_path / "photos" / "a.png").write_bytes(b"nothing")
        return tmp_path / "photos", tmp_path / "out"

    def test_a_full_disk_ends_the_run_and_is_no_photos_fault(
        self, one_photo: tuple[Path, Path], here: list[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def full(*_: object, **__: object) -> None:
            raise OutputError("cannot write probe.exr: No space left on device")

        monkeypatch.setattr(Pictures, "estimate", lambda _: None)
        monkeypatch.setattr(batch, "write_results", full)
        with pytest.raises(OutputError, match="No space left"):
            estimate_folder(*one_photo, SH9)
        assert here == ["a.png", "me.png"]
        assert [line["source"] for line in lines(one_photo[1])] == ["a.png"]
        assert not (one_photo[1] / "me_png").exists()

    def test_a_programming_error_is_the_photos_line(
        self, one_photo: tuple[Path, Path], here: list[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def broken(*_: object, **__: object) -> None:
            raise ValueError("no\nsecond line")

        monkeypatch.setattr(Pictures, "estimate", broken)
        entries = estimate_folder(*one_photo, SH9)
        assert entries[1].error == "me.png: internal error (ValueError: no)"

    def test_none_that_goes_well_is_an_error(
        self, one_photo: tuple[Path, Path], here: list[str], capsys: pytest.CaptureFixture[str]
    ) -> None:
        photos, out = one_photo
        (photos / "me.png").unlink()
        assert main(["estimate", str(photos), "--light", "sh9", "--out", str(out)]) == 2
        told = capsys.readouterr().err.splitlines()
        assert told[0].startswith("skylight: failed: a.png: no picture known here")
        assert told[1].startswith("skylight: no light from any of 1 pictures")

    def test_a_photo_that_kills_its_worker_is_passed_over(
        self, one_photo: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        photos, out = one_photo

        def share(work: object, arguments: list, lost: Callable, **_: object) -> Iterable[Entry]:
            return (lost(*one) for one in arguments)

        monkeypatch.setattr(batch, "share_work", share)
        entries = estimate_folder(photos, out, SH9)
        assert [entry.status for entry in entries] == ["failed", "failed"]
        assert "killed again and again" in entries[0].error
        assert list(read_manifest(out / MANIFEST)) == ["a.png", "me.png"]

    @pytest.mark.parametrize(
        ("options", "line"),
        [
            (["--workers", "2"], "--workers is for a folder"),
            (["--cluster", "tcp://there:1"], "--cluster is for a folder"),
            (["--retry-failed"], "--retry-failed is for a folder"),
            (["--batch", "2"], "--batch is for a folder"),
        ],
    )
    def test_options_of_folders_want_a_folder(
        self,
        one_photo: tuple[Path, Path],
        capsys: pytest.CaptureFixture[str],
        options: list[str],
        line: str,
    ) -> None:
        assert main(["estimate", str(one_photo[0] / "me.png"), *options]) == 2
        assert line in capsys.readouterr().err

    @pytest.mark.parametrize(
        ("options", "line"),
        [
            (["--shared-light"], "is a folder, whose pictures are estimated one by one"),
            (["--time", "2024-06-01T10:00Z"], "pictures were not all taken at one time"),
            (["--workers", "2", "--cluster", "tcp://there:1"], "contradict each other"),
            (["--batch", "0"], "--batch must be 1 or more, got 0"),
            (["--batch", "2", "--light", "sh9"], "sh9 is solved photo by photo"),
            (["--batch", "2"], "sphere is solved photo by photo; leave it out, or choose"),
            (
                ["--batch", "2", "--light", "sunsky", "--cluster", "tcp://there:1"],
                "contradict each other",
            ),
            (["--workers", "-1"], "--workers must be 0 or more"),
            (["--light", "sh9", "--model", "mine"], "sh9 has no trained model"),
        ],
    )
    def test_folders_refuse_what_does_not_fit(
        self,
        one_photo: tuple[Path, Path],
        capsys: pytest.CaptureFixture[str],
        options: list[str],
        line: str,
    ) -> None:
        photos, out = one_photo
        assert main(["estimate", str(photos), "--out", str(out), *options]) == 2
        assert line in capsys.readouterr().err
        assert not out.exists()


class TestPhotos:
    def test_pictures_are_listed_without_results_and_hidden_ones(self, tmp_path: Path) -> None:
        names = ["b.JPG", "a/c.exr", "a/notes.txt", ".hidden.png", ".trash/d.png", "B.tiff"]
        earlier = ["me_light/report.png", "me_light/estimate.json"]
        for name in (*names, *earlier, "light/b_JPG/report.png"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).touch()
        (tmp_path / "folder.png").mkdir()
        assert list_photos(tmp_path, tmp_path / "light") == ["B.tiff", "a/c.exr", "b.JPG"]
        assert list_photos(tmp_path / "a", tmp_path) == ["c.exr"]
        (tmp_path / "d.PSD").touch()
        (tmp_path / "README").touch()
        assert left_out(tmp_path, tmp_path / "light") == "1 without a suffix, 1 .txt, 1 .psd"
        assert left_out(tmp_path / "a", tmp_path) == "1 .txt"

    def test_no_pictures_is_an_error(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="no pictures"):
            list_photos(tmp_path, tmp_path / "out")
        with pytest.raises(InputError, match="another folder"):
            list_photos(tmp_path, tmp_path)

    # names that hold what the folders' names are made with
    names = st.builds(
        lambda stem, suffix: stem + suffix,
        st.text("ab_./", min_size=1, max_size=4),
        st.sampled_from(sorted(PHOTO_SUFFIXES)),
    )

    @given(st.lists(names, unique=True, min_size=2, max_size=2))
    def test_no_two_photos_share_a_folder(self, sources: list[str]) -> None:
        assert folder_name(sources[0]) != folder_name(sources[1])


def test_time_left_goes_by_the_median_photo_and_the_workers_at_work() -> None:
    # two workers were busy for 20 s: four photos of 10 s, so six more take 30 s
    assert time_left_s([10.0] * 4, 20.0, 6) == pytest.approx(30)
    # one that was refused at once changes next to nothing
    assert time_left_s([10.0] * 4 + [0.01], 20.0, 6) == pytest.approx(30, rel=0.01)
