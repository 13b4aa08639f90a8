"""One rendered face: person, pose, illumination, path tracing, photograph.

The photograph is made of radiance: scattering, background, exposure, noise, 8-bit sRGB.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray
from torch import Tensor

from skylight.faces._fit import landmarks_of
from skylight.faces._model import HeadModel
from skylight.faces._synthetic import SyntheticFace
from skylight.imaging._colour import linear_to_srgb, srgb_to_linear
from skylight.people._background import (
    Background,
    BackgroundFacts,
    Edit,
    background,
    draw_background,
)
from skylight.people._light import DistantLight, RenderOptions, SceneLight, scene_light
from skylight.people._maps import TurnedMap
from skylight.people._people import Person, Seen, bare_skin, person, seen_parts
from skylight.people._skin import SmoothHead, normals_of
from skylight.people._subsurface import REACH_MM, SkinPatches, patches_in_reach, scattered
from skylight.people._trace import Layers, trace
from skylight.sphere._envmap import EnvironmentMap
from skylight.transport._cameras import Camera

# A sensor whose white is 8,000 electrons, read with an error of 4.
_FULL_WELL, _READ = 8000.0, 4.0
_FACING = 0.2  # cosine to the camera above which skin counts for the exposure


def compose(
    layers: Layers,
    seen: Seen,
    patches: SkinPatches,
    camera: Camera,
    backdrop: Float[ndarray, "h w 3"],
) -> Float[ndarray, "h w 3"]:
    """albedo * scattered(diffuse / albedo) + specular, before a backdrop."""
    shown = layers.albedo > 1e-6
    entered = np.where(shown, layers.diffuse / np.where(shown, layers.albedo, 1), 0)
    left = entered.astype(np.float64)
    where, pixel_mm = seen.positions[seen.skin], 1000 * seen.pixel_m(camera)
    left[seen.skin] = scattered(left[seen.skin], where, pixel_mm, patches, layers.entering)
    behind = backdrop * (1 - layers.cover[..., None])
    return (layers.albedo * left + layers.specular + behind).astype(np.float32)


def brightest_skin(person: Person, environment: EnvironmentMap) -> float:
    """The 97th percentile of skin's diffuse light, were nothing in shadow.

    Of the largest channel, over the bare skin that faces the camera.
    """
    normals = normals_of(person.points, SmoothHead.load().faces)
    to_camera = -person.points / np.linalg.norm(person.points, axis=1, keepdims=True)
    chosen = np.flatnonzero(bare_skin() & ((normals * to_camera).sum(1) > _FACING))[::7]
    grid = environment.grid
    flux = (environment.flat.double() * grid.solid_angles[:, None]).numpy()
    cosine = (normals[chosen] @ grid.directions.numpy().T).clip(0)
    light = cosine @ flux / np.pi * person.paint.albedo[chosen]
    return float(np.quantile(light.max(1), 0.97))


def exposure_for(
    people: Sequence[Person], environment: EnvironmentMap, rng: np.random.Generator
) -> float:
    """The factor by which the brightest person's skin comes to 70 to 95 % of white."""
    return float(rng.uniform(0.7, 0.95) / max(brightest_skin(p, environment) for p in people))


def photograph(
    linear: Float[ndarray, "h w 3"], rng: np.random.Generator
) -> UInt8[ndarray, "h w 3"]:
    """8-bit sRGB codes; a value x has the variance x / 8000 + (4 / 8000)^2 of noise."""
    deviation = np.sqrt(linear / _FULL_WELL + (_READ / _FULL_WELL) ** 2)
    noisy = (linear + deviation * rng.standard_normal(linear.shape)).clip(0, 1)
    codes = linear_to_srgb(torch.from_numpy(noisy)) * 255
    return codes.round().to(torch.uint8).numpy()


