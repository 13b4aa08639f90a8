"""Layout of parts on a printer's bed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from skylight.errors import InputError
from skylight.fabrication.part import PrintedPart
from skylight.sphere.rigid_transform import RigidTransform

_WIDTHS = 60  # shelf widths that are tried


@dataclass(frozen=True, kw_only=True)
class BedLayout:
    """Parts as they lie on the bed (z = 0, first corner at the origin), in the order given."""

    parts: tuple[PrintedPart, ...]
    size_mm: tuple[float, float, float]

    @property
    def volume_mm3(self) -> float:
        """Of the box around all parts."""
        return float(np.prod(self.size_mm))


def lay_out(parts: Sequence[PrintedPart], *, spacing_mm: float = 3.0) -> BedLayout:
    """Each part upright (its ``up`` to +Z), on shelves of the width with the smallest volume.

    Parts go onto shelves by decreasing depth, the next shelf begins where one is full ("next fit
    decreasing height", Coffman et al. 1980); a number of widths is tried.
    """
    if not parts:
        raise InputError("there is no part to lay out")
    if not spacing_mm >= 0:
        raise InputError(f"spacing_mm must be 0 or more, got {spacing_mm}")
    upright = [_upright(part) for part in parts]
    sizes = np.array([np.ptp(part.bounds, axis=0) for part in upright]) + spacing_mm
    order = sorted(range(len(parts)), key=lambda i: (-sizes[i, 1], -sizes[i, 0], i))
    narrowest, row = sizes[:, 0].max(), sizes[:, 0].sum()
    best: tuple[float, float, np.ndarray] | None = None
    for width in np.linspace(narrowest, row, _WIDTHS):
        places = _shelves(sizes[order], float(width))
        across, deep = (places + sizes[order, :2]).max(0)
        # of equal areas the squarest
        area = float(across * deep), float(max(across, deep))
        if best is None or area < best[:2]:
            best = (*area, places)
    assert best is not None
    corner = np.zeros((len(parts), 3))
    corner[order, :2] = best[2]
    placed = [part.shifted(at - part.bounds[0]) for part, at in zip(upright, corner, strict=True)]
    width, depth, height = np.max([part.bounds[1] for part in placed], axis=0).tolist()
    return BedLayout(parts=tuple(placed), size_mm=(width, depth, height))


def _upright(part: PrintedPart) -> PrintedPart:
    """With ``up`` along +Z and the longer side of its footprint along X."""
    up = np.array(part.up)
    across = np.roll(np.abs(up), 1)
    turn = np.stack([across, np.cross(up, across), up]).astype(float)
    turned = part.moved(RigidTransform.from_numpy(turn, np.zeros(3)))
    width, depth, _ = np.ptp(turned.bounds, axis=0)
    if depth > width + 1e-9:
        quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        turned = turned.moved(RigidTransform.from_numpy(quarter, np.zeros(3)))
    return turned


def _shelves(sizes: Float[np.ndarray, "n 3"], width: float) -> Float[np.ndarray, "n 2"]:
    """First corners of boxes that come by decreasing depth."""
    places = np.zeros((len(sizes), 2))
    x = y = depth = 0.0
    for i, (across, deep, _) in enumerate(sizes):
        if x and x + across > width + 1e-9:
            x, y, depth = 0.0, y + depth, 0.0
        places[i] = x, y
        x, depth = x + across, max(depth, deep)
    return places
