"""The three spheres: closed forms, an independent integral, and Mitsuba's pictures."""

import math
from typing import get_args

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.inverse._scores import (
    DIFFUSE_ALBEDO,
    LIGHT_ROWS,
    PIXELS,
    SILVER,
    SphereMaterial,
    angular_error_deg,
    render_spheres,
    sphere_scores,
    sphere_transport,
)
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, convert_latlong


def normals() -> torch.Tensor:
    """Of the picture's pixels, written anew: x right, y up, z to the camera."""
    rows, columns = torch.where(sphere_transport().inside)
    x = (columns.double() + 0.5) / (PIXELS / 2) - 1
    y = 1 - (rows.double() + 0.5) / (PIXELS / 2)
    return torch.stack([x, y, (1 - x**2 - y**2).sqrt()], 1)


def smooth_map() -> EnvironmentMap:
    x, y, z = DirectionGrid.latlong(LIGHT_ROWS).directions.unbind(1)
    radiance = torch.stack([1.5 + x, 1.2 + y * z, 1.5 + 0.7 * z - 0.6 * x * y], 1)
    return EnvironmentMap(radiance=radiance.reshape(LIGHT_ROWS, 2 * LIGHT_ROWS, 3).float())


def furnace_albedo(n_v: float, alpha: float) -> float:
    """What a rough metal of reflectance 1 sends back under light 1, in float64.

    Over microfacet normals h: int D(h) G2(v,l) <v,h> / <n,v> dh, with l the mirrored v and
    G2 = 1 / (1 + Lambda(v) + Lambda(l)) (Heitz 2014, eq. 99); facets that mirror below count 0.
    """

    def masking(cosine: np.ndarray) -> np.ndarray:
        tangent2 = (1 - cosine**2) / cosine**2
        return (np.sqrt(1 + alpha**2 * tangent2) - 1) / 2

    # D cos dh = du with tan^2 theta = alpha^2 u / (1 - u)
    u, phi = np.meshgrid((np.arange(800) + 0.5) / 800, (np.arange(400) + 0.5) / 400 * 2 * np.pi)
    cosine = 1 / np.sqrt(1 + alpha**2 * u / (1 - u))
    sine = np.sqrt(1 - cosine**2)
    view = np.array([math.sqrt(1 - n_v**2), 0.0, n_v])
    v_h = sine * np.cos(phi) * view[0] + cosine * view[2]
    n_l = 2 * v_h * cosine - n_v
    lit = (n_l > 0) & (v_h > 0)
    masked = 1 / (1 + masking(np.array(n_v)) + masking(np.where(lit, n_l, 1.0)))
    return float(np.mean(np.where(lit, v_h * masked / (n_v * cosine), 0.0)))


def test_constant_light() -> None:
    shown = render_spheres(EnvironmentMap(radiance=torch.full((16, 32, 3), 3.0)))
    assert len(shown["mirror"]) == 3228
    torch.testing.assert_close(shown["mirror"], torch.full_like(shown["mirror"], 3.0))
    torch.testing.assert_close(
        shown["diffuse"], torch.full_like(shown["diffuse"], 3.0 * DIFFUSE_ALBEDO), rtol=2e-3, atol=0
    )
    cosines = normals()[:, 2]
    for n_v in (0.97, 0.8, 0.5, 0.3):
        here = (cosines - n_v).abs() < 0.01
        expected = np.mean([furnace_albedo(float(c), SILVER.alpha) for c in cosines[here][:8]])
        found = shown["silver"][here][:8].double().mean() / 3.0
        assert float(found) == pytest.approx(expected, rel=5e-3)


def test_one_direction_on_the_diffuse_sphere_is_the_clamped_cosine() -> None:
    grid = DirectionGrid.latlong(LIGHT_ROWS)
    for place in (900, 3000, 5000, 7000):
        radiance = torch.zeros(len(grid), 3)
        radiance[place] = torch.tensor([100.0, 50.0, 25.0])
        light = EnvironmentMap(radiance=radiance.reshape(LIGHT_ROWS, 2 * LIGHT_ROWS, 3))
        power = radiance[place].double() * grid.solid_angles[place]
        cosine = (normals() @ grid.directions[place]).clamp(min=0)
        expected = DIFFUSE_ALBEDO / math.pi * cosine[:, None] * power
        found = render_spheres(light)["diffuse"].double()
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-7)


