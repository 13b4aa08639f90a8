"""Live rendering, frame by frame: track the board, capture and complete the lightmap, draw."""

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.cameras.board import Board
from skylight.cameras.drawing import composite, lens_rays
from skylight.cameras.intrinsics import Intrinsics
from skylight.cameras.live import Clock, LiveFrame
from skylight.cameras.response import Response
from skylight.cameras.tracking import BoardTracker
from skylight.probes.voxel.captured.capture import LightmapCapture
from skylight.probes.voxel.lightmap import Lightmap
from skylight.probes.voxel.model import VoxelModel
from skylight.probes.voxel.printed.assembly import PlacedProbe
from skylight.probes.voxel.reconstruct import SlotReconstruction
from skylight.probes.voxel.relight.render import VoxelRenderer

STAGES = ("track", "capture", "reconstruct", "draw")


class LiveView:
    """Camera frames to frames with the model composited, one after the other.

    ``to_board`` (4,4) takes the model's cells to millimetres of the board; ``reconstruction`` makes
    the weights for the slots that are known, which happens again whenever there are more.
    """

    def __init__(
        self,
        *,
        intrinsics: Intrinsics,
        board: Board,
        response: Response,
        probe: PlacedProbe,
        model: VoxelModel,
        to_board: Float[Tensor, "4 4"],
        reconstruction: Callable[[Lightmap], SlotReconstruction],
    ) -> None:
        self._intrinsics, self._response = intrinsics, response
        self._tracker = BoardTracker(board, intrinsics)
        self._capture = LightmapCapture(probe)
        self._renderer = VoxelRenderer(model, to_board)
        self._rays = lens_rays(intrinsics)
        self._make = reconstruction
        self._weights: SlotReconstruction | None = None
        self._completed: Lightmap | None = None

    def show(self, image: UInt8[np.ndarray, "h w 3"]) -> LiveFrame:
        """The frame with the model in it, as soon as every side of the probe was seen."""
        clock = Clock()
        found = self._tracker.pose(image)
        clock.mark("track")
        if found is None or found.is_ambiguous:  # a mirrored pose would spoil what is captured
            return self._frame(image, False, clock)
        taken = self._capture.add_photo(
            image, self._response, found.pose, self._intrinsics, compare=False
        )
        clock.mark("capture")
        if taken:
            self._complete()
        clock.mark("reconstruct")
        if self._completed is None:
            return self._frame(image, True, clock)
        window = self._renderer.window(found.pose, self._intrinsics)
        drawing = self._renderer.draw(self._completed, self._rays[window], found.pose)
        picture = composite(image, drawing, self._response, window)
        clock.mark("draw")
        return self._frame(picture, True, clock)

    @property
    def lightmap(self) -> Lightmap:
        """What was captured so far."""
        return self._capture.lightmap()

    def _complete(self) -> None:
        lightmap = self._capture.lightmap()
        if not bool(lightmap.known.any(1).all()):
            return
        if self._weights is None or not torch.equal(self._weights.known, lightmap.known):
            self._weights = self._make(lightmap)
        self._completed = self._weights.complete(lightmap)

    def _frame(self, picture: np.ndarray, tracked: bool, clock: Clock) -> LiveFrame:
        known = self._capture.slots
        return LiveFrame(picture=picture, tracked=tracked, known=known, times=clock.times)
