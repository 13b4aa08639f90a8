"""Analytic light seen by a virtual camera that turns: a rippled sphere and a sun's disc."""

import math
from functools import cache

import numpy as np
from jaxtyping import Float

from skylight.probes.cameras._exposures import merge
from skylight.probes.panorama._matches import Lens, Shot, shot_of
from skylight.sphere._envmap import EnvironmentMap
from tests.virtual_camera import Head, expose, picture

SUN = np.array([0.5, 0.35, -0.79]) / np.linalg.norm([0.5, 0.35, -0.79])
SUN_RAD, SUN_RADIANCE = math.radians(1.5), 3000.0
# integral of the cosine to the sun over its disc: pi sin^2
SUN_IRRADIANCE = math.pi * math.sin(SUN_RAD) ** 2 * SUN_RADIANCE
LENS = Lens(width=180, height=150, focal_px=120.0, k1=-0.06)
HEAD = Head(8, (-45.0, 0.0, 45.0), error_deg=2.0)
TIMES = (1 / 4096, 1 / 256, 1 / 16, 1.0)


def rippled(w: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """About 0.2, with ripples of 4 to 40 degrees; their phases in float32, good to 1e-5."""
    rng = np.random.default_rng(5)
    waves = rng.standard_normal((60, 3))
    waves *= np.geomspace(9, 90, 60)[:, None] / np.linalg.norm(waves, axis=1, keepdims=True)
    phases = w.astype(np.float32) @ waves.T.astype(np.float32)
    heights = np.sin(phases + rng.uniform(0, 6, 60).astype(np.float32)).sum(1) * 0.16
    return 0.2 * np.exp(heights)[:, None] * np.array([1.0, 0.9, 0.7])


def sunny(w: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """The same with a sun."""
    light = rippled(w)
    light[w @ SUN > math.cos(SUN_RAD)] = SUN_RADIANCE
    return light


@cache
def pictures() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """(where the camera looked, what it saw) of each shot."""
    turns = HEAD.true(np.random.default_rng(3))
    return turns, [picture(sunny, turn, LENS) for turn in turns]


@cache
def shots(bits: int = 16, times: tuple[float, ...] = TIMES) -> list[Shot]:
    rng = np.random.default_rng(4)
    return [
        shot_of(
            f"shot {number}",
            merge([expose(seen, time, rng, bits, f"{time} s") for time in times], "srgb"),
        )
        for number, seen in enumerate(pictures()[1])
    ]


def sun_irradiance(
    environment: EnvironmentMap, turn: Float[np.ndarray, "3 3"] | None = None
) -> Float[np.ndarray, "3"]:
    """On a surface that faces the sun, of what is within four degrees of its edge.

    ``turn`` leads from the world to the map's frame.
    """
    grid = environment.grid
    sun = SUN if turn is None else turn @ SUN
    cosine = grid.directions.numpy() @ sun
    near = cosine > math.cos(SUN_RAD + math.radians(4))
    weight = cosine * grid.solid_angles.numpy() * near
    return weight @ environment.flat.double().numpy()
