"""Transfer coefficients of scenes that turn about an axis (open in the thesis, section 4.6).

A scene that is turned by a under cells that stand still is, in its own frame, one that stands still
under cells that are turned by -a. So the coefficients at K angles are those of one scene under K
sets of cells, from the same rays, whose noise keeps its place on the scene and changes smoothly
with the angle. A ground that takes the scene's shadow turns along: what it has of contact shadow is
the same at all angles, and only where the light comes from is interpolated.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from skylight.errors import InputError
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.relight.scene import Scene
from skylight.probes.partitions.relight.transfer import (
    TransferSampling,
    transfer_coefficients,
)
from skylight.sphere.rigid_transform import RigidTransform
from skylight.work.progress import Progress

_FEWEST, _MOST = 4, 360


@dataclass(frozen=True, kw_only=True)
class Turn:
    """K ``angles`` a_k = 2 pi k / K about an ``axis`` of any length, by the right hand."""

    angles: int = 24
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0)

    def __post_init__(self) -> None:
        if not _FEWEST <= self.angles <= _MOST:
            raise InputError(f"a turn has {_FEWEST} to {_MOST} angles, got {self.angles}")
        if not all(map(math.isfinite, self.axis)) or not any(self.axis):
            raise InputError(f"an axis has a direction in finite numbers, got {self.axis}")

    @property
    def angles_rad(self) -> list[float]:
        return [2 * math.pi * k / self.angles for k in range(self.angles)]

    def rotation(self, angle_rad: float) -> RigidTransform:
        """About the axis through the origin."""
        axis = normalize(torch.tensor(self.axis, dtype=torch.float64), dim=0)
        return RigidTransform.from_vector(torch.cat([angle_rad * axis, torch.zeros(3).double()]))


@dataclass(frozen=True, kw_only=True, eq=False)
class TurningCoefficients:
    """t_i (K,m,n,3) of m receivers at K angles, float32: those of each.

    Receivers are points of the turning frame. ``orders`` (b,) are the mean over the angles.
    """

    values: Float[Tensor, "k m n 3"]
    orders: Float[Tensor, " b"]

    def __post_init__(self) -> None:
        if not bool(self.values.isfinite().all()):
            raise InputError("transfer coefficients have values that are NaN or infinite")


def turning_coefficients(
    scene: Scene,
    cells: Cells,
    turn: Turn,
    *,
    sampling: TransferSampling | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> TurningCoefficients:
    """t_i at the vertices of a scene, as it stands at a = 0, turned by each of K angles.

    K times the work of :func:`transfer_coefficients`, and 12 K n bytes for each vertex: 4 KB with
    24 angles and 14 cells.
    """
    tell = progress or (lambda _share: None)
    values = torch.empty(turn.angles, len(scene.vertices), cells.count, 3)
    orders = []
    for k, angle_rad in enumerate(turn.angles_rad):
        back = turn.rotation(-angle_rad).rotation
        made = transfer_coefficients(
            scene,
            Cells.of(cells.design.turned(back)) if k else cells,
            sampling=sampling,
            workers=workers,
            progress=lambda share, k=k: tell((k + share) / turn.angles),
        )
        values[k] = made.values
        orders.append(made.orders)
    return TurningCoefficients(values=values, orders=torch.stack(orders).mean(0))
