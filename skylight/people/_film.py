"""A path-traced film: one person who turns the head, before a camera that turns too.

The light stands still in the world, whose frame is the first picture's camera's. Behind the person
is the light itself, with a texture that is fixed in the world, as far away as it.
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray
from scipy.spatial.transform import Rotation

from skylight.people._background import background
from skylight.people._light import DistantLight, RenderOptions, SceneLight, scene_light
from skylight.people._people import Cap, Person, person, seen_parts
from skylight.people._render import compose, exposure_for, photograph
from skylight.people._subsurface import REACH_MM, patches_in_reach
from skylight.people._trace import trace
from skylight.sphere._envmap import EnvironmentMap

# Degrees: the head against the camera, and the camera against the world, to either side.
_HEAD_YAW, _HEAD_PITCH = 28.0, 7.0
_PAN, _TILT, _ROLL = 15.0, 3.0, 2.0
_AUTO_EXPOSURE = 0.12  # of the logarithm, to either side
_TEXTURE_HEIGHT = 1024
_TEXTURE_CELLS = 16, 48, 160  # columns of its octaves are so many to a quarter turn
_TEXTURE_SPREAD = 0.25  # of the logarithm, of each octave


@dataclass(frozen=True, kw_only=True)
class FilmTruth:
    """What a film was made from: ``world_from_camera`` (3,3) and ``exposure`` of each frame.

    The light is in the world's frame and units of its own.
    """

    light: SceneLight
    focal_px: float
    world_from_camera: list[Float[ndarray, "3 3"]]
    exposures: list[float]


def film_truth(number: int, frames: int, options: RenderOptions) -> FilmTruth:
    """Film ``number``: its light, and how its camera turns."""
    lit = scene_light(number, options)
    who = person(number, lit.focal, options)
    rng = np.random.default_rng((options.seed, number, 3))
    exposure = exposure_for([who], lit.light.environment, rng)
    turns, exposures = [], []
    for k in range(frames):
        share = k / max(frames - 1, 1)
        pan, tilt, roll = (
            _PAN * math.sin(math.pi * share),
            _TILT * math.sin(3 * math.pi * share),
            _ROLL * math.sin(2 * math.pi * share),
        )
        turns.append(Rotation.from_euler("yxz", [pan, tilt, roll], degrees=True).as_matrix())
        exposures.append(exposure * math.exp(_AUTO_EXPOSURE * math.sin(5 * math.pi * share)))
    focal_px = who.truth.camera.focal_px
    return FilmTruth(light=lit, focal_px=focal_px, world_from_camera=turns, exposures=exposures)


def film_frame(
    number: int, frame: int, frames: int, options: RenderOptions
) -> UInt8[ndarray, "h w 3"]:
    """The codes of one frame, from the numbers and options alone."""
    truth = film_truth(number, frames, options)
    turn, lit = truth.world_from_camera[frame], truth.light
    who = _turned_head(person(number, lit.focal, options), frame / max(frames - 1, 1))
    seed = int(np.random.default_rng((options.seed, number, frame, 4)).integers(2**30))
    seen, camera = seen_parts(who), who.truth.camera
    patches = patches_in_reach(who, seen, REACH_MM / 1000)
    layers = trace(
        who, lit.light, patches, samples=options.samples, seed=seed, world_from_camera=turn
    )
    behind = DistantLight(textured(lit.light.diffuse, number), lit.light.sun)
    linear = compose(layers, seen, patches, camera, background(behind, camera, turn))
    rng = np.random.default_rng((options.seed, number, frame, 5))
    return photograph(truth.exposures[frame] * linear, rng)


def textured(environment: EnvironmentMap, seed: int) -> EnvironmentMap:
    """A map with a log-normal texture on it, fine enough for a telephoto lens."""
    rng = np.random.default_rng((seed, 6))
    size = 2 * _TEXTURE_HEIGHT, _TEXTURE_HEIGHT
    logs = np.zeros((size[1], size[0]), np.float32)
    for cells in _TEXTURE_CELLS:
        coarse = rng.normal(0, _TEXTURE_SPREAD, (2 * cells, 4 * cells)).astype(np.float32)
        around = np.concatenate([coarse, coarse[:, :1]], 1)
        logs += cv2.resize(around, size, interpolation=cv2.INTER_CUBIC)
    base = environment.radiance.float().numpy()
    fine = cv2.resize(base, size, interpolation=cv2.INTER_LINEAR)
    return EnvironmentMap(radiance=torch.from_numpy(fine * np.exp(logs)[..., None]))


def _turned_head(who: Person, share: float) -> Person:
    """The person with the head turned, ``share`` of the film in, in the camera's frame."""
    yaw = _HEAD_YAW * math.sin(2 * math.pi * share)
    pitch = _HEAD_PITCH * math.sin(4 * math.pi * share + 1)
    turn = Rotation.from_euler("yx", [yaw, pitch], degrees=True).as_matrix()
    truth = who.truth

    def turned(points: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        return (points - truth.translation) @ turn.T + truth.translation

    return replace(
        who,
        points=turned(who.points),
        cap=None if who.cap is None else Cap(points=turned(who.cap.points), faces=who.cap.faces),
        truth=replace(truth, rotation=turn @ truth.rotation, vertices=turned(truth.vertices)),
    )
