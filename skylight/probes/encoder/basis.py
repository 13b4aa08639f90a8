"""Transfer functions of points of a known object: a basis on the sphere.

A Lambertian point p turns light into the radiance ``s_p = int b_p(w) L(w) dw`` with
``b_p(w) = rho_p / pi V_p(w) <n_p, w>+`` plus interreflection from other parts of the object, so
every point measures the light against a function of its own (thesis, Eq. 4.18 and section 7.1.1).
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.design.designs import named_design
from skylight.probes.partitions.relight.gather import Gatherer, Nodes, gather_all
from skylight.probes.partitions.relight.receivers import Receivers
from skylight.probes.partitions.relight.scene import Scene
from skylight.sphere.grid import DirectionGrid
from skylight.transport.matrix import diffuse_transport

_STRATA = "38d"  # cells that the rays of bounces are weighed in


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceTransfer:
    """``functions`` (m,d,3), 1/sr: b_p(w) of m points and the d directions of ``grid``, in Rec.709.

    Shading is ``sum_w dw b_p(w) L(w)``.
    """

    functions: Float[Tensor, "m d 3"]
    grid: DirectionGrid

    def __post_init__(self) -> None:
        if self.functions.shape[1] != len(self.grid):
            raise ValueError(
                f"functions {tuple(self.functions.shape)} must have a value for each of the "
                f"{len(self.grid)} directions"
            )
        if not bool(self.functions.isfinite().all()):
            raise InputError("the points' transfer has values that are NaN or infinite")

    def __len__(self) -> int:
        return len(self.functions)

    def at(self, points: Int[Tensor, " k"]) -> "SurfaceTransfer":
        """That of some of the points."""
        return SurfaceTransfer(functions=self.functions[points], grid=self.grid)

    def weighted(self) -> Float[Tensor, "3 m d"]:
        """``sqrt(dw) b_p(w)`` for each colour, float64: dot products of rows are integrals."""
        root = self.grid.solid_angles.sqrt()
        return self.functions.double().permute(2, 0, 1) * root

    def shading(self, radiance: Float[Tensor, "b d 3"]) -> Float[Tensor, "b m 3"]:
        """What the points show under lights on the grid."""
        power = radiance.double() * self.grid.solid_angles[:, None]
        return torch.einsum("mdc,bdc->bmc", self.functions.double(), power).to(radiance)


def surface_transfer(
    scene: Scene,
    receivers: Receivers,
    grid: DirectionGrid,
    *,
    bounces: int = 0,
    rays: int = 512,
    seed: int = 0,
    workers: int = 1,
) -> SurfaceTransfer:
    """b_p over the grid at points of a scene: one shadow ray per direction, then the bounces.

    Light bounces between the scene's vertices and is interpolated in between; ``rays`` leave each
    vertex and point to find where it comes from (:mod:`skylight.probes.partitions.relight.gather`).
    ``seed`` is theirs. More than one of ``workers``, processes, needs ``fork``.

    Memory: 12 d bytes for each point, three times that for each vertex where light bounces:
    200 MB for 2,048 directions and 3,000 vertices, so decimate scanned objects.
    """
    if bounces < 0:
        raise InputError(f"bounces must be 0 or more, got {bounces}")
    functions = _direct(scene, receivers, grid, workers)
    if bounces:
        nodes, cells = Nodes.of(scene), Cells.of(named_design(_STRATA))
        generator = torch.Generator().manual_seed(seed)

        def gathered_at(points: Receivers):
            gatherer = Gatherer(points, scene, nodes, cells, rays=rays, generator=generator)
            return gather_all(gatherer, workers=workers)

        def passed_on(gathered, light: Tensor, points: Receivers) -> Tensor:
            arriving = torch.from_numpy(gathered.from_nodes(light.flatten(1).numpy()))
            return arriving.reshape(-1, *light.shape[1:]) * points.albedo.float()[:, None]

        direct = _direct(scene, nodes.receivers, grid, workers)
        total, between = direct, gathered_at(nodes.receivers)
        for _ in range(bounces - 1):
            total = direct + passed_on(between, total, nodes.receivers)
        functions = functions + passed_on(gathered_at(receivers), total, receivers)
    return SurfaceTransfer(functions=functions, grid=grid)


def _direct(
    scene: Scene, receivers: Receivers, grid: DirectionGrid, workers: int
) -> Float[Tensor, "m d 3"]:
    """rho / pi V <n, w>+, float32."""
    transport = diffuse_transport(
        receivers.positions,
        receivers.normals,
        receivers.geometric_normals,
        scene.raycaster,
        grid,
        workers=workers,
    )
    per_angle = transport.matrix / grid.solid_angles.float()
    return per_angle[:, :, None] * receivers.albedo.float()[:, None]
