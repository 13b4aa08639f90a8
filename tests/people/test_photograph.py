"""Background, exposure and noise."""

import math

import numpy as np
import pytest
import torch

pytest.importorskip("mitsuba", reason="mitsuba is not installed")

from skylight.imaging._colour import srgb_to_linear
from skylight.people._background import background
from skylight.people._light import DistantLight, RenderOptions, SunDisc
from skylight.people._people import Seen, person
from skylight.people._render import brightest_skin, compose, exposure_for, photograph
from skylight.people._subsurface import patches
from skylight.people._trace import Layers
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import angles_from_direction
from skylight.transport._cameras import Camera

CAMERA = Camera(focal_px=64.0, width=48, height=48, center_px=(24.0, 24.0))


def test_the_background_is_what_lies_ahead() -> None:
    """A map whose red is the azimuth and whose green is the zenith angle."""
    plain = EnvironmentMap(radiance=torch.zeros(64, 128, 3))
    azimuth, zenith = angles_from_direction(plain.grid.directions)
    named = torch.stack([azimuth, zenith, zenith * 0], -1).reshape(64, 128, 3).float()
    seen = background(DistantLight(EnvironmentMap(radiance=named)), CAMERA)
    assert seen[24, 47, 0] == pytest.approx(math.atan(23.5 / 64), abs=0.005)
    assert seen[24, 0, 0] == pytest.approx(-math.atan(23.5 / 64), abs=0.005)
    assert seen[0, 24, 1] == pytest.approx(math.pi / 2 - math.atan(23.5 / 64), abs=0.005)


def test_the_sun_ahead_is_a_disc_in_the_background() -> None:
    sun = SunDisc(direction=torch.tensor([0.0, 0.0, -1.0]).double(), irradiance=torch.ones(3))
    dark = EnvironmentMap(radiance=torch.zeros(16, 32, 3))
    camera = Camera(focal_px=2000.0, width=48, height=48, center_px=(24.0, 24.0))
    seen = background(DistantLight(dark, sun), camera)
    np.testing.assert_allclose(seen.sum((0, 1)) / 2000**2, 1, rtol=0.01)
    rows, columns = np.nonzero(seen[..., 0])
    assert rows.max() - rows.min() + 1 == pytest.approx(2 * 2000 * math.tan(0.00465), abs=1.5)
    assert columns.min() + columns.max() == 47


def facing_square(depth_m: float) -> tuple[Seen, np.ndarray, np.ndarray]:
    """Pixels of a square that faces the camera, 10 of its 48 columns empty, and its two faces."""
    width = depth_m / CAMERA.focal_px
    x, y = np.meshgrid((np.arange(48) - 23.5) * width, (23.5 - np.arange(48)) * width)
    skin = np.ones((48, 48), bool)
    skin[:, :10] = False
    places = np.where(skin[..., None], np.stack([x, y, np.full_like(x, -depth_m)], -1), 0)
    left, right, end = -14 * width, 24 * width, 24 * width
    corners = np.array([[left, -end, 0], [right, -end, 0], [right, end, 0], [left, end, 0]])
    corners[:, 2] = -depth_m
    seen = Seen(positions=places, skin=skin, bare=skin, hair=~skin)
    return seen, corners, np.array([[0, 1, 2], [0, 2, 3]])


def test_layers_add_up() -> None:
    """Even light, so that scattering changes nothing; without it a shadow's edge is blurred."""
    rng = np.random.default_rng(0)
    albedo = rng.uniform(0.1, 0.6, (48, 48, 3))
    cover = np.ones((48, 48))
    cover[:, :10] = 0
    albedo[:, :10] = 0
    seen, corners, faces = facing_square(0.064)  # pixels of 1 mm
    skin = patches(corners, faces, np.arange(2), 1e-6)
    light = EnvironmentMap(radiance=torch.full((16, 32, 3), 3.0))
    backdrop = background(DistantLight(light), CAMERA)

    def picture(lit: np.ndarray, entering: np.ndarray) -> np.ndarray:
        layers = Layers(
            diffuse=albedo * lit,
            specular=np.full((48, 48, 3), 0.25),
            albedo=albedo,
            cover=cover,
            entering=entering,
        )
        return compose(layers, seen, skin, CAMERA, backdrop)

    even = picture(np.full((48, 48, 3), 2.0), np.full((len(skin.areas), 3), 2.0))
    np.testing.assert_allclose(even[:, 10:], albedo[:, 10:] * 2 + 0.25, rtol=1e-5)
    np.testing.assert_allclose(even[:, :10], 3.25, rtol=1e-5)
    right = np.repeat(seen.positions[..., :1] > 0, 3, -1).astype(float)
    half = picture(right, np.repeat(skin.positions[:, :1] > 0, 3, 1).astype(float))
    left = (half[:, 10:] - 0.25) / albedo[:, 10:]
    red, green, blue = left[20:28, 13].mean(0)  # half a millimetre into the shadow
    assert 0.5 > red > green > blue > 0.02


def test_skin_in_even_light_is_as_bright_as_its_albedo_and_exposed_below_white() -> None:
    pale, dark = (person(n, 2.0, RenderOptions(size=48)) for n in (0, 5))
    even = EnvironmentMap(radiance=torch.full((32, 64, 3), 2.0))
    brightest = brightest_skin(pale, even)
    assert brightest == pytest.approx(2 * np.quantile(pale.paint.albedo[:, 0], 0.9), rel=0.2)
    exposure = exposure_for([dark, pale], even, np.random.default_rng(0))
    assert 0.69 < exposure * brightest < 0.96
    assert exposure < exposure_for([dark], even, np.random.default_rng(0)) / 2


@pytest.mark.parametrize("level", [0.04, 0.5])
def test_noise_grows_with_the_root_of_light(level: float) -> None:
    codes = photograph(np.full((200, 200, 3), level), np.random.default_rng(0))
    linear = srgb_to_linear(torch.from_numpy(codes).float() / 255).numpy()
    assert linear.mean() == pytest.approx(level, rel=2e-3)
    step = np.gradient(srgb_to_linear(torch.arange(256) / 255).numpy())[int(codes.mean())]
    want = math.sqrt(level / 8000 + (4 / 8000) ** 2 + step**2 / 12)
    assert linear.std() == pytest.approx(want, rel=0.1)


def test_overexposed_light_is_white() -> None:
    assert (photograph(np.full((4, 4, 3), 2.0), np.random.default_rng(0)) == 255).all()
