"""Reference rendering of a mesh under an environment map by direct light.

The G-buffer of a mesh has one surface point with normals per covered pixel. The renderer is the
reference against which transport matrices (and what is estimated with them) are judged, so it
chooses its own light directions: a coarse grid for the smooth part of the map, and many directions
for every bright pixel, such as the sun's.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid, cosines
from skylight.transport._cameras import Camera
from skylight.transport._matrix import BLOCK_DIRECTIONS, SurfaceRays
from skylight.transport._rays import Raycaster


@dataclass(frozen=True, kw_only=True)
class CoveredPixels:
    """The m covered pixels, (row, column), of an image of ``layout`` (height, width)."""

    layout: tuple[int, int]
    pixels: Int[Tensor, "m 2"]

    def __len__(self) -> int:
        return len(self.pixels)

    def image(
        self, values: Float[Tensor, "m c"], background: Float[Tensor, "h w c"] | None = None
    ) -> Float[Tensor, "h w c"]:
        """Values put back in their pixels, over a background (default 0)."""
        if background is None:
            background = values.new_zeros(*self.layout, values.shape[1])
        out = background.to(values.dtype).clone()
        out[self.pixels[:, 0], self.pixels[:, 1]] = values
        return out


@dataclass(frozen=True, kw_only=True)
class GBuffer(CoveredPixels):
    """Surface points of the covered pixels.

    ``positions`` lie on the mesh, in its units. ``normals`` are the
    interpolated vertex normals, ``geometric_normals`` those of the flat faces; both are unit
    vectors, on the side of the surface that the camera sees. ``origins`` are where light rays
    should start (see :func:`lift`). ``faces`` and ``barycentric`` interpolate anything else.
    """

    positions: Float[Tensor, "m 3"]
    origins: Float[Tensor, "m 3"]
    normals: Float[Tensor, "m 3"]
    geometric_normals: Float[Tensor, "m 3"]
    faces: Int[Tensor, " m"]
    barycentric: Float[Tensor, "m 3"]


def rasterize(
    camera: Camera,
    vertices: Float[Tensor, "n 3"],
    faces: Int[Tensor, "f 3"],
    raycaster: Raycaster,
) -> GBuffer:
    """The mesh as seen through each pixel's centre; ``raycaster`` holds the same mesh."""
    rays = camera.rays()
    hits = raycaster.intersect(torch.zeros_like(rays), rays)
    covered = torch.nonzero(hits.face >= 0)[:, 0]
    face, barycentric = hits.face[covered], hits.barycentric[covered]
    vertices = vertices.detach().double()
    corners = vertices[faces[face]]
    corner_normals = vertex_normals(vertices, faces)[faces[face]]
    flat = normalize(
        torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), dim=1
    )
    # An open mesh (a face without the back of the head) may show its inner side.
    side = torch.where((flat * rays[covered]).sum(1) > 0, -1.0, 1.0).double()[:, None]
    corner_normals = corner_normals * side[:, None]
    position = (barycentric[:, :, None] * corners).sum(1)
    return GBuffer(
        layout=(camera.height, camera.width),
        pixels=torch.stack([covered // camera.width, covered % camera.width], dim=1),
        positions=position,
        origins=lift(position, barycentric, corners, corner_normals),
        normals=normalize((barycentric[:, :, None] * corner_normals).sum(1), dim=1),
        geometric_normals=flat * side,
        faces=face,
        barycentric=barycentric,
    )


def vertex_normals(
    vertices: Float[Tensor, "n 3"], faces: Int[Tensor, "f 3"]
) -> Float[Tensor, "n 3"]:
    """Unit vertex normals: face normals weighted by the angle the face has at the vertex.

    Unlike weights by area these do not depend on how the surface is cut into triangles
    (Thuermer and Wuethrich 1998). A vertex without faces gets 0.
    """
    corners = vertices[faces]
    flat = normalize(
        torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), dim=1
    )
    total = torch.zeros_like(vertices)
    for i in range(3):
        a = normalize(corners[:, (i + 1) % 3] - corners[:, i], dim=1)
        b = normalize(corners[:, (i + 2) % 3] - corners[:, i], dim=1)
        angle = torch.atan2(torch.linalg.cross(a, b).norm(dim=1), (a * b).sum(1))
        total = total.index_add(0, faces[:, i], flat * angle[:, None])
    return normalize(total, dim=1)


def lift(
    positions: Float[Tensor, "m 3"],
    barycentric: Float[Tensor, "m 3"],
    corners: Float[Tensor, "m 3 3"],
    corner_normals: Float[Tensor, "m 3 3"],
) -> Float[Tensor, "m 3"]:
    """Points moved from the flat triangles up to the smooth surface that the normals suggest.

    p + sum_i b_i max(0, -<p - v_i, n_i>) n_i: the mean of p's projections onto the tangent
    planes of the corners that lie above p (Hanika 2021, "Hacking the shadow terminator", Ray
    Tracing Gems II, chapter 4). Rays that start there clear the neighbouring facets of a convex
    surface, so light that grazes the interpolated normal does not paint the facets' edges; in
    flat and hollow places nothing moves.
    """
    below = -((positions[:, None] - corners) * corner_normals).sum(2).clamp(max=0)  # (m, 3)
    return positions + ((barycentric * below)[:, :, None] * corner_normals).sum(1)


SMOOTH_HEIGHT = 32  # rows of the grid for the smooth part: cells of 5.6 degrees
FINE_HEIGHT = 256  # rows of the grid for bright pixels: cells of 0.7 degrees
BRIGHT = 20.0  # times the mean luminance


@dataclass(frozen=True, kw_only=True)
class Specular:
    """A GGX lobe. ``f0`` is the reflectance at normal incidence, ``roughness`` is sqrt(alpha).

    The default ``f0`` is that of skin's index of refraction, ((1.4 - 1) / (1.4 + 1))^2.
    """

    f0: float = 0.028
    roughness: float = 0.4

    @property
    def alpha(self) -> float:
        return self.roughness**2


def render_diffuse(
    gbuffer: GBuffer,
    environment: EnvironmentMap,
    albedo: Float[Tensor, "m 3"],
    raycaster: Raycaster,
    *,
    specular: Specular | None = None,
    fine_height: int = FINE_HEIGHT,
) -> Float[Tensor, "m 3"]:
    """Radiance towards the camera at the origin from direct light, shadows included.

    sum_w (albedo / pi + f_s(w, v)) V(p, w) <n_p, w>+ L(w) dw, where f_s is 0 without
    ``specular``. Memory: about 4 m * 64 bytes times 2, with a specular lobe times 8.
    """
    directions, flux = light_samples(environment, fine_height)
    rays = SurfaceRays.leaving(
        gbuffer.origins, gbuffer.normals, gbuffer.geometric_normals, raycaster
    )
    view = torch.nn.functional.normalize(-gbuffer.positions, dim=1).float()
    normals = gbuffer.normals.float()
    diffuse = torch.zeros(len(gbuffer), 3)
    reflected = torch.zeros(len(gbuffer), 3)
    for light, power in zip(
        directions.float().split(BLOCK_DIRECTIONS),
        flux.float().split(BLOCK_DIRECTIONS),
        strict=True,
    ):
        cosine = torch.from_numpy(rays.visible_cosines(light.numpy()))  # (b, m)
        diffuse += cosine.T @ power / math.pi
        if specular is not None:
            n_v = (normals * view).sum(1).clamp(min=1e-3)
            reflected += (cosine * ggx(cosine, n_v, cosines(light, view), specular)).T @ power
    return albedo * diffuse + reflected


def light_samples(
    environment: EnvironmentMap, fine_height: int = FINE_HEIGHT
) -> tuple[Float[Tensor, "k 3"], Float[Tensor, "k 3"]]:
    """Directions and their L(w) dw, float64, that stand for a full environment map.

    Pixels above 20 times the mean luminance become the sub-directions (4 x 4 of them for a map
    of 64 rows) of a grid of ``fine_height`` rows, each with its exact solid angle; what is left
    is averaged onto 32 rows. Both keep the energy. Black directions are left out.
    """
    smooth, fine, power = split_bright(environment, fine_height)
    directions = torch.cat([smooth.grid.directions, fine])
    flux = torch.cat([smooth.flat * smooth.grid.solid_angles[:, None], power])
    lit = flux.sum(1) > 0
    return directions[lit], flux[lit]


def split_bright(
    environment: EnvironmentMap, fine_height: int = FINE_HEIGHT
) -> tuple[EnvironmentMap, Float[Tensor, "k 3"], Float[Tensor, "k 3"]]:
    """(a map of the rest on 32 rows or fewer, directions and L(w) dw of the bright pixels).

    :func:`light_samples` says which pixels are bright, and how they are divided.
    """
    if environment.is_sky:
        raise ValueError("a sky alone leaves the ground unknown: add one with .with_ground()")
    if environment.layout[0] > fine_height:
        environment = environment.resize(fine_height)
    height, width = environment.layout
    radiance = environment.flat.double()
    value, weight = luminance(radiance), environment.grid.solid_angles
    bright = value > BRIGHT * (value @ weight) / (4 * math.pi)

    rest = torch.where(bright[:, None], 0.0, radiance).reshape(height, width, 3)
    smooth = EnvironmentMap(radiance=rest).resize(min(height, SMOOTH_HEIGHT))
    split = math.ceil(fine_height / height)
    fine = DirectionGrid.latlong(height * split)
    inside = bright.reshape(height, width)
    inside = inside.repeat_interleave(split, 0).repeat_interleave(split, 1).reshape(-1)
    owner = torch.arange(height * width).reshape(height, width)
    owner = owner.repeat_interleave(split, 0).repeat_interleave(split, 1).reshape(-1)[inside]
    return smooth, fine.directions[inside], radiance[owner] * fine.solid_angles[inside, None]


def ggx(
    n_l: Float[Tensor, "b m"], n_v: Float[Tensor, " m"], l_v: Float[Tensor, "b m"], lobe: Specular
) -> Float[Tensor, "b m"]:
    """The microfacet BRDF D G F / (4 <n,l> <n,v>) in 1/sr from the three cosines.

    D: GGX (Walter et al. 2007, eq. 33); G: height-correlated Smith (Heitz 2014, eq. 99);
    F: Schlick (1994).
    """
    a2 = lobe.alpha**2
    square = (2 + 2 * l_v).clamp(min=1e-6)  # of |l + v|: h = (l + v) / |l + v|
    n_h_squared = ((n_l + n_v).square() / square).clamp(max=1)
    masking = 0.5 / (n_l * (n_v**2 * (1 - a2) + a2).sqrt() + n_v * (n_l**2 * (1 - a2) + a2).sqrt())
    off = (1 - square.sqrt() / 2).clamp(min=0)  # 1 - <v,h>
    fresnel = lobe.f0 + (1 - lobe.f0) * off.square().square() * off  # a power of 5 is slow
    return ggx_density(n_h_squared, lobe.alpha) * masking * fresnel


def ggx_density(n_h_squared: Float[Tensor, "*s"], alpha: float) -> Float[Tensor, "*s"]:
    """D(h) = alpha^2 / (pi (<n,h>^2 (alpha^2 - 1) + 1)^2), in 1/sr."""
    return alpha**2 / (math.pi * (n_h_squared * (alpha**2 - 1) + 1) ** 2)


def reflection_weights(
    reflected: Float[Tensor, "k 3"], grid: DirectionGrid, alpha: float
) -> Float[Tensor, "k n"]:
    """Weights D(h) <r,w>+ dw, each row's sum 1: a map blurred about the mirror direction r.

    The usual prefilter, which takes normal and view along r (Karis 2013, "Real shading in
    Unreal Engine 4"), so <n,h>^2 = (1 + <r,w>) / 2.
    """
    cosine = cosines(reflected, grid.directions.to(reflected)).float()
    weight = ggx_density((1 + cosine) / 2, alpha) * cosine.clamp(min=0)
    weight = weight * grid.solid_angles.float()
    return weight / weight.sum(1, keepdim=True)
