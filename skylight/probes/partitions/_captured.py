"""The captured shading of a partition probe: its file, what completes it, and how it is read.

Each face gives one sample, the mean of a disc about its centre, from the picture that shows it
largest (thesis, section 4.6.1). Cells that no picture shows get the smoothest light.
"""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.optimize import nnls
from torch import Tensor

from skylight.errors import InputError
from skylight.io._bounded import read_object, require_keys, write_json
from skylight.probes._capture import faces_in_view, polygon_areas
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.cameras._pose import Picture, in_frame, part_around
from skylight.probes.cameras._response import Response, saturated
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.probes.partitions.printed._assembly import PlacedPartitions
from skylight.probes.partitions.printed._solids import SEEN_DISC
from skylight.sphere._rotation import RigidTransform

_KIND, _FORMAT = "partition probe capture", 1
_NAMED_MOST = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbeCapture:
    """Shading s (n,3) of the faces' centres: linear light, 1 is the camera's largest code.

    All in float64. Cells with ``area_px`` (n,) above 0 are known: their shading is the mean of a
    disc that covers that many pixels, of which the share ``clipped`` (n,) was over-exposed. A
    ``saturated`` (n,) cell was over-exposed wherever it was seen. ``disagreement`` (n,) is the
    median relative difference of other views of a cell, NaN without any. ``albedo`` (3,) is the
    kernel's.
    """

    design: str
    fingerprint: str
    albedo: Float[Tensor, "3"]
    shading: Float[Tensor, "n 3"]
    area_px: Float[Tensor, " n"]
    clipped: Float[Tensor, " n"]
    saturated: Bool[Tensor, " n"]
    disagreement: Float[Tensor, " n"]

    def __post_init__(self) -> None:
        for values in (self.shading, self.area_px, self.clipped):
            if not bool((values.isfinite() & (values >= 0)).all()):
                raise InputError("a capture's numbers must be finite and 0 or more")
        if self.albedo.shape != (3,) or not bool(((self.albedo > 0) & (self.albedo <= 1)).all()):
            raise InputError("a kernel's albedo is three numbers above 0 and at most 1")

    @staticmethod
    def blank(design: ProbeDesign, albedo: Float[Tensor, "3"]) -> "ProbeCapture":
        """Without any known cell."""
        n = design.count
        zeros = torch.zeros(n, dtype=torch.float64)
        return ProbeCapture(
            design=design.name,
            fingerprint=fingerprint(design),
            albedo=albedo,
            shading=torch.zeros(n, 3, dtype=torch.float64),
            area_px=zeros,
            clipped=zeros,
            saturated=torch.zeros(n, dtype=torch.bool),
            disagreement=torch.full_like(zeros, torch.nan),
        )

    @property
    def known(self) -> Bool[Tensor, " n"]:
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
    digest = hashlib.sha256(seeds.tobytes())
    digest.update(design.labels.numpy().astype(np.int64).tobytes())
    return digest.hexdigest()[:16]


