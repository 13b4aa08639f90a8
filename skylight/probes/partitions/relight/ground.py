"""The plane of the board around a virtual object: it receives its shadow and reflects light."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import conv2d, grid_sample, pad

from skylight.cameras.drawing import box_edges
from skylight.errors import InputError
from skylight.probes.partitions.relight.scene import Scene
from skylight.sphere.rigid_transform import RigidTransform

ACROSS = 97  # vertices along each side
_REACH = 6.0  # heights of the object, from its footprint to the patch's rim
_LEAST_REACH = 1.5  # widths of the object
_FADING = 0.3  # of the reach, over which the last of the shadow goes


@dataclass(frozen=True, kw_only=True)
class Ground:
    """A square patch of the plane y = ``level``, with the middle (x, z) ``centre``.

    Vertices stand at ``centre + width sinh(k u)`` for u = -1 to 1 along both axes, with k so that
    the last are ``reach`` away: about equally dense within ``width``, the object's, and further
    apart in proportion to their distance beyond.

    The lower a cell, the longer the shadows in its light. As cells are wide, an object occludes
    hardly any of one at a distance of six times its height: see :meth:`fade`.
    """

    centre: tuple[float, float]
    level: float
    width: float
    reach: float
    albedo: float = 0.5

    def __post_init__(self) -> None:
        numbers = (*self.centre, self.level, self.width, self.reach)
        if not all(map(math.isfinite, numbers)) or not 0 < self.width < self.reach:
            raise InputError(f"a ground needs finite places and 0 < width < reach, got {numbers}")
        if not 0 < self.albedo <= 1:
            raise InputError(f"the ground's albedo must be above 0, at most 1, got {self.albedo:g}")

    @staticmethod
    def under(scene: Scene, *, level: float = 0.0, albedo: float = 0.5) -> "Ground":
        """As large as the shadow of a scene may be."""
        low, high = scene.vertices.amin(0), scene.vertices.amax(0)
        if float(low[1]) < level - 1e-3 * float(high[1] - low[1]):
            raise InputError("the scene reaches below the ground: let it stand higher")
        extent = high - low
        width = max(float(extent[0]), float(extent[2])) / 2
        if width == 0:
            raise InputError("the scene has no width: nothing could be seen of it")
        middle = (low + high) / 2
        rise = float(high[1]) - level
        return Ground(
            centre=(float(middle[0]), float(middle[2])),
            level=level,
            width=width,
            reach=math.sqrt(2) * width + max(_REACH * rise, _LEAST_REACH * width),
            albedo=albedo,
        )

    def scene(self) -> Scene:
        """The patch as triangles that look up; vertex (row, column) is ``row * ACROSS + column``.

        Rows run along +Z, columns along +X.
        """
        place = self._places()
        z, x = torch.meshgrid(place + self.centre[1], place + self.centre[0], indexing="ij")
        vertices = torch.stack([x, torch.full_like(x, self.level), z], 2).reshape(-1, 3)
        number = torch.arange(ACROSS**2).reshape(ACROSS, ACROSS)
        a, b = number[:-1, :-1].flatten(), number[:-1, 1:].flatten()
        c, d = number[1:, 1:].flatten(), number[1:, :-1].flatten()
        up = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
        return Scene(
            vertices=vertices,
            faces=torch.cat([torch.stack([a, d, c], 1), torch.stack([a, c, b], 1)]),
            normals=up.expand(len(vertices), 3),
            albedo=torch.full((len(vertices), 3), self.albedo, dtype=torch.float64),
        )

    def fade(self) -> Float[Tensor, "k k"]:
        """1 in the middle, 0 from ``reach`` on, smooth in between."""
        place = self._places()
        distance = torch.hypot(place[:, None], place)
        share = ((self.reach - distance) / (_FADING * self.reach)).clamp(0, 1)
        return (share**2 * (3 - 2 * share)).float()

    def smoothed(self, values: Float[Tensor, "m n 3"]) -> Float[Tensor, "m n 3"]:
        """Values at the vertices, beyond the scene's footprint as means of their neighbours'.

        Few rays from far away meet the scene, so that noise is large there and shadows, of wide
        cells, are soft: a binomial window of five vertices, a quarter of their distance across.
        """
        grid = values.reshape(ACROSS, ACROSS, -1).permute(2, 0, 1)[:, None]
        line = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0]).to(grid) / 16
        mean = pad(grid, (2, 2, 2, 2), mode="replicate")
        mean = conv2d(conv2d(mean, line[None, None, :, None]), line[None, None, None])
        place = self._places().abs()
        far = torch.maximum(place[:, None], place) / self.width
        weight = (far - 1).clamp(0, 1).to(grid)
        mixed = grid + weight * (mean - grid)
        return mixed[:, 0].permute(1, 2, 0).reshape(values.shape)

    def extent(self, image: Float[Tensor, "k k 3"], threshold: float) -> Float[Tensor, "n 3"]:
        """Points round the rectangle within which values differ from 1 by more than that."""
        differs = ((image - 1).abs() > threshold).any(2)
        corners = []
        for axis in (0, 1):  # along Z, then X
            there = torch.nonzero(differs.any(1 - axis))[:, 0]
            if not len(there):
                return torch.zeros(0, 3, dtype=torch.float64)
            # values are interpolated up to the next vertex
            ends = torch.stack([there[0] - 1, there[-1] + 1]).clamp(0, ACROSS - 1)
            corners.append(self._places()[ends] + self.centre[1 - axis])
        (z0, z1), (x0, x1) = corners
        level = torch.tensor(self.level, dtype=torch.float64)
        return box_edges(torch.stack([x0, level, z0]), torch.stack([x1, level, z1]))

    def seen(
        self,
        image: Float[Tensor, "k k 3"],
        rays: Float[Tensor, "h w s 3"],
        pose: RigidTransform,
    ) -> Float[Tensor, "h w 3"]:
        """A picture of values at the vertices as a camera sees it; 1 where it sees no ground.

        Bilinear; the values at the rim must be 1.
        """
        height, width, samples, _ = rays.shape
        back = pose.inverse()
        eye = back.translation
        drop = float(eye[1]) - self.level
        if drop <= 0:
            return torch.ones(height, width, 3)
        directions = back.directions(rays.reshape(-1, 3).float())
        # what looks past the ground goes far away
        along = drop / (-directions[:, 1]).clamp(min=1e-6)
        x = float(eye[0]) - self.centre[0] + along * directions[:, 0]
        z = float(eye[2]) - self.centre[1] + along * directions[:, 2]
        # several times faster than torch's asinh
        place = np.arcsinh((torch.stack([x, z], 1) / self.width).numpy()) / np.float32(self._bend)
        values = grid_sample(
            image.permute(2, 0, 1)[None],
            torch.from_numpy(place).reshape(1, height * width, samples, 2),
            padding_mode="border",
            align_corners=True,
        )
        return values[0].mean(2).T.reshape(height, width, 3)

    @property
    def _bend(self) -> float:
        return math.asinh(self.reach / self.width)

    def _places(self) -> Float[Tensor, " k"]:
        u = torch.linspace(-1, 1, ACROSS, dtype=torch.float64)
        return self.width * torch.sinh(self._bend * u)
