"""``skylight score``: pairs, folders, files and what it refuses."""

import csv
import json
from pathlib import Path

import pytest
import torch

from skylight.cli import main
from skylight.errors import InputError
from skylight.io._files import read_light, write_environment_map
from skylight.maps._score import pair_folders, score_files
from skylight.sphere._envmap import EnvironmentMap


def write_map(path: Path, *, sun: float = 900.0, seed: int = 0, rows: int = 16) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    radiance = torch.rand(rows, 2 * rows, 3, generator=torch.Generator().manual_seed(seed)) + 0.2
    radiance[rows // 4, rows] = sun
    write_environment_map(path, EnvironmentMap(radiance=radiance))
    return path


def test_a_pair_is_printed_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    guess, truth = write_map(tmp_path / "a.exr", seed=1), write_map(tmp_path / "b.exr")
    out = tmp_path / "scores.json"
    assert main(["score", str(guess), str(truth), "--out", str(out)]) == 0
    told = json.loads(out.read_text(encoding="utf-8"))
    assert told["format"] == "skylight scores 1"
    assert told["sun_visible"] is True
    assert set(told["scores"]["mirror_rmse"]) == {"unaligned", "mean", "least_squares"}
    printed = capsys.readouterr().out
    for metric in told["scores"]:
        assert metric in printed
    value = told["scores"]["full_dw_mae"]["mean"]
    assert f"{value:.4f}" in printed


def test_conventions_are_undone(tmp_path: Path) -> None:
    truth = write_map(tmp_path / "truth.exr")
    light = EnvironmentMap(radiance=read_light(truth))
    write_environment_map(tmp_path / "blender.hdr", light, convention="blender")
    result = score_files(tmp_path / "blender.hdr", truth, predicted_convention="blender")
    assert result.scores["sun_angle_deg"]["scale_free"] == pytest.approx(0, abs=1e-3)
    assert result.scores["full_dw_mae"]["unaligned"] < 0.01  # RGBE's rounding
    wrong = score_files(tmp_path / "blender.hdr", truth)
    assert wrong.scores["sun_angle_deg"]["scale_free"] > 50


def test_maps_of_other_sizes_and_skies_are_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    large, small = write_map(tmp_path / "l.exr", rows=64), write_map(tmp_path / "s.exr", rows=16)
    assert main(["score", str(large), str(small), "--height", "32"]) == 0
    sky = tmp_path / "sky.exr"
    write_environment_map(sky, EnvironmentMap(radiance=read_light(small)).upper())
    capsys.readouterr()
    out = tmp_path / "scores.json"
    assert main(["score", str(small), str(sky), "--out", str(out)]) == 0
    assert "upper halves compared" in capsys.readouterr().err
    told = json.loads(out.read_text(encoding="utf-8"))
    assert told["upper_half_only"]
    assert told["scores"]["full_dw_mae"]["mean"] == pytest.approx(0, abs=1e-6)


def test_folders_are_matched_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number in range(2):
        write_map(tmp_path / "pred" / "day" / f"{number}.exr", seed=number + 5)
        write_map(tmp_path / "true" / "day" / f"{number}.hdr", seed=number)
    write_map(tmp_path / "pred" / "day" / "0.hdr", seed=99)  # the .exr of that name is taken
    write_map(tmp_path / "pred" / "alone.exr")
    write_map(tmp_path / "true" / "day" / "overcast.exr", sun=0.5)
    write_map(tmp_path / "pred" / "day" / "overcast.exr", seed=3)
    out = tmp_path / "scores.csv"
    options = ["score", str(tmp_path / "pred"), str(tmp_path / "true"), "--out", str(out)]
    assert main(options) == 0
    ended = capsys.readouterr()
    assert "mean of 3 maps" in ended.out
    assert "left out, in one folder only" in ended.err
    assert "alone.exr" in ended.err
    with out.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["map"] for row in rows] == [
        "day/0", "day/1", "day/overcast", "(mean)", "(median)", "(count)"
    ]  # fmt: skip
    values = [float(row["mirror_rmse_unaligned"]) for row in rows]
    assert values[3] == pytest.approx(sum(values[:3]) / 3)
    assert values[4] == pytest.approx(sorted(values[:3])[1])
    assert values[5] == 3
    assert rows[2]["sun_angle_deg"] == ""
    assert float(rows[5]["sun_angle_deg"]) == 2
    pairs, alone = pair_folders(tmp_path / "pred", tmp_path / "true")
    assert pairs[0][1].suffix == ".exr"
    assert len(alone) == 1


def test_results_of_estimates_are_matched_by_their_photos(tmp_path: Path) -> None:
    for name in ("day/me_jpg", "you_light"):
        for file in ("probe.exr", "probe.hdr", "posterior.exr"):
            write_map(tmp_path / "pred" / name / file)
        (tmp_path / "pred" / name / "estimate.json").write_text("{}", encoding="utf-8")
    me = write_map(tmp_path / "true" / "day" / "me.exr")
    you = write_map(tmp_path / "true" / "you.hdr")
    pairs, alone = pair_folders(tmp_path / "pred", tmp_path / "true")
    assert pairs == [
        ("day/me", tmp_path / "pred" / "day" / "me_jpg" / "probe.exr", me),
        ("you", tmp_path / "pred" / "you_light" / "probe.exr", you),
    ]
    assert alone == []
    write_map(tmp_path / "pred" / "day" / "me_png" / "probe.exr")
    (tmp_path / "pred" / "day" / "me_png" / "estimate.json").write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match="one name, day/me"):
        pair_folders(tmp_path / "pred", tmp_path / "true")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a.exr", "."], "two maps or two folders"),
        (["a.exr", "b.exr", "--out", "x.csv"], "ends in .json"),
        ([".", ".", "--out", "x.json"], "ends in .csv"),
        (["a.exr", "b.exr", "--height", "7"], "even number of rows"),
        (["a.exr", "black.exr"], "true light is black"),
        (["a.exr", "missing.exr"], "there is no such file"),
        (["empty", "."], "has the same name"),
    ],
)
def test_what_cannot_be_is_told(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_map(Path("a.exr"))
    write_map(Path("b.exr"))
    write_environment_map("black.exr", EnvironmentMap(radiance=torch.zeros(16, 32, 3)))
    Path("empty").mkdir()
    assert main(["score", *arguments]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
