"""Designs for folders of maps and for a day's skies, by functions and by the command line."""

import json
import math
from collections import Counter
from datetime import date
from pathlib import Path

import pytest
import torch

from skylight.cli import main
from skylight.errors import InputError
from skylight.io._files import write_environment_map
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._design_files import (
    place_and_day,
    summarise_optimised,
    tailored_designs,
)
from skylight.probes.partitions._optimise import SearchSettings, optimise_for
from skylight.probes.partitions._seeds import load_design
from skylight.probes.partitions._sun_path import Lights, read_maps, simulated_lights, sun_directions
from skylight.skies._sun import Place
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import angle_between

MUNICH, SPRING = Place(latitude_deg=48.1, longitude_deg=11.6), date(2026, 3, 20)
QUICK = SearchSettings(starts=1, steps=30)


def room(seed: int) -> EnvironmentMap:
    """Dim, with a window somewhere in the upper half."""
    rng = torch.Generator().manual_seed(seed)
    radiance = 0.1 * torch.rand(16, 32, 3, generator=rng)
    row, column = (int(torch.randint(n, (1,), generator=rng)) for n in (8, 32))
    radiance[row, column] += 20
    return EnvironmentMap(radiance=radiance)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rows = ["file,category"]
    for number in range(4):
        write_environment_map(tmp_path / f"{number}.exr", room(number))
        rows.append(f"{number}.exr,{'indoor' if number else 'urban'}")
    (tmp_path / "index.csv").write_text("\n".join(rows) + "\n")
    return tmp_path