def complete_shading(
    shading: Float[Tensor, "n 3"], known: Bool[Tensor, " n"], probe: PartitionProbe
) -> Float[Tensor, "n 3"]:
    """The shading with that of unknown cells filled in, from the smoothest light.

    Of known cells ``pi s_i / rho_i = (A L)_i``; the radiance L of each other cell is the mean of
    its neighbours' (a discrete Laplace equation). Known shading is returned as it was; half of the
    cells must be known.
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
    albedo = probe.albedo.detach().cpu()
    gathered = torch.where(known[:, None], torch.pi * shading.double() / albedo, 0.0)
    light = torch.linalg.solve(system, gathered)
    filled = albedo / torch.pi * (probe.response.cpu() @ light)
    return torch.where(known[:, None], shading, filled.clamp(min=0).to(shading))


def nonnegative_light(
    shading: Float[Tensor, "n 3"], probe: PartitionProbe
) -> tuple[Float[Tensor, "n 3"], float]:
    """(radiance of the cells, relative residual) by non-negative least squares.

    ``min |A L - g|`` over L >= 0 in each colour, g = pi s / rho (Lawson & Hanson 1974): that is
    :meth:`PartitionProbe.light` where nothing of that is below 0. The residual is
    ``|A L - g| / |g|``.
    """
    gathered = (torch.pi * shading.double() / probe.albedo.detach().cpu()).numpy()
    found = [nnls(probe.response.cpu().double().numpy(), colour) for colour in gathered.T]
    light = torch.from_numpy(np.stack([each for each, _ in found], 1))
    left, whole = np.linalg.norm([norm for _, norm in found]), np.linalg.norm(gathered)
    return light.to(shading), float(left / whole) if whole > 0 else 0.0


def name_cells(cells: Bool[Tensor, " n"], normals: Float[Tensor, "n 3"]) -> str:
    """The marked cells, with their normals in the board's frame: +Y up, +Z to the reader."""
    marked = torch.nonzero(cells)[:, 0].tolist()
    rounded = (normals.round(decimals=2) + 0.0).tolist()
    named = [
        f"cell {i} towards ({', '.join(f'{value:.2f}' for value in rounded[i])})"
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
            "disagreement": float(d) if (d := capture.disagreement[i]).isfinite() else None,
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

    def tensor(values: object, *shape: int) -> Float[Tensor, "..."]:
        # null becomes NaN
        return torch.from_numpy(np.array(values, dtype=np.float64).reshape(shape))

    def column(name: str, *shape: int) -> Float[Tensor, "..."]:
        return tensor([each[name] for each in cells], len(cells), *shape)

    area = column("area_px")
    if ((column("known") != 0) != (area > 0)).any():
        raise ValueError("known cells have an area_px above 0, others none")
    return ProbeCapture(
        design=str(content["design"]),
        fingerprint=str(content["fingerprint"]),
        albedo=tensor(content["kernel_albedo"], 3),
        shading=column("shading", 3),
        area_px=area,
        clipped=column("clipped"),
        saturated=column("saturated") != 0,
        disagreement=column("disagreement"),
    )


_DISC = 0.5  # of a face's free radius: the rest is for poses that are off by little
_SAMPLES, _RIM = 64, 16
_MOST_CLIPPED = 0.1  # share of a disc
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
LEAST_AREA_PX = 12.0  # two pixels of radius; of smaller discs, what is beside them is a part


@dataclass(frozen=True, kw_only=True)
class FaceSample:
    """A face in one picture: mean radiance of its disc, the disc's area, the share clipped."""

    cell: int
    radiance: Float[Tensor, "3"]
    area_px: float
    clipped: float

    @property
    def too_bright(self) -> bool:
        return self.clipped > _MOST_CLIPPED

    @property
    def too_small(self) -> bool:
        return self.area_px < LEAST_AREA_PX


class FaceDiscs:
    """A disc round each face's centre, of half the radius that is free of walls; board's frame.

    Even samples ``inside`` (n,64,3), ``rim`` (n,16,3) and, three quarters of the way to the walls,
    ``guard`` (n,17,3) with the centre.
    """

    def __init__(self, probe: PlacedPartitions) -> None:
        self.probe = probe
        k = np.arange(_SAMPLES)
        # equal areas along a sunflower's spiral (Vogel 1979)
        radius = np.sqrt((k + 0.5) / _SAMPLES)
        spiral = radius[:, None] * _circle(k * _GOLDEN_ANGLE)
        ring = _circle(np.arange(_RIM) * (2 * np.pi / _RIM))
        self.inside = self._on_faces(_DISC * spiral)
        self.rim = self._on_faces(_DISC * ring)
        self.guard = self._on_faces(np.concatenate([SEEN_DISC * ring, np.zeros((1, 2))]))

    def _on_faces(self, plane: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "n k 3"]:
        """Places in the plane of each face, in units of its free radius."""
        normals = self.probe.normals
        across = np.cross(normals, np.eye(3)[np.abs(normals).argmin(1)])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        axes = (
            np.stack([across, np.cross(normals, across)], 1) * self.probe.face_radii[:, None, None]
        )
        return self.probe.face_centres[:, None] + plane @ axes

    def visible(
        self, pose: RigidTransform, intrinsics: Intrinsics
    ) -> tuple[list[int], Float[np.ndarray, " n"]]:
        """(cells whose disc a picture shows whole, sizes of all discs on screen, px^2).

        Nothing is between the camera and the disc's centre and surroundings.
        """
        probe, guard = self.probe, self.guard
        rim, _ = in_frame(self.rim, pose, intrinsics)
        shown = faces_in_view(
            probe.face_centres, probe.normals, guard, guard, probe.sees, pose, intrinsics
        )
        return shown, polygon_areas(rim)


def read_samples(
    image: Picture,
    response: Response,
    discs: FaceDiscs,
    pose: RigidTransform,
    intrinsics: Intrinsics,
) -> list[FaceSample]:
    """One sample of each face that a picture, as the camera gave it, shows well enough.

    The mean of 64 bilinear samples of linear light, each at its own place through the lens'
    distortion.
    """
    cells, areas = discs.visible(pose, intrinsics)
    if not cells:
        return []
    places, _ = in_frame(discs.inside[cells], pose, intrinsics)
    codes, corner = part_around(image, places)
    x, y = (places - np.array(corner)).astype(np.float32).transpose(2, 0, 1)
    light = cv2.remap(response.linearise(codes).numpy(), x, y, cv2.INTER_LINEAR)
    burnt = cv2.remap(saturated(codes).astype(np.float32), x, y, cv2.INTER_LINEAR) > 0
    return [
        FaceSample(
            cell=cell,
            radiance=torch.from_numpy(light[i].mean(0, dtype=np.float64)),
            area_px=float(areas[cell]),
            clipped=float(burnt[i].mean()),
        )
        for i, cell in enumerate(cells)
    ]


class SampleCapture:
    """Accumulates shading over pictures: of each face, its largest view.

    ``start`` is what is known already, or ``ProbeCapture.blank``.
    """

    def __init__(self, probe: PlacedPartitions, start: ProbeCapture) -> None:
        self.discs = FaceDiscs(probe)
        self._start = start
        self._shading = start.shading.clone()
        self._area = start.area_px.clone()
        self._clipped = start.clipped.clone()
        self.small = torch.zeros(len(self._area), dtype=torch.bool)
        """Unknown cells of which some view was too small."""
        self.rejected = start.saturated.clone()
        """Unknown cells of which some view was over-exposed."""
        self.disagreements = [[d] if math.isfinite(d) else [] for d in start.disagreement.tolist()]
        """Of each cell seen again: differences of views from the one kept, over its maximum."""

    def add_photo(
        self, image: Picture, response: Response, pose: RigidTransform, intrinsics: Intrinsics
    ) -> int:
        """Keep what a picture shows larger than any before; how many cells that are."""
        return self.add(read_samples(image, response, self.discs, pose, intrinsics))

    def add(self, samples: list[FaceSample]) -> int:
        """Keep samples that are larger than any before; how many cells that are."""
        taken = 0
        for sample in samples:
            cell, known = sample.cell, bool(self._area[sample.cell] > 0)
            if sample.too_small or sample.too_bright:
                why = self.small if sample.too_small else self.rejected
                why[cell] |= not known
                continue
            if known:
                kept = self._shading[cell]
                apart = (sample.radiance - kept).abs().max() / kept.max().clamp(min=1e-6)
                self.disagreements[cell].append(float(apart))
            if sample.area_px <= self._area[cell]:
                continue
            self._shading[cell] = sample.radiance
            self._area[cell], self._clipped[cell] = sample.area_px, sample.clipped
            self.small[cell] = self.rejected[cell] = False
            taken += 1
        return taken

    def captured(self) -> ProbeCapture:
        """What is known so far."""
        apart = [float(np.median(d)) if d else np.nan for d in self.disagreements]
        return replace(
            self._start,
            shading=self._shading.clone(),
            area_px=self._area.clone(),
            clipped=self._clipped.clone(),
            saturated=self.rejected.clone(),
            disagreement=torch.tensor(apart, dtype=torch.float64),
        )


def _circle(angles: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k 2"]:
    return np.stack([np.cos(angles), np.sin(angles)], 1)
