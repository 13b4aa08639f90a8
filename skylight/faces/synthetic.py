"""Random people under known illumination, for demonstrations and evaluations."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray
from scipy.spatial.transform import Rotation
from torch import Tensor

from skylight.faces.fit import FaceFit
from skylight.faces.model import HeadModel, Region
from skylight.faces.paint import paint
from skylight.faces.skin import SkinPrior
from skylight.imaging.colour import linear_to_srgb, srgb_to_linear
from skylight.models.ground import LambertianGround
from skylight.sphere.envmap import EnvironmentMap
from skylight.transport.camera import Camera
from skylight.transport.gbuffer import rasterize
from skylight.transport.raycast import Raycaster
from skylight.transport.render import FINE_HEIGHT, Specular, render_diffuse

BACKGROUND = 0.18  # mid-grey wall behind the head, in units of the exposed picture


@dataclass(frozen=True, kw_only=True)
class SyntheticFace:
    """A rendered picture and everything that made it.

    ``encoded`` is the 8-bit sRGB picture a camera would deliver; ``picture`` its values decoded
    again (so quantised and clipped), ``clipped`` where a channel is at 255. ``environment`` is
    the light in the units of ``picture``; ``truth`` is the true geometry as a fit.
    ``ground_albedo`` is that below a sky, None where the light is no sky over a ground.
    """

    encoded: UInt8[ndarray, "h w 3"]
    picture: Float[Tensor, "h w 3"]
    clipped: Bool[Tensor, "h w"]
    environment: EnvironmentMap
    albedo: Float[Tensor, "3"]
    ground_albedo: Float[Tensor, "3"] | None
    truth: FaceFit


def render_face(
    sky: EnvironmentMap,
    ground_albedo: Float[Tensor, "3"],
    *,
    seed: int,
    size: int = 256,
    azimuth_rad: float | None = None,
    light_rows: int = FINE_HEIGHT,
) -> SyntheticFace:
    """A random person under a sky turned by a random azimuth (or the given one).

    Geometry, expression, pose (yaw 15, pitch 8, roll 5 degrees, standard deviations), focal
    length, skin albedo and how it varies with melanin and blood (:func:`paint`), a glossy lobe,
    sensor noise of 0.5 % and 8-bit sRGB all follow from ``seed``. The light has 64 x 128 pixels,
    sampled far finer than the transport of an estimate where it is bright (``light_rows``).
    """
    rng = np.random.default_rng(seed)
    model = HeadModel.load()
    identity, expression = model.sample(rng)
    yaw, pitch, roll = np.radians(rng.normal(size=3) * [15, 8, 5])
    rotation = Rotation.from_euler("yxz", [yaw, pitch, roll]).as_matrix()
    focal = size * rng.uniform(1.4, 2.8)
    distance = focal * 0.21 / (size * rng.uniform(0.55, 0.7))
    translation = np.array([rng.normal(0, 0.006), rng.normal(-0.015, 0.006), -distance])
    turn = rng.uniform(-math.pi, math.pi)
    turned = sky.rotate_azimuth(turn if azimuth_rad is None else azimuth_rad).upper()
    ground = LambertianGround(turned.layout[0])
    bounce = ground(turned.flat[None], ground_albedo[None].to(turned.flat))[0]
    environment = turned.with_ground(bounce)

    vertices = model.vertices(identity, expression) @ rotation.T + translation
    mesh, faces = torch.from_numpy(vertices), torch.from_numpy(model.faces.copy())
    camera = Camera(focal_px=focal, width=size, height=size, center_px=(size / 2, size / 2))
    raycaster = Raycaster(mesh, faces)
    surface = rasterize(camera, mesh, faces, raycaster)
    skin = SkinPrior.load().sample(1, torch.Generator().manual_seed(seed))[0].clamp(0.001, 0.9)
    painted = torch.from_numpy(paint(skin.numpy(), rng))
    albedo = (painted[faces[surface.faces]] * surface.barycentric[..., None]).sum(1)
    radiance = render_diffuse(
        surface,
        environment,
        albedo.float(),
        raycaster,
        specular=Specular(),
        fine_height=light_rows,
    )
    on_face = torch.from_numpy((model.regions == Region.FACE)[model.faces].all(1))[surface.faces]
    # exposed for the face: at most a few per cent of its skin end up clipped
    white = torch.quantile(radiance[on_face].amax(1), float(rng.uniform(0.96, 1.0)))
    exposure = float(0.9 / white)
    backdrop = torch.full((size, size, 3), BACKGROUND)
    image = surface.image(radiance * exposure, backdrop)
    noise = torch.from_numpy(rng.normal(0, 0.005, image.shape)).float()
    encoded = (linear_to_srgb((image * (1 + noise)).clamp(0, 1)) * 255).round().to(torch.uint8)
    return SyntheticFace(
        encoded=encoded.numpy(),
        picture=srgb_to_linear(encoded.float() / 255),
        clipped=(encoded == 255).any(2),
        environment=EnvironmentMap(radiance=environment.radiance * exposure),
        albedo=skin.float(),
        ground_albedo=ground_albedo,
        truth=FaceFit(
            camera=camera,
            rotation=rotation,
            translation=translation,
            identity=identity,
            expression=expression,
            vertices=vertices,
            landmark_error=0.0,
            converged=True,
        ),
    )
