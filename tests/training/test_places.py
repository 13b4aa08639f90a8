"""The model of places is learnt from maps."""

import csv
import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from skylight.errors import InputError
from skylight.io._files import write_environment_map
from skylight.models._lamps import LampsLight
from skylight.models._manifest import PLACES
from skylight.models._sphere import Places, SphereLight, SpherePrior
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid
from skylight.training._config import PlacesConfig
from skylight.training._places import (
    ROWS,
    SCORES,
    Decoder,
    Linear,
    PlaceLight,
    PlaceMaps,
    _balanced,
    _height,
    lamps_of,
    principal,
    read_maps,
    scores,
    shrunk,
    train_places,
    whitened,
)

COUNT, LATENTS = 60, 3


def maps_of_few_numbers(folder: Path) -> None:
    """Maps whose log radiance is smooth, each with a sun that is not in it, at any azimuth."""
    grid, generator = DirectionGrid.latlong(64), torch.Generator().manual_seed(0)
    _, y, z = grid.directions.float().unbind(1)
    index, lights = [], []
    for k in range(COUNT):
        a, b, c = torch.randn(3, generator=generator).tolist()
        log = 0.5 * y + 0.4 * a * y + 0.3 * b * -z + 0.3 * c * (3 * y**2 - 1)
        radiance = log.exp()[:, None].expand(-1, 3).reshape(64, 128, 3)
        turn = int(torch.randint(128, (1,), generator=generator))
        name = f"{k:03d}.exr"
        write_environment_map(folder / name, EnvironmentMap(radiance=radiance.roll(turn, 1)))
        split = "test" if k % 10 == 9 else "train"
        index.append({"file": name, "kind": "field" if k % 2 else "room", "split": split})
        azimuth = 360 * turn / 128
        sun = {"azimuth_deg": azimuth, "zenith_deg": 40, "radius_deg": 0.27, "in_map": 0}
        lights.append({"file": name, "kind": "sun", **sun, "red": 4, "green": 4, "blue": 4})
    for path, rows in ((folder / "index.csv", index), (folder / "lights.csv", lights)):
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    made = tmp_path_factory.mktemp("places")
    maps_of_few_numbers(made)
    return made


def test_maps_are_turned_to_their_sun_and_of_mean_one(folder: Path) -> None:
    maps = read_maps(folder)
    solid = DirectionGrid.latlong(ROWS).solid_angles.float() / (4 * math.pi)
    mean = luminance(maps.log.float().exp()) @ solid
    torch.testing.assert_close(mean, torch.ones(COUNT), rtol=0.02, atol=0)  # the floor is added
    # what was made about -Z before the turn is there again, but for half a pixel of 32 rows
    z = DirectionGrid.latlong(ROWS).directions[:, 2].float()
    x = DirectionGrid.latlong(ROWS).directions[:, 0].float()
    tilt = (luminance(maps.log.float()) * solid) @ torch.stack([x, z], 1)
    assert float(tilt[:, 0].abs().max()) < 0.06 * float(tilt[:, 1].abs().max())


def test_principal_components_of_few_numbers_are_those_numbers(folder: Path) -> None:
    maps, decoder = read_maps(folder), Decoder(13)
    model = principal(decoder, maps.with_mirrored(), LATENTS + 2)
    errors = scores(decoder, model, maps.log)["log_rmse"]
    assert float(errors.median()) < 0.02
    fewer = scores(decoder, principal(decoder, maps.with_mirrored(), 1), maps.log)["log_rmse"]
    assert float(fewer.median()) > 5 * float(errors.median())


def test_a_model_is_trained_and_explains_its_places(folder: Path, tmp_path) -> None:
    out = tmp_path / "model"
    config = PlacesConfig(data=folder, out=out, latents=LATENTS + 2, places_a_component=100)
    assert train_places(config) == out
    assert sorted(each.name for each in out.iterdir()) == sorted([PLACES, SCORES])
    places = Places.load(out / PLACES)
    assert places.kinds == ("field", "room")
    # every place has one lamp, of 4 / (4 pi) of the mean of 1, straight ahead
    assert float(places.log_counts[:, 1].exp().min()) > 0.95
    prior = SpherePrior(1, places)
    generator = torch.Generator().manual_seed(0)
    drawn = prior.sample(200, generator)
    torch.testing.assert_close(drawn[:, :5].std(0), torch.ones(5), rtol=0.25, atol=0)
    params = torch.cat([drawn[:, :5], torch.zeros(200, 1), drawn[:, 5:]], 1)
    lamps = SphereLight(1, places=places).lamps(params)
    assert float(lamps.energies.median()) == pytest.approx(1 / math.pi, rel=0.15)
    assert float((lamps.directions[:, 0, 2] < 0).float().mean()) > 0.9


def test_too_few_places_are_refused(folder: Path, tmp_path) -> None:
    with pytest.raises(InputError, match="54 training places are too few for 40 latents"):
        train_places(PlacesConfig(data=folder, out=tmp_path / "model", latents=40))
    (tmp_path / "empty").mkdir()
    for name in ("index.csv", "lights.csv"):
        (tmp_path / "empty" / name).write_text("file,kind,split\n")
    for name in ("empty", "nowhere"):
        with pytest.raises(InputError, match="no map is there"):
            read_maps(tmp_path / name)