def test_the_mirror_shows_what_it_reflects() -> None:
    directions = DirectionGrid.latlong(LIGHT_ROWS).directions
    coded = (directions + 2).reshape(LIGHT_ROWS, 2 * LIGHT_ROWS, 3).float()
    shown = render_spheres(EnvironmentMap(radiance=coded))["mirror"].double() - 2
    normal = normals()
    reflected = 2 * normal[:, 2:] * normal - torch.tensor([0.0, 0.0, 1.0])
    # a pixel near the rim sees a wide angle, so its mean is short
    within = normal[:, 2] > 0.25
    torch.testing.assert_close(shown[within], reflected[within], atol=0.02, rtol=0)


def test_mitsuba_renders_the_same_spheres() -> None:
    mi = pytest.importorskip("mitsuba", reason="mitsuba is not installed")
    if "scalar_rgb" not in mi.variants():
        pytest.skip("this mitsuba has no scalar_rgb variant")
    mi.set_variant("scalar_rgb")
    light = smooth_map()
    bitmap = convert_latlong(light.radiance, "skylight", "mitsuba").contiguous()
    materials: dict[SphereMaterial, dict] = {
        "mirror": {"type": "conductor", "material": "none"},
        "silver": {
            "type": "roughconductor", "material": "none", "distribution": "ggx",
            "alpha": SILVER.alpha,
        },
        "diffuse": {"type": "diffuse", "reflectance": {"type": "rgb", "value": DIFFUSE_ALBEDO}},
    }  # fmt: skip
    shown = render_spheres(light)
    inside = sphere_transport().inside
    within = inside.clone()
    within[inside] = normals()[:, 2] > 0.3
    for name, material in materials.items():
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": 2},
                "light": {"type": "envmap", "bitmap": mi.Bitmap(bitmap.numpy())},
                "sensor": {
                    "type": "orthographic",
                    "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
                    "film": {
                        "type": "hdrfilm", "width": PIXELS, "height": PIXELS,
                        "rfilter": {"type": "box"}, "pixel_format": "rgb",
                    },
                    "sampler": {"type": "independent", "sample_count": 32},
                },
                "ball": {"type": "sphere", "bsdf": material},
            }
        )  # fmt: skip
        seen = torch.from_numpy(np.array(mi.render(scene)))
        ours = torch.zeros_like(seen)
        ours[inside] = shown[name].float()
        # of blocks of 8 x 8 pixels, in which the noise of 32 samples averages out
        whole = blocks(within.float()[..., None])[..., 0] == 1
        difference = (blocks(ours) - blocks(seen))[whole]
        level = float(seen[within].mean())
        assert len(difference) > 20
        assert float(difference.mean(0).abs().max()) < 0.01 * level, name
        assert float(difference.abs().max()) < 0.04 * level, name


def blocks(picture: torch.Tensor) -> torch.Tensor:
    size = PIXELS // 8
    return picture.reshape(size, 8, size, 8, -1).mean((1, 3))


def test_colours_apart_by_a_known_angle() -> None:
    true = torch.tensor([[1.0, 0.0, 0.0], [2.0, 2.0, 0.0], [0.0, 0.0, 0.0]])
    pred = torch.tensor([[5.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    assert angular_error_deg(pred, true) == pytest.approx(22.5)
    assert angular_error_deg(torch.zeros_like(true), true) == pytest.approx(90)
    assert angular_error_deg(true * 3, true) == pytest.approx(0, abs=1e-6)
    with pytest.raises(InputError, match="black"):
        angular_error_deg(true, torch.zeros_like(true))


def test_a_sky_alone_is_refused() -> None:
    with pytest.raises(InputError, match="all round"):
        render_spheres(EnvironmentMap(radiance=torch.ones(8, 32, 3)))


def test_scores_of_spheres_know_colour_and_no_scale() -> None:
    """Twice as bright is as good; light (1,1,1) called (1,1,0) is acos(sqrt(2/3)) off."""
    truth = smooth_map()
    scores = sphere_scores(EnvironmentMap(radiance=2 * truth.radiance), truth)
    assert set(scores) == {
        f"{material}_{metric}"
        for material in get_args(SphereMaterial)
        for metric in ("si_rmse", "angle_deg")
    }
    assert max(scores.values()) < 1e-4
    white = EnvironmentMap(radiance=torch.ones(LIGHT_ROWS, 2 * LIGHT_ROWS, 3))
    yellow = EnvironmentMap(radiance=white.radiance * torch.tensor([1.0, 1.0, 0.0]))
    off = sphere_scores(yellow, white)
    for material in get_args(SphereMaterial):
        assert off[f"{material}_angle_deg"] == pytest.approx(
            math.degrees(math.acos(math.sqrt(2 / 3))), abs=1e-3
        )
        # a = 2 / 2, and one channel of three is missing: sqrt(1/3) of the mean
        assert off[f"{material}_si_rmse"] == pytest.approx(math.sqrt(1 / 3), rel=1e-3)
