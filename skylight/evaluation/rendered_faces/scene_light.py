"""The illumination of a scene: a simulated sky over one of nine grounds, or a given map."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.evaluation.rendered_faces.map_folder import TurnedMap
from skylight.evaluation.rendered_faces.options import RenderOptions
from skylight.models.ground import GROUND_ALBEDOS, LambertianGround
from skylight.skies.simulated import simulated_skies
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.frame import direction_from_angles

LOWEST_TRANSMITTANCE = 0.5  # the sun is visible
FOCAL_LENGTHS = 1.4, 2.8  # over the picture's side
# Test skies of these faces start here (beyond those that nothing may be trained on), so that
# they are none of the other evaluations' days either.
FIRST_SKY = 100_000_000
_SEEDS_APART = 100_000_000  # from one --seed to the next
_SCENES_APART = 1000  # so that each scene finds a day of its own


@dataclass(frozen=True, kw_only=True)
class SceneLight:
    """What the faces of one scene share. ``environment`` (64 x 128) is in the light's own units.

    The camera looks level along -Z, so its frame is the world's. ``sun`` points to the sun, whose
    light gets through by ``transmittance``. What tells of a simulated sky and its ground is None
    where a given map is the light, and ``turned_map`` where a sky is.
    """

    environment: EnvironmentMap
    focal: float  # over the picture's side
    ground_albedo: Float[Tensor, "3"] | None = None
    sun: Float[Tensor, "3"] | None = None
    transmittance: float | None = None
    sky_seed: int | None = None
    turned_map: TurnedMap | None = None


@lru_cache(maxsize=4)  # finding a day may take seconds
def scene_light(scene: int, options: RenderOptions) -> SceneLight:
    """Light, its azimuth and the focal length follow from the options and ``scene``."""
    return _sky_light(scene, options) if options.maps is None else _map_light(scene, options)


def _map_light(scene: int, options: RenderOptions) -> SceneLight:
    assert options.maps is not None
    rng = np.random.default_rng((options.seed, scene, 0))
    environment, which = options.maps.turned(scene, rng.uniform(-math.pi, math.pi))
    return SceneLight(
        environment=environment, focal=float(rng.uniform(*FOCAL_LENGTHS)), turned_map=which
    )


def _sky_light(scene: int, options: RenderOptions) -> SceneLight:
    ((record, sky),) = simulated_skies(
        1,
        first_seed=FIRST_SKY + _SEEDS_APART * options.seed + _SCENES_APART * scene,
        lowest_transmittance=LOWEST_TRANSMITTANCE if options.sunny else 0.0,
    )
    assert record.seed is not None  # simulated skies have one
    rng = np.random.default_rng((options.seed, scene, 0))
    turn = rng.uniform(-math.pi, math.pi)
    albedo = torch.tensor(GROUND_ALBEDOS[rng.integers(len(GROUND_ALBEDOS))])
    turned = sky.rotate_azimuth(turn).upper()
    ground = LambertianGround(turned.layout[0])
    bounce = ground(turned.flat[None], albedo[None].to(turned.flat))[0]
    angles = math.radians(record.map_azimuth_deg) + turn, math.radians(record.sun_zenith_deg)
    return SceneLight(
        environment=turned.with_ground(bounce),
        ground_albedo=albedo,
        sun=direction_from_angles(*(torch.tensor(a, dtype=torch.float64) for a in angles)),
        transmittance=record.sun_transmittance,
        sky_seed=record.seed,
        focal=float(rng.uniform(*FOCAL_LENGTHS)),
    )
