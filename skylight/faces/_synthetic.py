"""Random people under known illumination, for demonstrations and evaluations.

:func:`render_face` takes a picture of one; :func:`paint` gives the colours per vertex of the head
model: skin of melanin and blood, lips, eyes.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray
from scipy.spatial.transform import Rotation
from torch import Tensor

from skylight.faces._fit import FaceFit
from skylight.faces._model import HeadModel, Region
from skylight.faces._skin import BLOOD_COLOUR, MELANIN_COLOUR, SkinPrior
from skylight.imaging._colour import linear_to_srgb, srgb_to_linear
from skylight.models._ground import LambertianGround
from skylight.sphere._envmap import EnvironmentMap
from skylight.transport._cameras import Camera
from skylight.transport._rays import Raycaster
from skylight.transport._render import FINE_HEIGHT, Specular, rasterize, render_diffuse

BACKGROUND = 0.18  # mid-grey wall behind the head, in units of the exposed picture
# Where skin is not skin: factors on its albedo, linear RGB (nominal).
_REGION_TINT: dict[Region, tuple[float, float, float]] = {
    Region.LIPS: (0.8, 0.55, 0.6),
    Region.BROW: (0.25, 0.22, 0.2),
    Region.MOUTH: (0.35, 0.2, 0.2),
}
_SCLERA, _IRIS = (0.62, 0.6, 0.57), (0.05, 0.035, 0.025)
# Size of patches in metres, and how much melanin and blood vary with them at most, in log green.
_PATCHES = ((0.05, 0.06, 0.05), (0.015, 0.04, 0.04), (0.004, 0.03, 0.02))


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
    length, skin albedo and how it varies with melanin and blood (:func:`paint`), a specular lobe,
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


def paint(skin: Float[ndarray, "3"], rng: np.random.Generator) -> Float[ndarray, "n 3"]:
    """Albedo at each vertex of a person whose face has the geometric mean albedo ``skin``."""
    model = HeadModel.load()
    painted = skin * np.exp(-_absorbed(model, rng))
    for region, tint in _REGION_TINT.items():
        painted[model.regions == region] *= np.array(tint)
    eyes = np.flatnonzero(model.regions == Region.EYEBALL)
    front = model.mean[eyes, 2] > np.quantile(model.mean[eyes, 2], 0.8)
    painted[eyes] = np.where(front[:, None], np.array(_IRIS), np.array(_SCLERA))
    return painted.clip(0.001, 0.95)


def _absorbed(model: HeadModel, rng: np.random.Generator) -> Float[ndarray, "n 3"]:
    """How much darker skin is than the mean of the face, in log albedo.

    People differ in how much their skin varies, and in what: patches of three sizes, redder cheeks,
    nose, chin and ears, a jaw with the shadow of a beard or paler than a tanned forehead, dark
    rings under the eyes. None of it is made of the modes that estimates solve for.
    """
    where, marks = model.mean, model.landmarks(model.mean)
    melanin, blood = np.zeros(len(where)), np.zeros(len(where))
    for patch_m, most_melanin, most_blood in _PATCHES:
        melanin += rng.uniform(0.2, 1) * most_melanin * field(where, patch_m, rng)
        blood += rng.uniform(0.2, 1) * most_blood * field(where, patch_m, rng)
    flushed = rng.uniform(0, 1) * np.array([0.25, 0.3, 0.15, 0.25])
    cheeks = spots(where, marks[[2, 31, 41]].mean(0), 0.018) + spots(
        where, marks[[14, 35, 46]].mean(0), 0.018
    )
    nose, chin = spots(where, marks[30], 0.012), spots(where, marks[8], 0.015)
    blood += flushed @ np.stack([cheeks, nose, chin, model.regions == Region.EAR])
    rings = sum(spots(where, marks[i] - [0, 0.008, 0], 0.008) for i in (40, 41, 46, 47))
    melanin += rng.uniform(0, 0.15) * np.minimum(rings, 1)
    # from -1 at the chin to 1 at the hairline
    height = ((where[:, 1] - marks[33, 1]) / 0.05).clip(-1, 1)
    melanin += rng.normal(0, 0.05) * height
    if rng.random() < 0.3:  # of a shaved beard
        melanin += rng.uniform(0.05, 0.2) * (-height).clip(0, 1)
    # pigment in dark skin is nearly grey, in light skin it takes mostly blue
    strength = rng.uniform(0.3, 1.4)
    colours = np.stack([np.array(MELANIN_COLOUR) ** strength, BLOOD_COLOUR])
    amounts = np.stack([melanin, blood], 1)
    amounts -= amounts[model.regions == Region.FACE].mean(0)
    return amounts @ colours


def field(
    points: Float[ndarray, "m 3"], patch_m: float, rng: np.random.Generator
) -> Float[ndarray, " m"]:
    """A smooth random field of variance 1: 32 waves whose lengths are about 2 ``patch_m``."""
    waves = rng.normal(0, math.pi / patch_m / math.sqrt(3), (32, 3))
    phase = rng.uniform(0, 2 * math.pi, 32)
    return np.cos(points @ waves.T + phase).sum(1) * math.sqrt(2 / 32)


def spots(
    points: Float[ndarray, "m 3"], centre: Float[ndarray, "3"], width_m: float
) -> Float[ndarray, " m"]:
    """A Gaussian of height 1 about ``centre``."""
    return np.exp(-((points - centre) ** 2).sum(1) / (2 * width_m**2))