@dataclass(frozen=True, kw_only=True)
class RenderedFace(SyntheticFace):
    """A path-traced face and everything that made it.

    ``albedo`` is the mean diffuse albedo of the bare skin in the picture and ``linear`` the picture
    before noise and quantisation. ``landmarks`` are the true 68 points (x, y; the jaw's on the
    silhouette), ``cluster`` the tone from 0, light, to 5, dark, ``sun_direction`` a unit vector in
    the camera's frame, ``hair`` the pixels that the cap covers. ``exposure`` turned the light's
    units into the picture's. A simulated sky has a ``sky_seed``, one of Hosek & Wilkie a
    ``turbidity``; under a given map, which ``turned_map`` names, what tells of sky, sun and ground
    is None. ``background`` is None where the light itself is behind the head, infinitely far away.
    """

    linear: Float[Tensor, "h w 3"]
    landmarks: Float[ndarray, "68 2"]
    hair: Bool[ndarray, "h w"]
    cluster: int
    number: int
    scene: int
    sky_seed: int | None
    sun_direction: Float[Tensor, "3"] | None
    sun_transmittance: float | None
    exposure: float
    turbidity: float | None = None
    turned_map: TurnedMap | None = None
    background: BackgroundFacts | None = None


def render(number: int, options: RenderOptions) -> RenderedFace:
    """Face ``number``, from its number and the options alone."""
    scene = number // options.per_scene
    lit = scene_light(scene, options)
    behind, light = scene_background(scene, lit, options)
    environment = light.environment
    first = scene * options.per_scene
    people = [person(first + i, lit.focal, options) for i in range(options.per_scene)]
    exposure = exposure_for(people, environment, np.random.default_rng((options.seed, scene, 3)))
    who = people[number - first]
    rng = np.random.default_rng((options.seed, number, 2))
    paths = int(rng.integers(2**30))
    seen = seen_parts(who)
    camera = who.truth.camera
    patches = patches_in_reach(who, seen, REACH_MM / 1000)
    layers = trace(who, light, patches, samples=options.samples, seed=paths)
    head = who.points.mean(0)
    if behind is None:
        backdrop = background(light, camera)
    elif behind.edit is not None and behind.edit.cut_out:
        backdrop = np.full((*layers.cover.shape, 3), _white(behind.edit) / exposure)
    else:
        backdrop = behind.seen(light, camera, head)
    linear = exposure * compose(layers, seen, patches, camera, backdrop)
    encoded = photograph(linear, rng)
    if behind is not None and behind.edit is not None:
        gone = behind.edit.where(layers.cover)
        linear[gone], encoded[gone] = _white(behind.edit), round(255 * behind.edit.value)
    codes = torch.from_numpy(encoded)
    return RenderedFace(
        encoded=encoded,
        picture=srgb_to_linear(codes.float() / 255),
        clipped=(codes == 255).any(2),
        environment=EnvironmentMap(radiance=environment.radiance * exposure),
        albedo=torch.from_numpy(layers.albedo[seen.bare & (layers.cover > 0.999)].mean(0)),
        ground_albedo=lit.ground_albedo,
        truth=who.truth,
        linear=torch.from_numpy(linear),
        landmarks=landmarks_of(HeadModel.load(), who.truth),
        hair=seen.hair,
        cluster=who.cluster,
        number=number,
        scene=scene,
        sky_seed=lit.sky_seed,
        sun_direction=lit.sun,
        sun_transmittance=lit.transmittance,
        turbidity=lit.turbidity,
        exposure=exposure,
        turned_map=lit.turned_map,
        background=None if behind is None else BackgroundFacts.of(behind, camera, head),
    )


def scene_background(
    scene: int, lit: SceneLight, options: RenderOptions
) -> tuple[Background | None, DistantLight]:
    """What is behind the people of a scene, and its light with that in it."""
    if options.backgrounds == "infinite":
        return None, lit.light
    seed = options.seed if options.light_seed is None else options.light_seed
    category = None if lit.turned_map is None else lit.turned_map.category
    return draw_background(np.random.default_rng((seed, scene, 8)), lit.light, category)


def _white(edit: Edit) -> float:
    """What an edit puts in place of the picture, in linear light."""
    return float(srgb_to_linear(torch.tensor(edit.value)))
