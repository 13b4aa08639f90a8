"""Normals that may be wrong, and what that does to shading.

The normals of a fitted surface are known but for smooth errors, n_p + sum_k u_k M_pk with unknown
u. To first order in u, the shading of a Lambertian point is then ::

    s_p(u) = s_p(0) + <sum_k u_k M_pk, F_p>,    F_p = 1/pi int V(p, w) [<n_p, w> > 0] w L(w) dw,

with F the light vector (Arvo 1994, "The irradiance Jacobian for partially occluded polyhedral
sources") of what p sees of its upper hemisphere. Shadows stay where they are. Of a point in the
light of one lamp that is all there is to second order: turned by 10 degrees, normals of this
length make shading 1.5 % too bright, and the terminator stays where it was.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.sphere._frame import DirectionGrid, cosines
from skylight.transport._matrix import TransportMatrix
from skylight.transport._reflection import of_scene, shade_scenes

# T = V <n,w> dw / pi tells V where the cosine is more than this
_LEAST_COSINE = 0.01
_BLOCK_POINTS = 512  # at a time; bounds the scratch memory


@dataclass(frozen=True, kw_only=True)
class NormalModes:
    """``modes`` (m,3,k): M of the module's text, for u_k of standard deviation 1.

    ``visible`` (m,n): V(p, w) [<n_p, w> > 0] dw / pi over the directions of ``grid``. ``axes``
    (d,k): of a head, which of its errors the modes are
    (:class:`~skylight.faces._normal_errors.NormalErrorModes`); on the CPU.
    """

    modes: Float[Tensor, "m 3 k"]
    visible: Float[Tensor, "m n"]
    grid: DirectionGrid
    axes: Float[Tensor, "d k"] | None = None

    @staticmethod
    def of(
        transport: TransportMatrix,
        normals: Float[Tensor, "m 3"],
        modes: Float[Tensor, "m 3 k"],
        rows: int,
        axes: Float[Tensor, "d k"] | None = None,
    ) -> "NormalModes":
        """Of points with that transport, for light on a lat-long grid of ``rows``."""
        directions = transport.grid.directions.to(transport.matrix)
        blocks = []
        for begin in range(0, len(normals), _BLOCK_POINTS):
            points = slice(begin, begin + _BLOCK_POINTS)
            cosine = cosines(normals[points].to(directions), directions)
            inverse = torch.where(cosine > _LEAST_COSINE, 1 / cosine, 0.0)
            fine = TransportMatrix(matrix=transport.matrix[points] * inverse, grid=transport.grid)
            blocks.append(fine.on_rows(rows).matrix)
        return NormalModes(
            modes=modes.to(directions),
            visible=torch.cat(blocks),
            grid=DirectionGrid.latlong(rows),
            axes=axes,
        )

    def on_rows(self, rows: int) -> "NormalModes":
        """The same for light on a lat-long grid of no more than so many rows."""
        assert self.grid.layout is not None
        if self.grid.layout[0] <= rows:
            return self
        coarse = TransportMatrix(matrix=self.visible, grid=self.grid).on_rows(rows)
        return replace(self, visible=coarse.matrix, grid=coarse.grid)

    def __len__(self) -> int:
        return len(self.modes)

    def to(self, device: torch.device) -> "NormalModes":
        """The same on a device; the grid stays on the CPU."""
        return replace(self, modes=self.modes.to(device), visible=self.visible.to(device))

    def rows(self, index: Bool[Tensor, " m"] | Int[Tensor, " j"]) -> "NormalModes":
        """Of those points alone."""
        return replace(self, modes=self.modes[index], visible=self.visible[index])


class SkyNormalModes(torch.nn.Module):
    """The same of p scenes under skies above grounds of uniform radiance.

    ``visible`` (p,m,n) is of the sky's directions w, on ``rows`` of the upper hemisphere or of the
    whole sphere, ``ground`` (p,m,3) the light vector of a ground of radiance 1. Where a scene has
    fewer points, its last rows are zeros.
    """

    modes: Tensor
    visible: Tensor
    ground: Tensor
    directions: Tensor

    def __init__(
        self,
        modes: Float[Tensor, "p m 3 k"],
        visible: Float[Tensor, "p m n"],
        ground: Float[Tensor, "p m 3"],
        rows: int,
    ) -> None:
        super().__init__()
        self.rows = rows
        self.register_buffer("modes", modes)
        self.register_buffer("visible", visible)
        self.register_buffer("ground", ground)
        grid = DirectionGrid.latlong(rows, visible.shape[2] // rows)
        self.register_buffer("directions", grid.directions.to(visible))

    @staticmethod
    def of(one: NormalModes, *, sphere: bool = False) -> "SkyNormalModes":
        """That of one scene; for light of the whole ``sphere``, or of skies above grounds."""
        assert one.grid.layout is not None
        if sphere:
            none = one.visible.new_zeros(len(one), 3)
            return SkyNormalModes(
                one.modes[None], one.visible[None], none[None], one.grid.layout[0]
            )
        sky, ground = one.visible.chunk(2, dim=1)
        below = one.grid.directions[sky.shape[1] :].to(ground)
        return SkyNormalModes(
            one.modes[None],
            sky.contiguous()[None],
            (ground @ below)[None],
            one.grid.layout[0] // 2,
        )

    def forward(
        self,
        sky: Float[Tensor, "b n 3"],
        ground: Float[Tensor, "b 3"],
        amounts: Float[Tensor, "b k"],
        scene: Int[Tensor, " b"] | None = None,
    ) -> Float[Tensor, "b m 3"]:
        """<sum_k u_k M_pk, F_p> of each colour, u the ``amounts``, for an albedo of 1.

        ``sky`` may be on finer rows: F is then that of its means over blocks. ``scene`` is the one
        that each light falls on, in ascending order; None where there is but one.
        """
        vector = self.light_vector(sky, ground, scene)
        turned = shade_scenes(self.modes.flatten(1, 2), amounts[..., None], scene)
        return (turned.reshape(*vector.shape[:3], 1) * vector).sum(2)

    def light_vector(
        self,
        sky: Float[Tensor, "b n 3"],
        ground: Float[Tensor, "b 3"],
        scene: Int[Tensor, " b"] | None = None,
    ) -> Float[Tensor, "b m 3 c"]:
        """F of each colour."""
        radiance = (self._means(sky)[:, :, None] * self.directions[:, :, None]).flatten(2)
        vector = shade_scenes(self.visible, radiance, scene).unflatten(2, (3, 3))
        below = of_scene(self.ground, scene)
        return vector + below[..., None] * ground[:, None, None]

    def turned(
        self,
        skies: Float[Tensor, "b s n 3"],
        grounds: Float[Tensor, "b s 3"],
        amounts: Float[Tensor, "b k"],
        scene: Int[Tensor, " b"] | None = None,
    ) -> Float[Tensor, "b s m 3"]:
        """What :meth:`forward` gives for s lights at each of b amounts.

        With ``<sum_k u_k M_pk, w>`` in the matrix that takes a third of the products.
        """
        turns = self._turns(amounts, scene)
        matrix = self._turned_transport(turns, scene)
        means = self._means(skies.flatten(0, 1)).unflatten(0, skies.shape[:2])
        rows = means.transpose(2, 3).flatten(1, 2)  # (b, 3 s, n)
        shading = (rows @ matrix.mT).unflatten(1, (-1, 3)).transpose(2, 3)
        below = (turns * of_scene(self.ground, scene)).sum(2)
        return shading + below[:, None, :, None] * grounds[:, :, None]

    def of_turns(
        self, amounts: Float[Tensor, "b k"], scene: Int[Tensor, " b"] | None = None
    ) -> Float[Tensor, "b m n"]:
        """What is added to the transport of each of b amounts: V <sum_k u_k M_pk, w> dw / pi."""
        return self._turned_transport(self._turns(amounts, scene), scene)

    def _turned_transport(
        self, turns: Float[Tensor, "b m 3"], scene: Int[Tensor, " b"] | None
    ) -> Float[Tensor, "b m n"]:
        return (turns @ self.directions.T).mul_(of_scene(self.visible, scene))

    def _turns(
        self, amounts: Float[Tensor, "b k"], scene: Int[Tensor, " b"] | None
    ) -> Float[Tensor, "b m 3"]:
        """What is added to normals."""
        modes = of_scene(self.modes, scene).expand(len(amounts), -1, -1, -1)
        return torch.einsum("bmdk,bk->bmd", modes, amounts)

    def _means(self, sky: Float[Tensor, "b n 3"]) -> Float[Tensor, "b _ 3"]:
        """Of blocks of directions, as coarse as ``visible``."""
        block = round((sky.shape[1] / self.visible.shape[2]) ** 0.5)
        if block == 1:
            return sky
        blocks = sky.reshape(len(sky), self.rows, block, -1, block, 3)
        return blocks.mean((2, 4)).flatten(1, 2)
