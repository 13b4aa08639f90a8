"""``AutoencoderLight.encode``: maps as people have them, and what turns and scales do to them."""

import math
from collections.abc import Iterator

import jaxtyping
import pytest
import torch
from torch import Tensor

from skylight.errors import InputError
from skylight.models._bundle import load_bundle
from skylight.models._network import CENTRE_AZIMUTH_RAD, HEIGHT, WIDTH
from skylight.models.autoencoder import AutoencoderLight
from skylight.sphere._envmap import EnvironmentMap, averaged
from skylight.sphere._frame import DirectionGrid, angle_between, direction_from_angles

PIXEL_RAD = 2 * math.pi / WIDTH
SUN = 2000.0, 3000.0  # radiance above the sky's, sharpness


@pytest.fixture(scope="module")
def light() -> AutoencoderLight:
    return load_bundle().light()


@pytest.fixture
def unchecked() -> Iterator[None]:
    """As users have it: no checks of annotations."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def drawn(
    azimuth: float,
    zenith: float = 0.8,
    *,
    rows: int = HEIGHT,
    spots: tuple[tuple[float, float, float, float], ...] = (),
    sun: tuple[float, float] = SUN,
) -> Tensor:
    """A sky that is brighter towards its sun, and further lobes: pixels are means of 4 x 4."""
    grid = DirectionGrid.sky(4 * rows)
    at = grid.directions
    towards = at @ direction_from_angles(*torch.tensor([azimuth, zenith], dtype=torch.float64))
    radiance = 0.5 + 0.5 * at[:, 1] + 0.3 * towards.clamp(min=0)
    for where, height, level, sharpness in ((azimuth, zenith, *sun), *spots):
        lobe = direction_from_angles(*torch.tensor([where, height], dtype=torch.float64))
        radiance = radiance + level * torch.exp(sharpness * (at @ lobe - 1))
    colours = radiance[:, None] * torch.tensor([0.9, 1.0, 1.2]).double()
    return averaged(colours.reshape(4 * rows, 16 * rows, 3), rows).float()


def away(light: AutoencoderLight, sky: Tensor, azimuth: float, zenith: float = 0.8) -> float:
    """Angle between the encoded sun and the true one, rad."""
    true = direction_from_angles(*torch.tensor([azimuth, zenith], dtype=torch.float64))
    found = light.sun_direction(light.encode(sky)[0])
    assert found is not None
    return float(angle_between(found.double(), true))


def turned_back(azimuth: Tensor, by: Tensor) -> Tensor:
    """The difference of angles, about 0."""
    return (azimuth - by + math.pi) % (2 * math.pi) - math.pi


@pytest.mark.parametrize("zenith", [0.0, 0.02, 0.3, 0.8, 1.3, 1.5, math.pi / 2])
@pytest.mark.parametrize("azimuth", [0.0, 1.1, -math.pi, math.pi - 0.01])
def test_the_sun_stays_within_a_pixel(
    light: AutoencoderLight, azimuth: float, zenith: float
) -> None:
    assert away(light, drawn(azimuth, zenith), azimuth, zenith) < PIXEL_RAD


@pytest.mark.parametrize("rows", [13, 20, 50, 96])
def test_skies_of_any_height_are_taken(light: AutoencoderLight, rows: int) -> None:
    sky = drawn(0.4, rows=rows)
    assert away(light, sky, 0.4) < max(PIXEL_RAD, math.pi / 2 / rows)
    params, scale = light.encode(sky)
    same, level = light.encode(averaged(sky, HEIGHT))
    torch.testing.assert_close(scale, level, rtol=1e-4, atol=0.0)
    if rows % HEIGHT == 0:
        torch.testing.assert_close(params[:-6], same[:-6], rtol=0, atol=0.05)


def test_a_turn_by_whole_columns_changes_the_azimuth_alone(light: AutoencoderLight) -> None:
    columns = torch.tensor([0, 1, 37, 64, 127])
    maps = torch.stack([drawn(0.3).roll(int(c), 1) for c in columns])
    params, scale = light.encode(maps)
    torch.testing.assert_close(params[:, :-1], params[:1, :-1].expand(5, -1), rtol=0, atol=1e-4)
    turn = turned_back(params[:, -1], columns * PIXEL_RAD + params[0, -1])
    torch.testing.assert_close(turn, torch.zeros(5), rtol=0, atol=1e-5)
    torch.testing.assert_close(scale, scale[:1].expand(5), rtol=1e-6, atol=0.0)


@pytest.mark.parametrize(("rows", "sharpness"), [(32, 0.5), (96, 0.1)])
def test_a_turn_by_any_angle_does_so_up_to_the_sun_s_sharpness(
    light: AutoencoderLight, rows: int, sharpness: float
) -> None:
    """That depends on where a sun smaller than a pixel stands among the pixels."""
    azimuth = torch.tensor([0.0, 0.0123, 0.3, 3.14])
    params, _ = light.encode(torch.stack([drawn(float(a), rows=rows) for a in azimuth]))
    apart = (params - params[:1]).abs()
    assert float(turned_back(params[:, -1], azimuth).abs().max()) < PIXEL_RAD / 50
    assert float(apart[:, :-2].max()) < 0.01
    assert float(apart[:, -2].max()) < sharpness


def test_a_brighter_map_changes_the_scale_alone(light: AutoencoderLight) -> None:
    sky = drawn(0.3)
    (params, scale), (same, brighter) = light.encode(sky), light.encode(sky * 50)
    torch.testing.assert_close(same, params, rtol=0, atol=1e-4)
    torch.testing.assert_close(brighter, 50 * scale)
    grid = DirectionGrid.sky(HEIGHT)
    level = EnvironmentMap(radiance=sky.double()).integrate() / (2 * math.pi)
    assert float(grid.solid_angles.sum()) == pytest.approx(2 * math.pi)
    assert float(scale) == pytest.approx(
        float(level @ torch.tensor([0.2126, 0.7152, 0.0722]).double()), rel=1e-5
    )


def test_full_maps_are_their_upper_halves(light: AutoencoderLight) -> None:
    sky = drawn(0.3)
    ground = EnvironmentMap(radiance=sky).with_ground(torch.tensor([900.0, 9.0, 1.0]))
    for found, expected in zip(light.encode(ground), light.encode(sky), strict=True):
        assert torch.equal(found, expected)


def test_batches_are_loops_and_so_is_vmap(light: AutoencoderLight) -> None:
    maps = torch.stack([drawn(0.3), drawn(1.9, 0.4), drawn(-2.0, 1.3)])
    params, scale = light.encode(maps)
    for found, sky in zip(params, maps, strict=True):
        torch.testing.assert_close(found, light.encode(sky)[0], rtol=0, atol=1e-4)
    more, scales = light.encode(maps[None].expand(2, -1, -1, -1, -1))
    assert (more.shape, scales.shape) == ((2, 3, 65), (2, 3))
    assert light.encode(maps[:0])[0].shape == (0, 65)
    mapped = torch.func.vmap(light.encode)(maps)
    torch.testing.assert_close(mapped[0], params, rtol=0, atol=1e-4)
    torch.testing.assert_close(mapped[1], scale)


@pytest.mark.parametrize(
    "spot",
    [(-1.0, 0.7, 1000.0, 3000.0), (-1.0, 0.7, 100.0, 40.0), (0.5, 0.0, 20.0, 1000.0)],
    ids=["half the sun", "a bright cloud of more light", "in the zenith"],
)
def test_the_sun_is_found_beside_other_bright_spots(
    light: AutoencoderLight, spot: tuple[float, float, float, float]
) -> None:
    assert away(light, drawn(1.1, spots=(spot,)), 1.1) < PIXEL_RAD


def test_without_a_sun_it_is_the_brightest_place(light: AutoencoderLight) -> None:
    params, scale = light.encode(drawn(1.1, sun=(0.0, 1.0)))
    assert float(params[-1]) == pytest.approx(1.1, abs=PIXEL_RAD)
    again = light(params) * scale
    assert float((again / drawn(1.1, sun=(0.0, 1.0)).flatten(0, 1)).log().abs().mean()) < 0.03
    flat, one = light.encode(torch.ones(HEIGHT, WIDTH, 3))
    assert flat.isfinite().all()
    assert float(one) == pytest.approx(1)


def test_it_is_as_good_as_the_network_on_centred_skies(light: AutoencoderLight) -> None:
    """On skies that other latents make: the mean error of log(L + 0.02)."""
    z = light.bank[::40]
    centred = light.network.decode(z)
    own = light.network.decode(light.network.encode(centred))
    azimuth = CENTRE_AZIMUTH_RAD + 7 * PIXEL_RAD * torch.arange(len(z))
    maps = 7 * light(torch.cat([z, azimuth[:, None]], 1)).unflatten(1, (HEIGHT, WIDTH))
    params, scale = light.encode(maps)
    ours = scale[:, None, None] * light(params) / 7
    expected = ((own + 0.02).log() - (centred + 0.02).log()).abs().mean()
    found = ((ours + 0.02).log() - (maps / 7 + 0.02).flatten(1, 2).log()).abs().mean()
    assert float(found) < 1.02 * float(expected)
    turn = light.encode(centred)[0][:, -1] - CENTRE_AZIMUTH_RAD
    assert float(turn.abs().median()) < PIXEL_RAD / 2


def test_gradients_are_differences_and_finite_without_a_sun() -> None:
    light = load_bundle().light().double()
    sky = drawn(0.3).double()
    along = torch.rand(sky.shape, generator=torch.Generator().manual_seed(0)).double() * sky

    def of(step: Tensor) -> Tensor:
        params, scale = light.encode(sky + step * along)
        return torch.cat([params, scale[None]])

    step = torch.tensor(1e-6).double()
    slopes = (of(step) - of(-step)) / (2 * step)
    found = torch.autograd.functional.jacobian(of, torch.zeros(()).double())
    # the sharpness is searched for
    assert isinstance(found, Tensor)
    torch.testing.assert_close(found, slopes, rtol=1e-3, atol=1e-5)
    for dull in (torch.ones_like(sky), drawn(0.3, 0.0).double()):
        dull.requires_grad_()
        light.encode(dull)[0].sum().backward()
        assert dull.grad is not None
        assert dull.grad.isfinite().all()


@pytest.mark.parametrize(
    ("maps", "said"),
    [
        (torch.ones(32, 100, 3), "twice as wide as high"),
        (torch.ones(33, 66, 3), "the horizon of maps of 33 rows"),
        (torch.ones(32, 128), "maps of shape"),
        (torch.ones(1, 3, 32, 128), "maps of shape"),
        (torch.ones(32, 128, 3).long(), "floating point"),
        (torch.zeros(2, 32, 128, 3), "map 0 is black"),
        (-torch.ones(32, 128, 3), "negative, NaN or infinite"),
        (torch.full((32, 128, 3), math.nan), "negative, NaN or infinite"),
    ],
)
def test_what_is_no_light_is_refused(
    light: AutoencoderLight, unchecked: None, maps: Tensor, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        light.encode(maps)
