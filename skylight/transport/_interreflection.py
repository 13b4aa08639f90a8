"""Transport of light that bounces between the parts of an object, as a matrix.

A Lambertian point p of a scene of reflectance rho shows, for an albedo of 1, ::

    s_p = int (V(p,w) L(w) + (1 - V(p,w)) rho s(y(p,w))) <n_p, w>+ / pi dw,

y being what the ray from p along w meets. With F[p,j] = int (1 - V(p,w)) b_j(y) <n_p, w>+ / pi dw,
b_j the barycentric weight of vertex j, light bounces between vertices by sparse products ::

    T_0 = T,    T_k = T + rho F T_(k-1)(vertices)

(radiosity with a linear basis, collocated at vertices; Cohen & Wallace 1993, "Radiosity and
Realistic Image Synthesis", chapter 3). What is linear between vertices is a shading that is not,
and the normals are smooth: of a head's bounced light 3 % in the mean and 15 % (root mean square
over points) are off against paths on its flat triangles.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import csr_array
from torch import Tensor
from torch.quasirandom import SobolEngine

from skylight.errors import InputError
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix
from skylight.transport._path_tracer import cosine_directions
from skylight.transport._rays import Raycaster
from skylight.transport._render import vertex_normals
from skylight.transport._visibility import adaptive_visibility

ROWS = 32  # of the light that vertices send on


@dataclass(frozen=True, kw_only=True)
class BouncingMesh:
    """A mesh of Lambertian reflectance ``albedo``, both sides alike, that light bounces on.

    ``rays`` leave each point, in proportion to the cosine, to find what it faces; ``seed`` is that
    of their random shifts. The sampling error of a bounce is 1 / sqrt(``rays``) of what a point
    gets by it at the most, and less where much of what it faces is alike.
    """

    vertices: Float[Tensor, "v 3"]
    faces: Int[Tensor, "f 3"]
    raycaster: Raycaster
    albedo: float
    rays: int = 128
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.albedo <= 1:
            raise InputError(f"an albedo is between 0 and 1, got {self.albedo}")
        if self.rays < 1:
            raise InputError(f"one ray a point or more, got {self.rays}")

    def transport(
        self,
        direct: TransportMatrix,
        positions: Float[Tensor, "m 3"],
        normals: Float[Tensor, "m 3"],
        *,
        bounces: int,
        workers: int = 1,
    ) -> TransportMatrix:
        """``direct`` of points on the mesh, with so many bounces between its parts.

        ``positions`` are where rays start (``GBuffer.origins``); ``normals`` are unit. Bounced
        light is computed for :data:`ROWS` rows and spread evenly over the finer directions of
        ``direct``. Memory: 8 bytes for each vertex that is met and each of 2,048 directions.

        Raises
        ------
        InputError
            Less than no bounce.
        """
        if bounces < 0:
            raise InputError(f"bounces must be 0 or more, got {bounces}")
        stages, links = [_Points(positions, normals)], []
        sides = vertex_normals(self.vertices, self.faces)
        sides = torch.cat([sides, -sides])
        for _ in range(bounces):
            link, met = self._link(stages[-1])
            if len(met) == 0:  # all of the light that it sends on goes into the open
                break
            links.append(link)
            stages.append(_Points(self.vertices[met % len(self.vertices)], sides[met]))
        if not links:
            return direct
        sent = self._direct(stages[-1], workers)
        for number in reversed(range(1, len(links))):
            sent = self._direct(stages[number], workers) + (self.albedo * links[number]) @ sent
        bounced = torch.from_numpy((self.albedo * links[0]) @ sent)
        return TransportMatrix(
            matrix=direct.matrix + _on_rows(bounced, direct.grid), grid=direct.grid
        )

    def _direct(self, points: "_Points", workers: int) -> Float[np.ndarray, "m n"]:
        """T of vertices on :data:`ROWS` rows."""
        sight = adaptive_visibility(
            points.positions,
            points.normals,
            points.normals,
            self.raycaster,
            ROWS,
            workers=workers,
        )
        return sight.transport().matrix.numpy()

    def _link(self, points: "_Points") -> tuple[csr_array, Int[Tensor, " k"]]:
        """(F from the sides of vertices that rays from the points meet, numbered: fronts first)."""
        count = len(points.positions)
        generator = torch.Generator().manual_seed(self.seed)
        pattern = SobolEngine(2, scramble=True, seed=self.seed).draw(self.rays)
        shift = torch.rand(count, 1, 2, generator=generator)
        uniform = ((pattern + shift) % 1).reshape(-1, 2)
        normals = points.normals.float().repeat_interleave(self.rays, 0)
        starts = points.positions + self.raycaster.epsilon * points.normals
        directions, _ = cosine_directions(normals, uniform)
        hits = self.raycaster.intersect(starts.float().repeat_interleave(self.rays, 0), directions)
        hit = (hits.face >= 0).nonzero()[:, 0]
        corners, weights = self.faces[hits.face[hit]], hits.barycentric[hit] / self.rays
        a, b, c = self.vertices[corners].unbind(1)
        behind = (torch.linalg.cross(b - a, c - a) * directions[hit]).sum(1) > 0
        corners = corners + len(self.vertices) * behind[:, None]
        met, column = torch.unique(corners, return_inverse=True)
        row = (hit // self.rays)[:, None].expand(-1, 3)
        places = row.flatten().numpy(), column.flatten().numpy()
        link = csr_array((weights.flatten().float().numpy(), places), shape=(count, len(met)))
        return link, met


@dataclass(frozen=True)
class _Points:
    positions: Float[Tensor, "m 3"]
    normals: Float[Tensor, "m 3"]


def _on_rows(matrix: Float[Tensor, "m n"], grid: DirectionGrid) -> Float[Tensor, "m n2"]:
    """Columns of light on :data:`ROWS` rows, parted among a finer grid's by solid angle."""
    assert grid.layout is not None
    times = grid.layout[0] // ROWS
    cells = matrix.unflatten(1, (ROWS, 2 * ROWS))
    cells = cells.repeat_interleave(times, 1).repeat_interleave(times, 2).flatten(1)
    coarse = DirectionGrid.latlong(ROWS).solid_angles.reshape(ROWS, -1)
    coarse = coarse.repeat_interleave(times, 0).repeat_interleave(times, 1).flatten()
    return cells * (grid.solid_angles / coarse).float()