def lights(count: int, group_size: int = 1) -> Lights:
    return Lights(
        maps=torch.stack([room(i).resize(32).radiance for i in range(count)]),
        names=tuple(f"map {i}" for i in range(count)),
        groups=tuple(i // group_size for i in range(count)),
        oriented=group_size > 1,
    )


def test_maps_of_a_category_are_read_and_keep_their_light(folder):
    assert read_maps(folder).names == ("0.exr", "1.exr", "2.exr", "3.exr")
    found = read_maps(folder, "indoor")
    assert found.names == ("1.exr", "2.exr", "3.exr")
    assert found.maps.shape == (3, 32, 64, 3)
    small = EnvironmentMap(radiance=found.maps[0])
    torch.testing.assert_close(small.integrate(), room(1).integrate(), rtol=1e-4, atol=0)


def test_skies_get_a_ground_that_throws_back_a_fifth(tmp_path):
    write_environment_map(tmp_path / "sky.hdr", EnvironmentMap(radiance=torch.ones(8, 32, 3)))
    below = read_maps(tmp_path).maps[0, 16:]
    # pi in, of which a fifth leaves evenly: radiance 0.2
    torch.testing.assert_close(below, torch.full_like(below, 0.2), rtol=1e-2, atol=0)


def test_what_is_no_folder_of_maps_is_said(folder, tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        read_maps(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"'cellar': .*indoor, urban"):
        read_maps(folder, "cellar")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match=r"\.exr or \.hdr"):
        read_maps(empty)
    write_environment_map(empty / "black.exr", EnvironmentMap(radiance=torch.zeros(8, 16, 3)))
    with pytest.raises(InputError, match=r"black\.exr: .*black"):
        read_maps(empty)


def test_simulated_suns_stand_where_they_should():
    found = simulated_lights(MUNICH, SPRING, weathers=3)
    assert found.oriented
    assert set(found.groups) == {0, 1, 2}
    suns = sun_directions(MUNICH, SPRING)
    suns = suns[suns[:, 1] > 0.25]
    sunny = [
        (group, EnvironmentMap(radiance=radiance).brightest_direction())
        for group, radiance in zip(found.groups, found.maps, strict=True)
        if radiance.max() > 1000 * radiance.median()
    ]
    # of the weather with most sun
    most = Counter(group for group, _ in sunny).most_common(1)[0][0]
    peaks = torch.stack([peak for group, peak in sunny if group == most and peak[1] > 0.3])
    assert len(peaks) > 4
    off = angle_between(peaks[:, None].expand(-1, len(suns), 3), suns.expand(len(peaks), -1, 3))
    # a pixel is 5.6 degrees wide
    assert float(off.amin(1).max()) < math.radians(4.0)
    # from the east by the south, where +Z is, to the west
    assert float(peaks[0, 0]) > 0 > float(peaks[-1, 0])
    assert float(peaks[:, 2].max()) > 0.2


def test_no_sky_is_on_both_sides():
    result = optimise_for(lights(6, group_size=2), "found", 14, held_out=0.3, settings=QUICK)
    assert len(result.held_out) == 2
    assert sorted(result.training + result.held_out) == [f"map {i}" for i in range(6)]
    first, second = (int(name.split()[1]) for name in result.held_out)
    assert first // 2 == second // 2
    assert result.design.oriented


def test_the_gain_is_that_of_the_held_out_maps():
    result = optimise_for(
        lights(4), "found", 14, settings=QUICK, rivals=tailored_designs(14), seed=5
    )
    assert list(result.scores) == ["14d", "14d-indoor", "found"]
    scores = result.scores
    assert result.gain == pytest.approx(1 - scores["found"].held_out / scores["14d"].held_out)
    assert scores["found"].training < scores["14d"].training
    assert not result.design.oriented
    again = optimise_for(lights(4), "found", 14, settings=QUICK, seed=5)
    assert torch.equal(again.design.seeds, result.design.seeds)
    assert f"{abs(result.gain):.1%}" in summarise_optimised(result)


def test_rivals_have_as_many_cells():
    assert tailored_designs(9) == []
    (rival,) = tailored_designs(14, (MUNICH, SPRING))
    assert rival.count == 14
    assert rival.oriented


def test_divisions_that_leave_nothing_are_refused():
    with pytest.raises(InputError, match="one map"):
        optimise_for(lights(1), "found", 14)
    with pytest.raises(InputError, match="0 and 1"):
        optimise_for(lights(3), "found", 14, held_out=1.0)
    with pytest.raises(InputError, match="'14d'"):
        optimise_for(lights(3), "14d", 14)


def test_places_and_days_are_checked():
    assert place_and_day(48.1, 11.6, "2026-03-20") == (MUNICH, SPRING)
    with pytest.raises(InputError, match="is no place"):
        place_and_day(91.0, 0.0, "2026-06-21")
    with pytest.raises(InputError, match="is no day"):
        place_and_day(0.0, 0.0, "midsummer")
    with pytest.raises(InputError, match="weathers"):
        simulated_lights(MUNICH, SPRING, weathers=0)
    with pytest.raises(InputError, match="does not rise"):
        simulated_lights(
            Place(latitude_deg=85.0, longitude_deg=0.0), date(2026, 12, 21), weathers=1
        )


def test_the_command_writes_a_design_its_picture_and_a_report(folder, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["--for", str(folder), "--category", "indoor", "--out", str(out)]
    quick = ["--cells", "9", "--starts", "1", "--steps", "20", "--name", "rooms"]
    assert main(["probe", "partitions", "design", *arguments, *quick]) == 0
    said = capsys.readouterr().out
    report = json.loads((out / "report.json").read_text())
    assert f"{abs(report['gain']):.1%}" in said
    assert list(report["mae"]) == ["even-9", "rooms"]
    assert len(report["training"]) + len(report["held_out"]) == 3
    design = load_design(out / "design.json")
    assert (design.name, Cells.of(design).count) == ("rooms", 9)
    assert (out / "design.png").stat().st_size > 1000


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["--lat", "48", "--lon", "11"],
        ["--for", "somewhere", "--lat", "48", "--lon", "11", "--date", "2026-06-21"],
    ],
)
def test_the_command_wants_either_maps_or_a_day(arguments, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["probe", "partitions", "design", *arguments, "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "give either --for with a folder, or --lat, --lon and --date together" in error
    assert not out.exists()
