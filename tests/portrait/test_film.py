"""Films relit: as steady as they are, every frame at its time, and what is wrong with films."""

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from skylight.cli import main
from skylight.errors import InputError, OutputError
from skylight.estimation.film._estimate import FilmSettings
from skylight.estimation.film._kept import KEPT_FILM, read_film, write_film
from skylight.faces._fit import FaceFit
from skylight.faces._observe import SKIN_SPECULAR
from skylight.imaging._film import film_frames
from skylight.imaging._film_writer import written_film
from skylight.io._tensors import read_tensors, write_tensors
from skylight.portrait import _film as film_module
from skylight.portrait._edge import EdgeLight
from skylight.portrait._film import relight_film, relit_frames
from skylight.portrait._keys import key_light
from skylight.portrait._moving import MovingHead
from skylight.portrait._poses import film_poses
from skylight.portrait._relit import Gains, Held, Portrait
from skylight.portrait._steady import SHARE, Carried
from skylight.portrait._surface import SKIN, PersonSurface, softened
from skylight.sphere._envmap import EnvironmentMap
from skylight.work._resumable import SETTINGS, keep_settings
from tests.filmed import FILM, frames, kept, moved, shift, written
from tests.films import with_frame_times, write_film as write_mpeg
from tests.sunny_face import direction, sunny_face

LEFT = Path("left.mkv")


def turned(degrees: float, fit: FaceFit) -> FaceFit:
    """The head turned about its own middle, to the picture's right."""
    angle = np.radians(degrees)
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    away = fit.vertices - fit.translation
    return replace(fit, rotation=turn @ fit.rotation, vertices=away @ turn.T + fit.translation)


class TestAHeadThatTurns:
    """Traced once, against rays cast anew in every pose."""

    @pytest.mark.parametrize(("degrees", "most"), [(0.0, 0.03), (25.0, 0.05)])
    def test_its_shading_is_that_of_its_pose(self, degrees: float, most: float) -> None:
        """Of a sun and sky; root mean square over the skin, relative to its mean."""
        fit = sunny_face(40.0, 50.0).truth
        light = EnvironmentMap(radiance=torch.full((64, 128, 3), 0.4)).with_light(
            direction(-40.0, 50.0), torch.full((3,), 2.0)
        )
        head = MovingHead.of(fit, np.zeros((256, 256), np.float32), face_px=48)
        pose = turned(degrees, fit)
        person, anew = head.at(pose, np.eye(3)), PersonSurface.of(pose, face_px=48)
        skin = np.isin(person.regions.numpy(), SKIN)
        height = min(person.surface.layout[0], anew.surface.layout[0])
        assert height > 60
        one, other = (
            cv2.resize(
                each.surface.image(
                    torch.cat(
                        [
                            each.shade(light, SKIN_SPECULAR).diffuse[:, :1],
                            torch.from_numpy(np.isin(each.regions.numpy(), SKIN))[:, None].float(),
                        ],
                        1,
                    )
                ).numpy(),
                (96, 96),
                interpolation=cv2.INTER_AREA,
            )
            for each in (person, anew)
        )
        both = (one[..., 1] > 0.999) & (other[..., 1] > 0.999)
        assert skin.sum() > 1000
        off = (one - other)[both, 0]
        assert np.sqrt((off**2).mean()) < most * other[both, 0].mean()

    def test_a_camera_that_turns_sees_the_light_of_the_world(self) -> None:
        fit = sunny_face(40.0, 50.0).truth
        head = MovingHead.of(fit, np.zeros((256, 256), np.float32), face_px=40)
        light = EnvironmentMap(radiance=torch.full((64, 128, 3), 0.2)).with_light(
            direction(20.0, 60.0), torch.full((3,), 2.0)
        )
        # world from camera by whole columns, so that turning the map is exact
        angle = 2 * np.pi * 16 / 128
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        here = head.at(fit, turn).shade(light, SKIN_SPECULAR).diffuse
        seen = light.rotate_azimuth(-angle)
        there = head.at(fit, np.eye(3)).shade(seen, SKIN_SPECULAR).diffuse
        torch.testing.assert_close(here, there, atol=0.02 * float(there.max()), rtol=0)

    def test_a_softened_map_keeps_its_light_as_it_turns(self) -> None:
        light = EnvironmentMap(radiance=torch.full((64, 128, 3), 0.3)).with_light(
            direction(33.0, 41.0), torch.full((3,), 4.0)
        )
        whole = float(light.integrate()[0])
        for degrees in (0.0, 1.7, 13.0):
            turn = torch.from_numpy(turned(degrees, sunny_face(40.0, 50.0).truth).rotation)
            assert float(softened(light, turn).integrate()[0]) == pytest.approx(whole, rel=2e-3)


