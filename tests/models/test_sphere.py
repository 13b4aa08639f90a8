"""The light model of the whole sphere: what must hold whatever was learnt."""

import math
from dataclasses import replace

import pytest
import torch

from skylight.errors import InputError
from skylight.models._lobes import LAMP_PARAMETERS
from skylight.models._sphere import TURNS, Places, SphereLight, SpherePrior, shipped, turned
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import DirectionGrid, angle_between, direction_from_angles
from skylight.sphere._lobes import DiskSplines

KINDS = ("field", "room")


def small_places(latents: int = 2) -> Places:
    """Two kinds and three components, over few latents."""
    generator = torch.Generator().manual_seed(0)
    count = 2 * DiskSplines(6, DirectionGrid.sky(4)).count

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    return Places(
        kinds=KINDS,
        across=6,
        control=0.3 * normal(3, count),
        basis=0.3 * normal(latents, 3, count),
        log_weights=torch.tensor([0.5, 0.2, 0.3]).log(),
        means=normal(3, latents),
        precision_factors=(torch.eye(latents) * torch.tensor([1.0, 2.0, 1.5])[:, None, None])
        + 0.3 * normal(3, latents, latents).triu(1),
        kind=torch.tensor([0, 0, 1]),
        log_counts=torch.tensor([[0.6, 0.4, 1e-9, 1e-9], [0.1, 0.3, 0.3, 0.3]]).log(),
        lamp_means=normal(2, 4),
        lamp_factors=torch.eye(4).repeat(2, 1, 1) + 0.2 * normal(2, 4, 4).triu(1),
        lamp_up=torch.tensor([2.0, -0.5]),
        lamp_ahead=torch.tensor([0.9, 0.2]),
    )


def drawn(count: int, n: int = 3) -> torch.Tensor:
    """Parameters of the light that ships, of places with so many lamps, turned anyhow."""
    prior, generator = SpherePrior(count), torch.Generator().manual_seed(count)
    x = prior.sample(n, generator)
    azimuth = 6 * torch.rand(n, 1, generator=generator) - 3
    return torch.cat([x[:, : prior.latents], azimuth, x[:, prior.latents :]], 1)


def test_ambient_light_has_mean_luminance_one_and_lamps_add_their_energies() -> None:
    model, params = SphereLight(2), drawn(2)
    share = model.grid.solid_angles.float() / (4 * math.pi)
    torch.testing.assert_close(
        luminance(model.ambient(params)) @ share, torch.ones(3), rtol=1e-5, atol=0
    )
    # each lamp has 4 pi e of energy, its luminance e of the mean
    expected = 1 + model.lamps(params).energies.sum(1)
    torch.testing.assert_close(luminance(model(params)) @ share, expected, rtol=1e-4, atol=0)
    assert bool((model(params) > 0).all())


def test_a_turn_by_whole_pixels_moves_all_that_is_there() -> None:
    model, params = SphereLight(1), drawn(1)
    before = model(params).unflatten(1, (32, 64))
    params[:, model.latents] += 5 * 2 * math.pi / 64
    after = model(params).unflatten(1, (32, 64))
    torch.testing.assert_close(after, before.roll(5, 2), rtol=2e-4, atol=1e-5)


def test_a_turn_between_pixels_is_that_of_the_splines_to_two_percent() -> None:
    model, params = SphereLight(0), drawn(0, 8)
    places = model.places
    control = places.control + torch.einsum("bz,zcn->bcn", params[:, : model.latents], places.basis)
    splines = DiskSplines(places.across, DirectionGrid.sky(16))
    above, below = control.mT.unflatten(1, (2, -1)).unbind(1)
    azimuth = params[:, model.latents]
    lower = splines(below, azimuth).unflatten(1, (16, 64)).flip(1).flatten(1, 2)
    expected = torch.cat([splines(above, azimuth), lower], 1)
    off = model(params).log() - expected
    off = off - off.mean((1, 2), keepdim=True)  # it is scaled to a mean luminance of 1
    assert float(off.abs().max()) < 0.02


def test_finer_maps_have_the_same_light() -> None:
    model, params = SphereLight(1), drawn(1)
    params[:, -3] = 1.0  # of width: 16 degrees
    coarse, fine = model(params), model.on_rows(64)(params)
    mean = fine.unflatten(1, (32, 2, 64, 2)).mean((2, 4)).flatten(1, 2)
    assert float((mean.log() - coarse.log()).square().mean().sqrt()) < 0.03


