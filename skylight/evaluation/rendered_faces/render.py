"""One rendered face: person, pose, illumination, path tracing, photograph."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray
from torch import Tensor

from skylight.evaluation.rendered_faces.light.scene_light import scene_light
from skylight.evaluation.rendered_faces.map_folder import TurnedMap
from skylight.evaluation.rendered_faces.options import RenderOptions
from skylight.evaluation.rendered_faces.people import person, seen_parts
from skylight.evaluation.rendered_faces.photograph import (
    background,
    compose,
    exposure_for,
    photograph,
)
from skylight.evaluation.rendered_faces.skin_patches import patches_in_reach
from skylight.evaluation.rendered_faces.subsurface import REACH_MM
from skylight.evaluation.rendered_faces.trace import trace
from skylight.faces.fit import landmarks_of
from skylight.faces.model import HeadModel
from skylight.faces.synthetic import SyntheticFace
from skylight.imaging.colour import srgb_to_linear
from skylight.sphere.envmap import EnvironmentMap


@dataclass(frozen=True, kw_only=True)
class RenderedFace(SyntheticFace):
    """A path-traced face and everything that made it.

    ``albedo`` is the mean diffuse albedo of the bare skin in the picture and ``linear`` the picture
    before noise and quantisation. ``landmarks`` are the true 68 points (x, y; the jaw's on the
    silhouette), ``cluster`` the tone from 0, light, to 5, dark, ``sun_direction`` a unit vector in
    the camera's frame, ``hair`` the pixels that the cap covers. ``exposure`` turned the light's
    units into the picture's. A simulated sky has a ``sky_seed``, one of Hosek & Wilkie a
    ``turbidity``; under a given map, which ``turned_map`` names, what tells of sky, sun and ground
    is None.
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


def render(number: int, options: RenderOptions) -> RenderedFace:
    """Face ``number``, from its number and the options alone."""
    scene = number // options.per_scene
    lit = scene_light(scene, options)
    environment = lit.light.environment
    first = scene * options.per_scene
    people = [person(first + i, lit.focal, options) for i in range(options.per_scene)]
    exposure = exposure_for(people, environment, np.random.default_rng((options.seed, scene, 3)))
    who = people[number - first]
    rng = np.random.default_rng((options.seed, number, 2))
    paths = int(rng.integers(2**30))
    seen = seen_parts(who)
    camera = who.truth.camera
    patches = patches_in_reach(who, seen, REACH_MM / 1000)
    layers = trace(who, lit.light, patches, samples=options.samples, seed=paths)
    linear = exposure * compose(layers, seen, patches, camera, background(lit.light, camera))
    encoded = photograph(linear, rng)
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
    )
