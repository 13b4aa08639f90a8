"""A light model of the user's own, from a photograph to files, and what reads them."""

import json
import runpy
import sys
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from skylight.cli import main
from skylight.errors import InputError
from skylight.estimation._folder import estimate_folder
from skylight.estimation._photos import estimate_photo
from skylight.estimation._report import write_results
from skylight.estimation._settings import EstimateSettings
from skylight.estimation._summary import summary
from skylight.estimation.film._estimate import FilmSettings
from skylight.io._files import read_environment_map, write_png
from skylight.models._base import ParametricLight
from skylight.models._ground import KnownGround
from skylight.portrait._lights import light_with_sun_at
from skylight.sphere._frame import angle_between
from tests.sunny_face import direction, sunny_face

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_light.py"


class Lantern(ParametricLight):
    """Even light and a lamp: their log colours, and its direction, of any length."""

    name = "a lantern of $5"

    def __init__(self) -> None:
        super().__init__(9, 64, sphere=True)

    def sun_direction(self, params: Tensor) -> Tensor:
        return nn.functional.normalize(params[..., 6:], dim=-1)

    def forward(self, params: Tensor) -> Tensor:
        even, lamp = params[..., None, :6].exp().split(3, -1)
        towards = self.sun_direction(params)[..., None, :]
        from_lamp = (self.directions - towards).square().sum(-1, keepdim=True)
        return even + lamp * 20 * torch.exp(-30 * from_lamp)

    def starts_towards(self, directions: Tensor) -> Tensor:
        return torch.cat([directions.new_zeros(len(directions), 6), directions], 1)[:, None]


class Sky(ParametricLight):
    def __init__(self) -> None:
        super().__init__(3)

    def forward(self, params: Tensor) -> Tensor:
        return params.exp()[..., None, :].expand(*params.shape[:-1], len(self.directions), 3)


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    write_png(tmp_path / "portrait.png", sunny_face(40.0, 50.0).encoded)
    return tmp_path / "portrait.png"


@pytest.mark.slow
def test_the_pages_model_finds_the_sun(
    photo: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), str(photo)])
    found = runpy.run_path(str(EXAMPLE), run_name="__main__")["found"]
    assert float(angle_between(found.sun_direction, direction(40.0, 50.0)).rad2deg()) < 8
    assert found.light == "FadingSky"
    assert found.verdict.direction.word == "sure"
    assert "degrees right of the view" in capsys.readouterr().out
    assert len(EXAMPLE.read_text().splitlines()) <= 40


@pytest.mark.slow
def test_results_are_read_as_any_others(
    photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = estimate_photo(photo, light=Lantern(), device="cpu", workers=1)
    assert "lamp        90 % sure" in summary(result)
    out = tmp_path / "results"
    out.mkdir()
    write_results(out, result)
    told = json.loads((out / "estimate.json").read_text(encoding="utf-8"))
    assert (told["light"], told["lamps"], len(told["params"])) == (Lantern.name, [], 9)
    assert told["verdict"]["direction"]["word"] == "sure"
    assert told["faces"][0]["residual"] < 0.25
    written = read_environment_map(out / "probe.exr")
    assert written.layout == (256, 512)
    moved = light_with_sun_at(result.estimate, -60.0, 40.0)
    assert moved.environment.layout == (256, 512)
    truth = str(out / "probe.hdr")
    assert main(["score", str(out / "probe.exr"), truth]) == 0
    assert main(["export", "blender", str(out), str(tmp_path / "scene")]) == 0
    view = ["export", "viewer", str(out), "--out", str(tmp_path / "view.html")]
    assert main(view) == 0, capsys.readouterr().err


@pytest.mark.slow
def test_a_folder_knows_the_model_again(photo: Path, tmp_path: Path) -> None:
    photos, out = tmp_path / "photos", tmp_path / "out"
    photos.mkdir()
    photo.rename(photos / "a.png")
    (entry,) = estimate_folder(photos, out, EstimateSettings(light=Sky(), device="cpu"))
    assert (entry.status, entry.error) == ("done", "")
    (again,) = estimate_folder(photos, out, EstimateSettings(light=Sky(), device="cpu"))
    assert again == entry
    with pytest.raises(InputError, match="made with other settings"):
        estimate_folder(photos, out, EstimateSettings(light=Lantern(), device="cpu"))


def test_settings_refuse_what_does_not_go_together() -> None:
    ground = KnownGround(albedo=(0.5, 0.5, 0.5))
    assert EstimateSettings(light=Sky(), ground=ground).ground == ground
    with pytest.raises(InputError, match=r"a lantern of .* has none"):
        EstimateSettings(light=Lantern(), ground=ground)
    with pytest.raises(InputError, match="thesis is for the light autoencoder, not for Sky"):
        EstimateSettings(light=Sky(), solver="thesis")
    with pytest.raises(InputError, match="leave prior out"):
        EstimateSettings(light="lamps", prior=torch.distributions.Normal(0.0, 1.0))
    with pytest.raises(InputError, match="it lacks name"):
        EstimateSettings(light=nn.Identity())  # pyright: ignore[reportArgumentType]
    sky = Sky()
    assert FilmSettings(estimate=EstimateSettings(light=sky)).estimate.light is sky
    with pytest.raises(InputError, match="--video takes --light sphere"):
        FilmSettings(estimate=EstimateSettings(light=Lantern()))