def gains_of(times: np.ndarray) -> Gains:
    return Gains(times=times, edge=None, colour=np.ones(3, np.float32), factor=1.0)


class TestWhatIsCarried:
    def test_noise_of_gains_becomes_less_and_moves_with_the_film(self) -> None:
        """Of a recursive mean with s = 0.75, the variance is (1 - s) / (1 + s)."""
        rng = np.random.default_rng(1)
        texture = cv2.resize(
            rng.integers(30, 220, (48, 48, 3)).astype(np.uint8), (192, 192),
            interpolation=cv2.INTER_CUBIC,
        )  # fmt: skip
        carried, before, spreads = Carried(), None, []
        for k in range(14):
            carried.see(moved(texture, 2 * shift(k)))
            noise = 0.1 * rng.normal(size=(12, 12, 3))
            field = cv2.resize(1 + noise, (192, 192), interpolation=cv2.INTER_NEAREST)
            now = gains_of(field.astype(np.float32))
            before = now if before is None else carried.mean(before, now)
            spreads.append(before.times[40:-40, 40:-40].std())
        expected = 0.1 * np.sqrt((1 - SHARE) / (1 + SHARE))
        assert spreads[0] == pytest.approx(0.1, rel=0.15)
        assert np.mean(spreads[8:]) < 1.2 * expected

    def test_nothing_is_carried_to_another_picture(self) -> None:
        rng, carried = np.random.default_rng(2), Carried()
        old, new = (gains_of(np.full((64, 64, 3), g, np.float32)) for g in (3.0, 1.0))
        carried.see(np.full((64, 64, 3), 30, np.uint8))
        half = np.full((64, 64, 3), 30, np.uint8)
        half[:, 44:] = rng.integers(150, 250, (64, 20, 3))
        carried.see(half)
        times = carried.mean(old, new).times
        assert times[:, :32].mean() > 1 + SHARE  # what is as it was keeps most of it
        assert times[:, 50:].mean() < 1.1

    def test_after_a_cut_there_is_nothing(self) -> None:
        carried = Carried()
        carried.see(np.zeros((32, 32, 3), np.uint8))
        carried.forget()
        carried.see(np.zeros((32, 32, 3), np.uint8))
        assert carried.moved(np.ones((32, 32), np.float32)) is None


