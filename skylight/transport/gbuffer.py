"""The G-buffer of a mesh: one surface point with normals per covered pixel."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from skylight.transport.camera import Camera
from skylight.transport.raycast import Raycaster


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
