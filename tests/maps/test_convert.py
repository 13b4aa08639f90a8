"""Maps of light converted by the command, and what it refuses."""

from pathlib import Path
from typing import get_args

import pytest
import torch

from skylight._names import Convention
from skylight.cli import main
from skylight.io._files import read_environment_map, read_light, write_environment_map
from skylight.sphere._envmap import EnvironmentMap


@pytest.mark.parametrize("convention", get_args(Convention))
def test_conventions_come_back_exactly(probe: Path, tmp_path: Path, convention: str) -> None:
    there, back = tmp_path / "there.exr", tmp_path / "back.exr"
    assert main(["convert", str(probe), str(there), "--convention", convention]) == 0
    assert main(["convert", str(there), str(back), "--from-convention", convention]) == 0
    assert torch.equal(read_light(back), read_light(probe))
    rolled = read_light(there)
    column = int(rolled[4].sum(1).argmax())
    # our column 20 of 32 lies an eighth of a turn right of -Z
    centres = {"skylight": 20, "openexr": 4, "mitsuba": 4}
    assert column == centres.get(convention, 12)


@pytest.mark.parametrize("kind", ["cube", "octahedral", "angular", "mirrorball"])
def test_projections_keep_light_and_sun(probe: Path, tmp_path: Path, kind: str) -> None:
    there, back = tmp_path / "there.exr", tmp_path / "back.exr"
    size = ["--height", "192"]
    assert main(["convert", str(probe), str(there), "--to", kind, *size]) == 0
    assert main(["convert", str(there), str(back), "--from", kind]) == 0
    before, after = read_environment_map(probe), read_environment_map(back)
    torch.testing.assert_close(after.integrate(), before.integrate(), rtol=0.1, atol=0)
    cosine = before.brightest_direction().double() @ after.brightest_direction().double()
    assert float(cosine) > 0.99


def test_a_sky_gets_a_dark_half_and_a_size_can_be_chosen(tmp_path: Path) -> None:
    sky = EnvironmentMap(radiance=torch.ones(8, 32, 3))
    write_environment_map(tmp_path / "sky.hdr", sky)
    out = tmp_path / "ball.exr"
    assert main(["convert", str(tmp_path / "sky.hdr"), str(out), "--to", "angular"]) == 0
    picture = read_light(out)
    assert picture.shape == (30, 30, 3)
    assert picture[5, 15].min() > 0.9
    assert picture[25, 15].max() == 0
    small = tmp_path / "small.exr"
    assert main(["convert", str(tmp_path / "sky.hdr"), str(small), "--height", "4"]) == 0
    assert read_light(small).shape == (4, 16, 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--to", "cube", "--convention", "unity"], "leave it out for cube"),
        (["--to", "cube", "--height", "64"], "cube cannot have 64 rows"),
        (["--from", "cube"], "cannot have 16 rows"),
        (["--from", "angular"], "has 16 columns, not 32"),
        (["--height", "7"], "even number of rows"),
    ],
)
def test_what_cannot_be_is_told_and_nothing_written(
    probe: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    out = probe.parent / "out.exr"
    assert main(["convert", str(probe), str(out), *options]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()
