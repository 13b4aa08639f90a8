"""The captured shading of a partition probe, its file, and cells that no picture shows."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.optimize import nnls
from torch import Tensor

from skylight.errors import InputError
from skylight.imaging.files import write_json
from skylight.probes.capture.json_files import read_object, require_keys
from skylight.probes.partitions.design import ProbeDesign
from skylight.probes.partitions.probe import PartitionProbe

_KIND, _FORMAT = "partition probe capture", 1
_NAMED_MOST = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbeCapture:
    """Shading s (n,3) of the faces' centres: linear light, 1 is the camera's largest code.

    Cells with ``area_px`` (n,) above 0 are known, and their shading was read from a disc of that
    size on screen, of which the share ``clipped`` (n,) was too bright for the camera. A
    ``saturated`` (n,) cell was too bright wherever it was seen. ``disagreement`` (n,) is by how
    much other views of a cell differ, median, NaN without any. ``albedo`` (3,) is the kernel's.
    """

    design: str
    fingerprint: str
    albedo: Float[np.ndarray, "3"]
    shading: Float[np.ndarray, "n 3"]
    area_px: Float[np.ndarray, " n"]
    clipped: Float[np.ndarray, " n"]
    saturated: Bool[np.ndarray, " n"]
    disagreement: Float[np.ndarray, " n"]

    def __post_init__(self) -> None:
        n = len(self.shading)
        if self.shading.shape != (n, 3) or any(
            each.shape != (n,)
            for each in (self.area_px, self.clipped, self.saturated, self.disagreement)
        ):
            raise InputError("a capture's rows must be one for each cell, with three colours")
        for values in (self.shading, self.area_px, self.clipped):
            if not (np.isfinite(values).all() and (values >= 0).all()):
                raise InputError("a capture's numbers must be finite and 0 or more")
        if self.albedo.shape != (3,) or not ((self.albedo > 0) & (self.albedo <= 1)).all():
            raise InputError("a kernel's albedo is three numbers above 0 and at most 1")

    @staticmethod
    def blank(design: ProbeDesign, albedo: Float[np.ndarray, "3"]) -> "ProbeCapture":
        """Of which nothing is known yet."""
        n = design.count
        return ProbeCapture(
            design=design.name,
            fingerprint=fingerprint(design),
            albedo=albedo,
            shading=np.zeros((n, 3)),
            area_px=np.zeros(n),
            clipped=np.zeros(n),
            saturated=np.zeros(n, bool),
            disagreement=np.full(n, np.nan),
        )

    @property
    def known(self) -> Bool[np.ndarray, " n"]:
        return self.area_px > 0

    def require_design(self, design: ProbeDesign) -> None:
        """Refuse another probe than the one that was captured."""
        if self.fingerprint != fingerprint(design):
            raise InputError(
                f"the capture is of a probe of design {self.design!r} with "
                f"{len(self.shading)} cells, not of this {design.name!r} with {design.count}: "
                "give the files of one probe"
            )


def fingerprint(design: ProbeDesign) -> str:
    """16 letters that are the same for the same seeds and cells, whatever the name."""
    seeds = np.round(design.seeds.numpy(), 9) + 0.0  # no -0
    told = hashlib.sha256(seeds.tobytes())
    told.update(design.labels.numpy().astype(np.int64).tobytes())
    return told.hexdigest()[:16]


def completed(
    shading: Float[Tensor, "n 3"], known: Bool[Tensor, " n"], probe: PartitionProbe
) -> Float[Tensor, "n 3"]:
    """The same, and of cells that are not known what they would show under the smoothest light.

    Known cells keep ``pi s_i / rho_i = (A L)_i``; the light L of each other cell is the mean of
    its neighbours'. Known shading comes back as it was. Whoever calls this tells the user.

    Raises
    ------
    InputError
        Less than half of the cells are known.
    """
    count, n = int(known.sum()), probe.cells.count
    if 2 * count < n:
        raise InputError(
            f"only {count} of {n} cells were captured, half of them are needed: take more "
            "pictures all round the probe"
        )
    near = probe.cells.neighbours.double()
    smooth = torch.eye(n, dtype=torch.float64) - near / near.sum(1, keepdim=True)
    system = torch.where(known[:, None], probe.response.cpu(), smooth)
    albedo = probe.albedo.cpu()
    told = torch.where(known[:, None], torch.pi * shading.double() / albedo, 0.0)
    light = torch.linalg.solve(system, told)
    filled = albedo / torch.pi * (probe.response.cpu() @ light)
    return torch.where(known[:, None], shading, filled.clamp(min=0).to(shading))


def light_above_0(
    shading: Float[Tensor, "n 3"], probe: PartitionProbe
) -> tuple[Float[Tensor, "n 3"], float]:
    """(the radiance L >= 0 of the cells that explains shading best, by how much it does not).

    Least squares of ``|A L - pi s / rho|`` in each colour (Lawson & Hanson 1974). That is
    :meth:`PartitionProbe.light` where nothing in that is below 0. The second is the root of what
    is left over of the squares, of all of them.
    """
    told = (torch.pi * shading.double() / probe.albedo.cpu()).numpy()
    found = [nnls(probe.response.cpu().double().numpy(), colour) for colour in told.T]
    light = torch.from_numpy(np.stack([each for each, _ in found], 1))
    left, whole = np.linalg.norm([norm for _, norm in found]), np.linalg.norm(told)
    return light.to(shading), float(left / whole) if whole > 0 else 0.0


def name_cells(cells: Bool[np.ndarray, " n"], normals: Float[np.ndarray, "n 3"]) -> str:
    """The cells that are marked, with where they look over the board: +Y up, +Z to the reader."""
    marked = np.flatnonzero(cells).tolist()
    named = [
        f"cell {i} towards ({', '.join(f'{value + 0.0:.2f}' for value in normals[i].round(2))})"
        for i in marked[:_NAMED_MOST]
    ]
    others = len(marked) - len(named)
    return ", ".join(named) + (f" and {others} others" if others else "")


def save_capture(path: str | Path, capture: ProbeCapture) -> None:
    """Write the capture as JSON."""
    cells = [
        {
            "shading": capture.shading[i].tolist(),
            "known": bool(capture.known[i]),
            "area_px": float(capture.area_px[i]),
            "clipped": float(capture.clipped[i]),
            "saturated": bool(capture.saturated[i]),
            "disagreement": float(d) if np.isfinite(d := capture.disagreement[i]) else None,
        }
        for i in range(len(capture.shading))
    ]
    content = {
        "kind": _KIND,
        "format": _FORMAT,
        "design": capture.design,
        "fingerprint": capture.fingerprint,
        "kernel_albedo": capture.albedo.tolist(),
        "cells": cells,
    }
    write_json(path, content)


def load_capture(path: str | Path) -> ProbeCapture:
    """The capture that :func:`save_capture` wrote.

    Raises
    ------
    InputError
        The file is missing or no such file, or its numbers cannot be.
    """
    content = read_object(path, _KIND)
    require_keys(path, content, ["format", "design", "fingerprint", "kernel_albedo", "cells"])
    if content["format"] != _FORMAT:
        raise InputError(f"{path}: of format {content['format']}, this program reads {_FORMAT}")
    try:
        return _capture_of(content)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(f"{path}: its numbers are not those of a capture ({error})") from error


def _capture_of(content: Mapping[str, object]) -> ProbeCapture:
    cells = content["cells"]
    if not isinstance(cells, list) or not cells:
        raise ValueError("a list of them is wanted")

    def column(name: str, *shape: int) -> Float[np.ndarray, "..."]:
        values = [each[name] for each in cells]
        return np.array(values, dtype=np.float64).reshape(len(cells), *shape)

    area = column("area_px")
    if (column("known").astype(bool) != (area > 0)).any():
        raise ValueError("known cells have an area_px above 0, others none")
    return ProbeCapture(
        design=str(content["design"]),
        fingerprint=str(content["fingerprint"]),
        albedo=np.array(content["kernel_albedo"], dtype=np.float64).reshape(3),
        shading=column("shading", 3),
        area_px=area,
        clipped=column("clipped"),
        saturated=column("saturated").astype(bool),
        disagreement=column("disagreement"),  # null becomes NaN
    )
