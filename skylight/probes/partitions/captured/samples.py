"""Shading of a partition probe's faces, one sample each, from pictures (thesis, section 4.6.1)."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.cameras.intrinsics import Intrinsics
from skylight.cameras.response import Response, saturated
from skylight.cameras.view import Picture, camera_centre, in_frame, part_around
from skylight.probes.partitions.captured.capture import ProbeCapture
from skylight.probes.partitions.printed.assembly import PlacedPartitions
from skylight.probes.partitions.printed.sizes import SEEN_DISC
from skylight.sphere.rigid_transform import RigidTransform

_GRAZING = 0.17  # cosine: faces seen under less than 10 degrees tell little
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

        Tested in the order of their cost: turned to the camera, inside of the frame, and nothing
        between the camera and the disc's centre and surroundings.
        """
        eye, probe = camera_centre(pose), self.probe
        towards = eye - probe.face_centres
        cosine = (towards * probe.normals).sum(1) / np.linalg.norm(towards, axis=1)
        _, inside = in_frame(self.guard, pose, intrinsics)
        rim, _ = in_frame(self.rim, pose, intrinsics)
        candidates = np.flatnonzero((cosine > _GRAZING) & inside)
        if len(candidates):
            free = probe.sees(eye, self.guard[candidates]).numpy().all(1)
            candidates = candidates[free]
        return candidates.tolist(), _areas(rim)


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
        """The same with samples that were read."""
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


def _areas(rims: Float[np.ndarray, "n k 2"]) -> Float[np.ndarray, " n"]:
    """Of polygons, by the shoelace formula."""
    x, y = rims.transpose(2, 0, 1)
    return 0.5 * np.abs((x * np.roll(y, -1, 1) - np.roll(x, -1, 1) * y).sum(1))
