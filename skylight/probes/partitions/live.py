"""Frame by frame: track the board, look into the probe's cells, relight a scene, draw it."""

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8

from skylight.probes.capture.board import Board
from skylight.probes.capture.drawing import lens_rays
from skylight.probes.capture.intrinsics import Intrinsics
from skylight.probes.capture.live import Clock, LiveFrame
from skylight.probes.capture.pose import board_pose
from skylight.probes.capture.response import Response
from skylight.probes.partitions.capture import FaceDiscs, FaceSample, read_samples
from skylight.probes.partitions.composite import LitScene, StandingScene
from skylight.probes.partitions.placement import PlacedPartitions
from skylight.probes.partitions.probe import PartitionProbe
from skylight.probes.partitions.samples import completed, light_above_0

STAGES = ("track", "capture", "relight", "draw")
NEWER = 0.2  # share of a new sample in what is known: light follows within five frames or so


class RunningShading:
    """Shading of all faces as last seen, blended over time (thesis, section 4.6.1).

    Each sample of a face moves what is known of it: ``s <- s + 0.2 (new - s)``. So light may change
    while the camera is still, as far as the faces in view tell, and noise is averaged.
    """

    def __init__(self, shading: Float[np.ndarray, "n 3"], known: Bool[np.ndarray, " n"]) -> None:
        self.shading, self.known = shading.copy(), known.copy()

    def add(self, samples: list[FaceSample]) -> int:
        """Take samples that are large enough and not over-exposed; how many there were."""
        taken = 0
        for sample in samples:
            if sample.too_small or sample.too_bright:
                continue
            share = NEWER if self.known[sample.cell] else 1.0
            kept = self.shading[sample.cell]
            self.shading[sample.cell] = kept + share * (sample.radiance - kept)
            self.known[sample.cell] = True
            taken += 1
        return taken


class PartitionLiveView:
    """What a camera's frames become, one after the other.

    ``probe`` makes light of the shading of ``placed``, which ``shading`` begins with.
    """

    def __init__(
        self,
        *,
        intrinsics: Intrinsics,
        board: Board,
        response: Response,
        placed: PlacedPartitions,
        probe: PartitionProbe,
        scene: StandingScene,
        shading: RunningShading,
    ) -> None:
        self._intrinsics, self._board, self._response = intrinsics, board, response
        self._discs, self._probe = FaceDiscs(placed), probe
        self._scene, self._shading = scene, shading
        self._rays = lens_rays(intrinsics).float()
        self._lit: LitScene | None = None

    def show(self, image: UInt8[np.ndarray, "h w 3"]) -> LiveFrame:
        """The frame with the scene in it, as soon as half of the cells were seen."""
        clock = Clock()
        found = board_pose(image, self._board, self._intrinsics)
        clock.mark("track")
        if found is None or found.is_ambiguous:  # a mirrored pose would spoil what is captured
            return self._frame(image, False, clock)
        samples = read_samples(image, self._response, self._discs, found.pose, self._intrinsics)
        taken = self._shading.add(samples)
        clock.mark("capture")
        if taken or self._lit is None:
            self._relight()
        if self._lit is None:
            return self._frame(image, True, clock)
        clock.mark("relight")
        picture = self._scene.put_into(
            image, self._lit, found.pose, self._intrinsics, self._response, self._rays.__getitem__
        )
        clock.mark("draw")
        return self._frame(picture, True, clock)

    def _relight(self) -> None:
        known = torch.from_numpy(self._shading.known)
        if 2 * int(known.sum()) < len(known):
            return
        shading = completed(torch.from_numpy(self._shading.shading), known, self._probe)
        self._lit = self._scene.lit(light_above_0(shading, self._probe)[0])

    def _frame(self, picture: np.ndarray, tracked: bool, clock: Clock) -> LiveFrame:
        known = int(self._shading.known.sum())
        return LiveFrame(picture=picture, tracked=tracked, known=known, seconds=clock.seconds)