def test_starts_look_where_lamps_are() -> None:
    directions = torch.nn.functional.normalize(torch.tensor([[[0.6, 0.5, 0.3], [-1, 0.2, 0.0]]]))
    directions = torch.nn.functional.normalize(directions, dim=-1)
    model = SphereLight(2)
    starts = model.starts_at(directions, torch.tensor([[0.3, 0.9]]))
    assert starts.shape == (1, 4 * len(model.means), model.parameter_count)
    found = model.lamps(starts[0]).directions
    torch.testing.assert_close(found, directions.expand_as(found), rtol=0, atol=1e-5)
    # turned to the stronger one, as maps were that the model has learnt from
    ahead = turned(found, -starts[0, :, model.latents, None])[:, 1]
    torch.testing.assert_close(ahead[:, 0], torch.zeros(len(ahead)), rtol=0, atol=1e-5)
    assert bool((ahead[:, 2] < 0).all())


def test_starts_without_a_lamp_are_turned_all_round() -> None:
    model = SphereLight(0)
    starts = model.starts()
    azimuths = starts[:, model.latents].unflatten(0, (TURNS, -1))
    expected = torch.arange(TURNS)[:, None].expand_as(azimuths) * 2 * math.pi / TURNS
    torch.testing.assert_close(azimuths, expected)
    torch.testing.assert_close(starts[:, : model.latents], model.means.repeat(TURNS, 1))


def test_a_narrow_lamp_between_the_cells_of_a_coarse_grid_stays_where_it_is() -> None:
    model = SphereLight(1, 16)
    azimuth, zenith = torch.tensor(0.25), torch.tensor(1.3)  # not in the middle of a cell
    params = model.starts_at(direction_from_angles(azimuth, zenith)[None, None], torch.ones(1, 1))
    params[..., -3] = -2.0  # as narrow as may be
    lamps = model.lamps(params[0])
    solid = model.grid.solid_angles.float()
    mean = (model.lobes(lamps)[:, 0] * solid) @ model.grid.directions.float()
    assert float(angle_between(mean[0].double(), lamps.directions[0, 0].double())) < 0.02


@pytest.mark.parametrize("count", [0, 2])
def test_no_lights_at_all_are_none(count: int) -> None:
    drawn = SpherePrior(count, small_places()).sample((2, 0))
    assert drawn.shape == (2, 0, 2 + LAMP_PARAMETERS * count)
    model = SphereLight(count, 8, small_places())
    assert model(torch.zeros(0, model.parameter_count)).shape == (0, 128, 3)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match="31 rows: give an even number"):
        SphereLight(1, 31)
    with pytest.raises(InputError, match="unknown kind of place 'garden': choose of field, room"):
        SpherePrior(0, small_places(), {"garden": 1.0})
    with pytest.raises(InputError, match="every kind of place is ruled out"):
        SpherePrior(0, small_places(), dict.fromkeys(KINDS, -math.inf))


def test_the_prior_of_latents_is_a_density() -> None:
    prior = SpherePrior(0, small_places()).double()
    axis = torch.linspace(-12, 12, 481, dtype=torch.float64)
    nodes = torch.cartesian_prod(axis, axis)
    total = prior.log_prob(nodes).exp().sum() * (axis[1] - axis[0]) ** 2
    # of a place without a lamp: 0.7 x 0.6 + 0.3 x 0.1
    assert float(total) == pytest.approx(0.45, rel=1e-6)


