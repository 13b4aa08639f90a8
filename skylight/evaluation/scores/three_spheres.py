"""Three spheres under the predicted and the true light: mirror, matte silver, matte diffuse.

The protocol by which papers on lighting estimation compare (LeGendre et al. 2019, "DeepLight";
Wang et al. 2022, "StyleLight"; Phongthawee et al. 2024, "DiffusionLight"). They differ in renderer,
sizes and materials and do not state all of them, so that figures compare only within one set of
constants. Ours, in this place only:

* camera: orthographic, looks along -Z; each sphere fills a square of 64 x 64 pixels; the picture is
  the pixels whose centres lie inside (3,228 of them); nothing else is in the scene;
* light: the map resized to 64 rows, energy kept; no shadows, no light between spheres;
* mirror: reflectance 1 at every angle;
* silver: a GGX metal of alpha 0.25 (roughness 0.5), reflectance 1 at every angle, single
  scattering with height-correlated Smith masking;
* diffuse: Lambertian, albedo 0.5.

Reflectances scale a picture and its truth alike: no metric here depends on them.
"""

import math
from dataclasses import dataclass
from functools import cache
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.errors import InputError
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.grid import DirectionGrid
from skylight.sphere.projections import from_latlong
from skylight.transport.gloss import glossy_transport
from skylight.transport.matrix import TransportMatrix
from skylight.transport.render import Specular

SphereMaterial = Literal["mirror", "silver", "diffuse"]
PIXELS = 64
LIGHT_ROWS = 64
SILVER = Specular(f0=1.0, roughness=0.5)
DIFFUSE_ALBEDO = 0.5


@dataclass(frozen=True, kw_only=True)
class SphereTransport:
    """``inside`` (64,64) is the picture; ``diffuse`` and ``silver`` (m,n) are its transport."""

    inside: Bool[Tensor, "h w"]
    diffuse: TransportMatrix
    silver: TransportMatrix


def render_spheres(environment: EnvironmentMap) -> dict[SphereMaterial, Float[Tensor, "m 3"]]:
    """Radiance at the m pixels of each sphere, in rows from the top.

    diffuse: albedo / pi sum_w L(w) <n,w>+ dw; silver: sum_w f_s(n,w,v) L(w) <n,w>+ dw with v = +Z;
    mirror: the mean of L over the directions that the pixel reflects.

    Raises
    ------
    InputError
        A sky alone, which has no lower half.
    """
    if environment.is_sky:
        raise InputError("spheres need light from all round: give a full lat-long map")
    if environment.layout[0] != LIGHT_ROWS:
        environment = environment.resize(LIGHT_ROWS)
    spheres = sphere_transport()
    light = environment.flat.float()
    mirror = from_latlong(environment, "mirrorball", PIXELS)
    return {
        "mirror": mirror[spheres.inside],
        "silver": spheres.silver.matrix @ light,
        "diffuse": DIFFUSE_ALBEDO * (spheres.diffuse.matrix @ light),
    }


@cache
def sphere_transport() -> SphereTransport:
    """Built once: 2 matrices of 3,228 x 8,192 float32, 210 MB."""
    edge = (torch.arange(PIXELS, dtype=torch.float64) + 0.5) / PIXELS * 2 - 1
    y, x = torch.meshgrid(-edge, edge, indexing="ij")
    height = (1 - x**2 - y**2).clamp(min=0).sqrt()
    inside = x**2 + y**2 < 1
    normals = torch.stack([x, y, height], -1)[inside]
    grid = DirectionGrid.latlong(LIGHT_ROWS)
    cosine = (normals.float() @ grid.directions.T.float()).clamp(min=0)
    diffuse = TransportMatrix(matrix=cosine * (grid.solid_angles / math.pi).float(), grid=grid)
    towards_camera = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand_as(normals)
    silver = glossy_transport(diffuse, normals, towards_camera, SILVER)
    return SphereTransport(inside=inside, diffuse=diffuse, silver=silver)


def angular_error_deg(pred: Float[Tensor, "m 3"], true: Float[Tensor, "m 3"]) -> float:
    """Mean over pixels of the angle between predicted and true RGB as vectors, in degrees.

    Pixels whose truth is black have no colour and are left out; a prediction that is black where
    the truth is not counts 90 degrees.

    Raises
    ------
    InputError
        The truth is black everywhere.
    """
    p, t = pred.double(), true.double()
    lit = t.norm(dim=1) > 0
    if not lit.any():
        raise InputError("the true render is black: its colours mean nothing")
    p, t = p[lit], t[lit]
    # atan2: acos of a cosine near 1 would lose half the digits
    cross = torch.linalg.cross(p, t).norm(dim=1)
    angle = torch.atan2(cross, (p * t).sum(1))
    angle = torch.where(p.norm(dim=1) > 0, angle, math.pi / 2)
    return math.degrees(float(angle.mean()))