def test_mirror_images_have_left_for_right(folder: Path) -> None:
    maps, x = read_maps(folder), DirectionGrid.latlong(ROWS).directions[:, 0].float()
    maps = replace(maps, log=maps.log + x[:, None].half())
    plain, mirrored = (each @ x for each in maps.with_mirrored().mean(2).split(COUNT))
    assert float(plain.min()) > 0
    torch.testing.assert_close(mirrored, -plain, rtol=1e-4, atol=0)


def test_white_balance_takes_colour_away_from_maps_and_lights() -> None:
    radiance = torch.tensor([2.0, 1.0, 0.5]).expand(16, 32, 3)
    off, inside = light((9.0, 3.0, 1.0), in_map=False), light((8.0, 4.0, 2.0), in_map=True)
    balanced, (outer, inner) = _balanced(radiance, [off, inside], 1.0)
    total = 4 * math.pi * balanced[0, 0] + torch.tensor(outer.energy)  # the other is in the map
    torch.testing.assert_close(total, total[:1].expand(3), rtol=1e-2, atol=0)
    gains = torch.tensor(outer.energy) / torch.tensor(off.energy)
    torch.testing.assert_close(torch.tensor(inner.energy) / torch.tensor(inside.energy), gains)
    half, _ = _balanced(radiance, [], 0.5)
    assert float(half[0, 0, 0] / half[0, 0, 1]) == pytest.approx(math.sqrt(2), rel=1e-4)


def light(energy: tuple[float, float, float], *, in_map: bool) -> PlaceLight:
    radius = math.radians(30)
    return PlaceLight(
        azimuth_rad=0.4, zenith_rad=1.0, energy=energy, radius_rad=radius, in_map=in_map
    )


def test_lamps_are_what_the_smooth_light_lacks() -> None:
    decoder, energy = Decoder(13), (6.0, 3.0, 2.0)
    even = Linear(
        control=torch.zeros(decoder.matrix.shape[1], 3),
        basis=torch.zeros(1, decoder.matrix.shape[1], 3),
    )
    maps = PlaceMaps(
        log=torch.zeros(2, len(decoder.directions), 3),
        azimuth_rad=torch.zeros(2),
        kind=["room"] * 2,
        lights=[[light(energy, in_map=shown)] for shown in (False, True)],
        is_test=[False] * 2,
    )
    params = torch.stack(lamps_of(decoder, even, maps, torch.zeros(2, 1)))
    model = LampsLight(1)
    lamps = model.lamps(torch.cat([torch.zeros(2, 16), params.flatten(1)], 1))
    received = 4 * math.pi * lamps.energies * lamps.colours[:, 0]
    torch.testing.assert_close(received[0], torch.tensor(energy), rtol=1e-4, atol=0)
    disc = 2 * math.pi * (1 - math.cos(math.radians(30)))
    torch.testing.assert_close(received[1], torch.tensor(energy) - disc, rtol=0.05, atol=0)


def test_whitened_latents_are_standard_and_mean_the_same_light(folder: Path) -> None:
    maps, decoder = read_maps(folder), Decoder(13)
    model = principal(decoder, maps.with_mirrored(), LATENTS)
    z = model.latents(decoder, maps.log.float())
    other, white = whitened(model, z)
    torch.testing.assert_close(white.mean(0), torch.zeros(LATENTS), rtol=0, atol=1e-3)
    torch.testing.assert_close(torch.cov(white.T), torch.eye(LATENTS), rtol=0, atol=1e-3)
    same = other.log(decoder, white), model.log(decoder, z)
    torch.testing.assert_close(*same, rtol=0, atol=1e-3)


def test_components_are_the_same_whatever_was_drawn_before(folder: Path) -> None:
    maps, decoder = read_maps(folder), Decoder(13)
    first, _, again = (
        principal(decoder, maps.with_mirrored(), LATENTS),
        torch.rand(7),
        principal(decoder, maps.with_mirrored(), LATENTS),
    )
    assert torch.equal(first.basis, again.basis)


def test_covariances_of_few_samples_lean_to_the_diagonal() -> None:
    generator = torch.Generator().manual_seed(0)
    samples = torch.randn(12, 8, generator=generator) * torch.arange(1, 9)
    covariance = shrunk(samples, 1, 0).covariances[0]
    own = samples.double().var(0)
    torch.testing.assert_close(covariance.diagonal(), own, rtol=0.1, atol=0)
    off = covariance - covariance.diagonal().diag()
    plain = torch.cov(samples.double().T)
    plain = plain - plain.diagonal().diag()
    torch.testing.assert_close(off, plain * (11 / 12) * 12 / 112, rtol=0.05, atol=0.05)


@pytest.mark.parametrize("h", [-3.0, -0.4, 0.7, 5.0])
def test_heights_are_those_of_their_mean(h: float) -> None:
    assert _height(1 / math.tanh(h) - 1 / h) == pytest.approx(h, abs=0.02)