class TestARelitFilm:
    @pytest.mark.slow  # ten frames taken apart
    def test_it_is_steadier_than_its_frames_one_by_one(self, tmp_path: Path) -> None:
        """What the gain changes by from frame to frame, beyond the known motion, against frames
        of which each has its own pose, outline and skin, but even so the same light."""
        film = kept(written(tmp_path / "film.mkv", frames(5)))
        light = {LEFT: key_light(film, "left")}
        together = [
            one.gains[LEFT].times for one in relit_frames(film, film_poses(film), light, workers=1)
        ]
        alone = []
        for k, codes in enumerate(frames(5)):
            single = replace(film, file=written(tmp_path / f"{k}.mkv", [codes]))
            (one,) = relit_frames(single, film_poses(single), light, workers=1)
            alone.append(one.gains[LEFT].times)
        assert changes(together) < 0.5 * changes(alone)
        assert changes(together) < 0.01  # 1 % of a place's brightness, each frame
        # and it is the key light: the left of the face becomes brighter against its right
        face = np.log(together[3].mean(2))[90:190, 82:182]
        assert face[:, :40].mean() > face[:, 60:].mean() + 0.3

    def test_all_frames_are_as_much_brighter_where_brightness_is_kept(self, tmp_path: Path) -> None:
        """By what keeps the mean of some, which is known beforehand."""
        film = kept(written(tmp_path / "film.mkv", frames(2)))
        light = {LEFT: key_light(film, "left")}
        seen = relit_frames(film, film_poses(film), light, keep="brightness", workers=1)
        one, other = (frame.gains[LEFT].factor for frame in seen)
        assert one == other
        assert one != 1

    def test_what_strays_and_how_bright_white_is_do_not_flicker(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A card of white that is held into every other frame would raise the veil, and so take
        the edge's light from hair."""
        pictures = [one.copy() for one in frames(4)]
        for picture in pictures[::2]:
            picture[:60, :60] = 255
        film = kept(written(tmp_path / "film.mkv", pictures))
        made, of = list[Portrait](), Portrait.of

        def kept_of(*given: Any, **options: Any) -> Portrait:
            made.append(of(*given, **options))
            return made[-1]

        monkeypatch.setattr(Portrait, "of", staticmethod(kept_of))
        light = {LEFT: key_light(film, "rim")}
        assert all(one.is_relit for one in relit_frames(film, film_poses(film), light, workers=1))
        alone, together = made[:-4], made[-4:]
        assert np.ptp([one.veil for one in alone]) > 0.05 * alone[0].veil
        assert len({(one.veil, one.lit, one.stray) for one in together}) == 1
        assert together[0].veil == np.median([one.veil for one in alone])

    def test_an_edge_is_lit_from_where_the_world_has_its_lamp(self) -> None:
        """A camera that turns by 90 degrees to the right sees what was ahead on its left."""
        ahead = EdgeLight(direction=(0.0, 0.6, -0.8), strength=2.0, spread_rad=0.1)
        # world from camera: what is ahead of it (-Z) is on the world's right
        turn = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
        seen = film_module._turned(ahead, turn)
        assert seen.direction == pytest.approx((-0.8, 0.6, 0.0))
        assert (seen.strength, seen.spread_rad) == (2.0, 0.1)

    def test_a_frame_whose_skin_is_taken_for_hair_is_lit_like_the_one_before(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        film = kept(written(tmp_path / "film.mkv", frames(2)))
        light, seen = {LEFT: key_light(film, "left")}, film_poses(film)
        (_, usual) = relit_frames(film, seen, light, workers=1)
        calls = 0

        def hair_of(pixels: torch.Tensor, *_: object) -> np.ndarray:
            nonlocal calls
            calls += 1
            # one look at the frame that is traced, two for what frames share, one at each
            return np.full(tuple(pixels.shape[:2]), 1.0 if calls == 5 else 0.0, np.float32)

        monkeypatch.setattr(film_module, "hair_of", hair_of)
        (_, wrong) = relit_frames(film, seen, light, workers=1)
        assert calls == 5
        face = np.s_[90:190, 82:182]
        off = np.log(wrong.gains[LEFT].times[face] / usual.gains[LEFT].times[face])
        assert np.abs(off).mean() < 0.03

    def test_frames_without_the_face_are_as_they_were(self, tmp_path: Path) -> None:
        empty = np.full((256, 256, 3), 90, np.uint8)
        pictures = [*frames(2), *[empty] * 6, np.zeros_like(empty)]
        film = kept(written(tmp_path / "film.mkv", pictures, rate=5.0))
        out = tmp_path / "left.mkv"
        notes = relight_film(film, {out: key_light(film, "left")}, workers=1)
        after = [frame.codes for frame in film_frames(out)]
        assert len(after) == len(pictures)
        assert np.abs(after[1].astype(int) - pictures[1]).mean() > 3
        for k in range(5, 9):  # 0.75 s after it was seen last
            np.testing.assert_array_equal(after[k], pictures[k])
        assert "no face from 0.4 to 1.6 s: relit less" in notes
        assert "taken to stand still" in notes

    def test_frames_are_shown_at_their_times(self, tmp_path: Path) -> None:
        """Of a rate that varies; the file is of a constant one."""
        path = write_mpeg(tmp_path / "film.mp4", frames(4), rate=10.0)
        ticks = 1024  # of 10,240 a second
        with_frame_times(path, [ticks, 3 * ticks, ticks, ticks])
        film, out = kept(path), tmp_path / "left.mkv"
        relight_film(film, {out: key_light(film, "left")}, workers=1)
        times = [frame.time_s for frame in film_frames(path)]
        after = list(film_frames(out))
        rate = len(after) / (after[-1].time_s + after[1].time_s)
        assert len(after) == round(times[-1] * rate) + 1
        changed = [
            k / rate
            for k in range(1, len(after))
            if np.abs(after[k].codes.astype(int) - after[k - 1].codes).mean() > 0.5
        ]
        assert changed == pytest.approx(times[1:], abs=0.5 / rate + 1e-6)

    def test_frames_as_they_were_are_srgb_as_all_others(self, tmp_path: Path) -> None:
        """Of a film whose codes are proportional to light."""
        empty = np.full((256, 256, 3), 90, np.uint8)
        path = written(tmp_path / "film.mkv", [*frames(1), empty, empty], rate=1.0)
        film = replace(kept(path), decode="linear")
        *_, last = relit_frames(film, film_poses(film), {LEFT: key_light(film, "left")}, workers=1)
        assert not last.is_relit
        expected = 255 * (1.055 * (90 / 255) ** (1 / 2.4) - 0.055)
        np.testing.assert_allclose(last.codes[LEFT], expected, atol=0.6)

    def test_what_is_carried_ends_where_no_skin_is_seen(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Gains of two frames before lie where the picture was then."""
        film = kept(written(tmp_path / "film.mkv", frames(3)))
        made, calls, carried = Portrait.of, 0, []

        def of(*given: Any, **options: Any) -> Portrait:
            nonlocal calls
            calls += 1
            if calls == 5:  # three looks for what frames share, and the second frame
                raise InputError("no skin")
            return made(*given, **options)

        monkeypatch.setattr(Portrait, "of", staticmethod(of))
        monkeypatch.setattr(Carried, "mean", lambda _, before, now: carried.append(before) or now)
        light = {LEFT: key_light(film, "left")}
        done = [one.is_relit for one in relit_frames(film, film_poses(film), light, workers=1)]
        assert done == [True, False, True]
        assert carried == []

    def test_what_frames_share_is_of_those_with_the_face(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        empty = np.full((256, 256, 3), 90, np.uint8)
        film = kept(written(tmp_path / "film.mkv", [*frames(2), empty, empty]))
        poses, held, of = film_poses(film), [], Held.of
        assert poses.seen.tolist() == [True, True, False, False]
        assert poses.shares.min() == 1
        monkeypatch.setattr(Held, "of", staticmethod(lambda some: held.extend(some) or of(some)))
        next(relit_frames(film, poses, {LEFT: key_light(film, "left")}, workers=1))
        assert len(held) == 2

    def test_the_head_is_traced_in_a_frame_that_is_not_black(self, tmp_path: Path) -> None:
        """Though the head of another faces the camera more."""
        black = np.zeros((256, 256, 3), np.uint8)
        film = kept(written(tmp_path / "film.mkv", [*frames(1), black]))
        poses, fit = film_poses(film), sunny_face(40.0, 50.0).truth
        aside = replace(film.poses[0], rotation=turned(20.0, fit).rotation)
        both = replace(poses, seen=np.array([True, True]), states=(aside, film.poses[0]))
        light = {LEFT: key_light(film, "left")}
        assert [one.is_relit for one in relit_frames(film, both, light, workers=1)] == [True, False]

    def test_what_is_kept_is_what_was_there(self, tmp_path: Path) -> None:
        written(tmp_path / "film.mkv", frames(1))
        (tmp_path / "light").mkdir()
        film = kept(tmp_path / "film.mkv")
        write_film(tmp_path / "light", film)
        again = read_film(tmp_path / "light")
        torch.testing.assert_close(again.environment.radiance, film.environment.radiance)
        np.testing.assert_array_equal(again.poses[0].rotation, film.poses[0].rotation)
        np.testing.assert_array_equal(again.points, film.points)
        assert (again.shot, again.size, again.file) == (film.shot, film.size, film.file.resolve())
        assert again.lamps[0].spread_rad == 0.02


def changes(gains: Sequence[np.ndarray]) -> float:
    """Mean of ``|ln g_k - W ln g_(k-1)|`` over pairs, in means over 4 x 4 pixels, of the person."""
    logs = [np.log(one.mean(2)) for one in gains]
    off = []
    for k in range(1, len(logs)):
        step = shift(k) - shift(k - 1)
        apart = cv2.blur((logs[k] - moved(logs[k - 1], step)).astype(np.float32), (4, 4))
        off.append(np.abs(apart)[20:-20, 40:-40].mean())
    return float(np.mean(off))


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["relight-portrait", *arguments]) in (1, 2)
    return capsys.readouterr().err.strip().splitlines()[-1]


class TestWhatIsWrong:
    @pytest.mark.parametrize(
        ("options", "said"),
        [
            (["--out", "left.png"], "write a .mp4 or .mkv"),
            (["--out", "nowhere/left.mp4"], "no such folder"),
            (["--out", "film.mkv"], "the film itself"),
            (["--key", "right", "--out", "left.mp4"], "name a folder"),
            (["--workers", "2"], "--workers is for a folder"),
            (["--light", "lamps"], "not lamps"),
        ],
    )
    def test_what_cannot_be_is_one_line(
        self,
        options: list[str],
        said: str,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        monkeypatch.chdir(tmp_path)
        written(FILM, frames(1))
        assert said in refused(capsys, "film.mkv", "--key", "left", *options)
        assert [path.name for path in tmp_path.iterdir()] == ["film.mkv"]

    def test_the_folder_of_a_photographs_light_is_left_alone(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.chdir(tmp_path)
        written(Path("me.mkv"), frames(1))
        Path("me_light").mkdir()
        Path("me_light/estimate.json").write_text("{}")
        line = refused(capsys, "me.mkv", "--key", "left")
        assert "me_light holds the light of a photograph: write elsewhere with --out" in line
        assert [path.name for path in Path("me_light").iterdir()] == ["estimate.json"]

    def test_a_film_is_not_written_over_itself(self, tmp_path: Path) -> None:
        film = kept(written(tmp_path / "film.mkv", frames(1)))
        with pytest.raises(InputError, match="is the film itself"):
            relight_film(film, {film.file: key_light(film, "left")})

    def test_the_light_of_a_folder_of_frames_or_another_film(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        folder = tmp_path / "light"
        folder.mkdir()
        (folder / "film.json").write_text("{}")
        assert f"no {KEPT_FILM} in it" in refused(capsys, str(folder), "--key", "left")
        path = written(tmp_path / "film.mkv", frames(1))
        write_film(folder, kept(path))
        assert "estimated already" in refused(capsys, str(folder), "--key", "left", "--face", "2")
        written(path, frames(2))
        assert "another film than the one" in refused(capsys, str(folder), "--key", "left")
        path.unlink()
        assert "its film is gone" in refused(capsys, str(folder), "--key", "left")

    def test_interrupted_nothing_is_half_written(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        folder = tmp_path / "light"
        folder.mkdir()
        (folder / "film.json").write_text("{}")
        write_film(folder, kept(written(tmp_path / "film.mkv", frames(3))))
        out = tmp_path / "left.mp4"
        out.write_bytes(b"an earlier one")
        seen = 0

        def mean(*_: object) -> Gains:
            nonlocal seen
            seen += 1
            raise KeyboardInterrupt

        monkeypatch.setattr(Carried, "mean", mean)
        line = refused(capsys, str(folder), "--key", "left", "--out", str(out))
        assert "no film is left half written" in line
        assert seen == 1
        assert out.read_bytes() == b"an earlier one"
        assert {path.name for path in tmp_path.iterdir()} == {"film.mkv", "light", "left.mp4"}

    def test_the_light_beside_it_is_of_other_options(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.chdir(tmp_path)
        written(FILM, frames(1))
        folder = Path("film_light")
        folder.mkdir()
        write_film(folder, kept(FILM))
        keep_settings(folder / SETTINGS, FilmSettings().facts(FILM))
        line = refused(capsys, "film.mkv", "--key", "left", "--face", "2")
        assert "film_light in the film's place" in line
        assert "--out" in line

    def test_a_kept_film_whose_parts_do_not_agree(self, tmp_path: Path) -> None:
        write_film(tmp_path, kept(written(tmp_path / "film.mkv", frames(1))))
        tensors, metadata = read_tensors(tmp_path / KEPT_FILM)
        more = tensors | {"points": tensors["points"][[0, 0]]}
        write_tensors(tmp_path / KEPT_FILM, more, metadata)
        with pytest.raises(InputError, match=r"damaged .*as many keyframes"):
            read_film(tmp_path)

    def test_where_it_cannot_be_written_is_known_before_any_work(self, tmp_path: Path) -> None:
        gone = kept(tmp_path / "gone.mkv")
        light = key_light(gone, "left")
        with pytest.raises(InputError, match="films are written as"):
            relight_film(gone, {tmp_path / "left.avi": light})
        with pytest.raises(OutputError, match="no such folder"):
            relight_film(gone, {tmp_path / "none" / "left.mp4": light})

    def test_the_person_is_not_there_any_more(self, tmp_path: Path) -> None:
        film = kept(written(tmp_path / "film.mkv", [np.full((256, 256, 3), 90, np.uint8)] * 3))
        late = replace(film, frames=np.array([99]), times_s=np.array([0.0]))
        with pytest.raises(InputError, match="not found in it again"):
            film_poses(late)


def test_a_film_that_cannot_be_read_any_more_is_no_failure_of_writing(tmp_path: Path) -> None:
    with (
        pytest.raises(OSError, match="the disk with the other film"),
        written_film(tmp_path / "film.mkv", 25.0, (64, 64)),
    ):
        raise OSError(5, "the disk with the other film")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("size", [(65, 49), (64, 49), (65, 48), (64, 48)])
def test_odd_sizes_are_made_even_by_what_is_at_their_border(
    size: tuple[int, int], tmp_path: Path
) -> None:
    width, height = size
    codes = np.random.default_rng(0).integers(0, 255, (height, width, 3)).astype(np.uint8)
    written(tmp_path / "film.mkv", [codes])
    (frame,) = film_frames(tmp_path / "film.mkv")
    expected = np.pad(codes, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    np.testing.assert_array_equal(frame.codes, expected)


FULL = """
import resource, sys
from pathlib import Path
import numpy as np
from skylight.errors import OutputError
from skylight.imaging._film_writer import written_film
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
rng = np.random.default_rng(0)
try:
    with written_film(Path(sys.argv[1]), 25.0, (128, 128)) as write:
        for _ in range(60):
            write(rng.integers(0, 255, (128, 128, 3)).astype(np.uint8))
except OutputError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no limits there")
@pytest.mark.parametrize("name", ["film.mp4", "film.mkv"])
def test_a_full_disk_is_told_and_leaves_nothing(name: str, tmp_path: Path) -> None:
    """OpenCV's writer does not tell."""
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path / name)], capture_output=True, text=True
    )
    assert f"cannot write {tmp_path / name}" in done.stdout, done.stderr
    assert list(tmp_path.iterdir()) == []
