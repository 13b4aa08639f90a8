"""From radiance to an 8-bit photograph: scattering, background, exposure, noise, sRGB."""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray

from skylight.evaluation.rendered_faces.light.distant_light import DistantLight
from skylight.evaluation.rendered_faces.people import Person, Seen, bare_skin
from skylight.evaluation.rendered_faces.skin_patches import SkinPatches
from skylight.evaluation.rendered_faces.smooth_head import SmoothHead, normals_of
from skylight.evaluation.rendered_faces.subsurface import scattered
from skylight.evaluation.rendered_faces.trace import Layers
from skylight.imaging.colour import linear_to_srgb
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.frame import pixel_from_direction
from skylight.transport.camera import Camera

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
    """albedo * scattered(diffuse / albedo) + gloss, before a backdrop."""
    shown = layers.albedo > 1e-6
    entered = np.where(shown, layers.diffuse / np.where(shown, layers.albedo, 1), 0)
    left = entered.astype(np.float64)
    where, pixel_mm = seen.positions[seen.skin], 1000 * seen.pixel_m(camera)
    left[seen.skin] = scattered(left[seen.skin], where, pixel_mm, patches, layers.entering)
    behind = backdrop * (1 - layers.cover[..., None])
    return (layers.albedo * left + layers.gloss + behind).astype(np.float32)


def background(
    light: DistantLight,
    camera: Camera,
    world_from_camera: Float[ndarray, "3 3"] | None = None,
) -> Float[ndarray, "h w 3"]:
    """What a camera sees of the light, a level one that looks ahead or a turned one.

    The map is interpolated, the sun is a disc.
    """
    rays = camera.rays()
    if world_from_camera is not None:
        rays = rays @ torch.from_numpy(world_from_camera.T.copy())
    row, column = pixel_from_direction(rays, *light.diffuse.layout)
    shape = camera.height, camera.width
    sky = cv2.remap(
        np.ascontiguousarray(light.diffuse.radiance.float().numpy()),
        column.reshape(shape).float().numpy(),
        row.reshape(shape).float().numpy(),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_WRAP,
    )
    if light.sun is None:
        return sky
    disc = light.sun.in_pixels(rays, 1 / camera.focal_px)
    return sky + disc.reshape(*shape, 3).float().numpy()


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
