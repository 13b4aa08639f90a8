"""The illumination of a scene: a sky over one of nine grounds, or a given map."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.evaluation.rendered_faces.light.distant_light import DistantLight, SunDisc
from skylight.evaluation.rendered_faces.light.hosek_wilkie import (
    SUN_ELEVATIONS_DEG,
    TURBIDITIES,
    hosek_wilkie_sky,
)
from skylight.evaluation.rendered_faces.map_folder import ROWS, TurnedMap
from skylight.evaluation.rendered_faces.options import RenderOptions
from skylight.models.ground import GROUND_ALBEDOS, LambertianGround
from skylight.skies.simulated import evaluation_skies
from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.sphere.frame import direction_from_angles

LOWEST_TRANSMITTANCE = 0.5  # the sun is visible
# Of the sky's light: a fainter sun is in the map alone, since half of all light samples would go to
# it where it is an emitter.
FAINT_SUN = 1e-3
FOCAL_LENGTHS = 1.4, 2.8  # over the picture's side
# Test skies of these faces start here (beyond those that nothing may be trained on), so that
# they are none of the other evaluations' days either.
FIRST_SKY = 100_000_000
_SEEDS_APART = 100_000_000  # from one --seed to the next
_SCENES_APART = 1000  # so that each scene finds a day of its own


@dataclass(frozen=True, kw_only=True)
class SceneLight:
    """What the faces of one scene share. ``light`` (64 x 128) is in units of its own.

    The camera looks level along -Z, so its frame is the world's. ``sun`` points to the sun, whose
    light gets through clouds by ``transmittance``, also where none does. What tells of a sky and
    its ground is None where a given map is the light, and ``turned_map`` where a sky is;
    ``sky_seed`` is that of a simulated sky, ``turbidity`` that of one of Hosek & Wilkie.
    """

    light: DistantLight
    focal: float  # over the picture's side
    ground_albedo: Float[Tensor, "3"] | None = None
    sun: Float[Tensor, "3"] | None = None
    transmittance: float | None = None
    sky_seed: int | None = None
    turbidity: float | None = None
    turned_map: TurnedMap | None = None


@lru_cache(maxsize=4)  # finding a day may take seconds
def scene_light(scene: int, options: RenderOptions) -> SceneLight:
    """Light, its azimuth and the focal length follow from the options and ``scene``."""
    light = _light_of_seed(scene, options)
    if options.light_seed is None:
        return light
    other = _light_of_seed(scene, replace(options, seed=options.light_seed))
    return replace(other, focal=light.focal)


def _light_of_seed(scene: int, options: RenderOptions) -> SceneLight:
    if options.maps is not None:
        return _map_light(scene, options)
    if options.skies == "hosek-wilkie":
        return _hosek_wilkie_light(scene, options)
    return _simulated_light(scene, options)


def _map_light(scene: int, options: RenderOptions) -> SceneLight:
    assert options.maps is not None
    rng = np.random.default_rng((options.seed, scene, 0))
    environment, which = options.maps.turned(scene, rng.uniform(-math.pi, math.pi))
    return SceneLight(
        light=DistantLight(environment), focal=float(rng.uniform(*FOCAL_LENGTHS)), turned_map=which
    )


def _simulated_light(scene: int, options: RenderOptions) -> SceneLight:
    ((record, simulated),) = evaluation_skies(
        1,
        first_seed=FIRST_SKY + _SEEDS_APART * options.seed + _SCENES_APART * scene,
        lowest_transmittance=LOWEST_TRANSMITTANCE if options.sunny else 0.0,
    )
    assert record.seed is not None  # simulated skies have one
    rng = np.random.default_rng((options.seed, scene, 0))
    turn, albedo, focal = _drawn(rng)
    direction = _direction(math.radians(record.map_azimuth_deg) + turn, record.sun_zenith_deg)
    sun = SunDisc(direction=direction, irradiance=simulated.sun_irradiance)
    light = over_ground(simulated.sunless.rotate_azimuth(turn), sun, albedo)
    if luminance(sun.irradiance) < FAINT_SUN * luminance(simulated.sunless.integrate()):
        light = DistantLight(light.environment)
    return SceneLight(
        light=light,
        ground_albedo=albedo,
        sun=direction,
        transmittance=record.sun_transmittance,
        sky_seed=record.seed,
        focal=focal,
    )


def _hosek_wilkie_light(scene: int, options: RenderOptions) -> SceneLight:
    rng = np.random.default_rng((options.seed, scene, 0))
    turn, albedo, focal = _drawn(rng)
    turbidity = float(rng.uniform(*TURBIDITIES))
    direction = _direction(turn, 90.0 - rng.uniform(*SUN_ELEVATIONS_DEG))
    sky, sun = hosek_wilkie_sky(turbidity, albedo, direction, ROWS // 2)
    return SceneLight(
        light=over_ground(sky, sun, albedo),
        ground_albedo=albedo,
        sun=direction,
        transmittance=1.0,  # a sky without clouds
        turbidity=turbidity,
        focal=focal,
    )


def over_ground(
    sky: EnvironmentMap, sun: SunDisc | None, albedo: Float[Tensor, "3"]
) -> DistantLight:
    """A sky and its sun over an infinite Lambertian plane, which both of them light."""
    full = DistantLight(sky.with_ground(torch.zeros(3)), sun).environment.upper()
    bounce = LambertianGround(full.layout[0])(full.flat[None], albedo[None].to(full.flat))[0]
    return DistantLight(sky.with_ground(bounce), sun)


def _drawn(rng: np.random.Generator) -> tuple[float, Float[Tensor, "3"], float]:
    """A turn about the vertical, the ground's albedo, the focal length."""
    turn = rng.uniform(-math.pi, math.pi)
    albedo = torch.tensor(GROUND_ALBEDOS[rng.integers(len(GROUND_ALBEDOS))])
    return turn, albedo, float(rng.uniform(*FOCAL_LENGTHS))


def _direction(azimuth_rad: float, zenith_deg: float) -> Float[Tensor, "3"]:
    angles = azimuth_rad, math.radians(zenith_deg)
    return direction_from_angles(*(torch.tensor(a, dtype=torch.float64) for a in angles))