def test_the_prior_of_a_lamp_is_a_density() -> None:
    """By importance sampling from other densities of each part, with its standard error."""
    prior, generator = SpherePrior(1, small_places()).double(), torch.Generator().manual_seed(0)
    n = 200_000
    z = 2.5 * torch.randn(n, 2, generator=generator, dtype=torch.float64)
    direction = torch.nn.functional.normalize(
        torch.randn(n, 3, generator=generator, dtype=torch.float64), dim=1
    )
    length = 1 + 0.15 * torch.randn(n, 1, generator=generator, dtype=torch.float64)
    rest = 2.0 * torch.randn(n, 4, generator=generator, dtype=torch.float64)

    def log_normal(x: torch.Tensor, spread: float) -> torch.Tensor:
        return (-0.5 * (x / spread) ** 2 - math.log(spread * math.sqrt(2 * math.pi))).sum(1)

    proposed = log_normal(z, 2.5) + log_normal(rest, 2.0) + log_normal(length - 1, 0.15)
    proposed = proposed - math.log(4 * math.pi) - 2 * length[:, 0].log()
    kept = length[:, 0] > 0.2
    x = torch.cat([z, direction * length, rest], 1)
    ratio = torch.where(kept, (prior.log_prob(x) - proposed).exp(), 0.0)
    expected = 0.7 * 0.4 + 0.3 * 0.3
    error = float(ratio.std()) / math.sqrt(n)
    assert error < 0.05 * expected
    assert abs(float(ratio.mean()) - expected) < 4 * error


def test_draws_are_from_that_density() -> None:
    prior, generator = SpherePrior(1, small_places()), torch.Generator().manual_seed(1)
    x = prior.sample(40_000, generator)
    assert x.shape == (40_000, prior.parameter_count)
    # of places with one lamp: 0.7 x 0.4 against 0.3 x 0.3
    shares = prior.responsibilities(x).mean(0)
    torch.testing.assert_close(shares, torch.tensor([0.28, 0.09]) / 0.37, rtol=0, atol=0.01)
    up = torch.nn.functional.normalize(x[:, 2:5], dim=1)[:, 1]
    means = [1 / math.tanh(h) - 1 / h for h in (2.0, -0.5)]
    expected = (0.28 * means[0] + 0.09 * means[1]) / 0.37
    assert float(up.mean()) == pytest.approx(expected, abs=0.01)
    # entropy, by the density itself: bounded by that of importance weights of mean 1
    other = SpherePrior(1, replace(small_places(), means=small_places().means + 0.2))
    weights = (other.log_prob(x) - prior.log_prob(x)).exp()
    assert float(weights.mean()) == pytest.approx(1.0, abs=0.03)


def test_what_else_is_known_of_places_turns_the_odds() -> None:
    x = SpherePrior(1, small_places()).sample(20, torch.Generator().manual_seed(3))
    before = SpherePrior(1, small_places()).responsibilities(x)
    after = SpherePrior(1, small_places(), {"room": 2.0}).responsibilities(x)
    odds = (after[:, 1] / after[:, 0]) / (before[:, 1] / before[:, 0])
    torch.testing.assert_close(odds, torch.full_like(odds, math.exp(2.0)), rtol=1e-3, atol=0)


def test_kinds_of_place_that_are_ruled_out_have_no_share() -> None:
    x = SpherePrior(1, small_places()).sample(50, torch.Generator().manual_seed(2))
    out = {"field": -math.inf}
    only = SpherePrior(1, small_places(), out)
    shares = only.responsibilities(x)
    torch.testing.assert_close(shares, torch.tensor([0.0, 1.0]).expand_as(shares))
    assert SpherePrior(0, small_places(), out).sample(3).shape == (3, 2)


def test_wrong_numbers_are_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"SphereLight's parameters .*latents, azimuth, 7 of each"):
        SphereLight(1)(torch.zeros(2, 9))
    with pytest.raises(InputError, match=r"SpherePrior's parameters .*latents, 7 of each lamp"):
        SpherePrior(1).log_prob(torch.zeros(2, 9))


def test_models_are_written_and_read(tmp_path) -> None:
    path, places = tmp_path / "sphere.safetensors", small_places()
    places.save(path, {"places": "12"})
    read = Places.load(path)
    assert (read.kinds, read.across) == (KINDS, 6)
    for name, each in places.tensors.items():
        assert torch.equal(each, read.tensors[name])
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(InputError, match="holds no usable model of places"):
        Places.load(path)


def test_what_ships_knows_six_kinds_of_place() -> None:
    kinds = {"outdoors", "home", "workplace", "car", "studio", "street"}
    assert set(shipped().kinds) == kinds
    counts = shipped().log_counts.exp().sum(1)
    torch.testing.assert_close(counts, torch.ones(6), rtol=1e-5, atol=0)
    assert SphereLight(3).parameter_count == SphereLight(0).parameter_count + 3 * LAMP_PARAMETERS
