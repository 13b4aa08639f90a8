"""What was done to a film's last frame, carried to the next along the film's own motion.

Each frame's gains are found anew, and differ from those before by what noise, cutting out and
guided filters make of it. So what is used is the recursive mean

    g_k <- s T g_(k-1)(x + f) + (1 - s T) g_k,

f being the optical flow to the last frame, by dense inverse search (Kroeger et al. 2016), and T
how far both frames agree there: nothing is carried to what comes into sight.
"""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from skylight.portrait._gain import float32, resized
from skylight.portrait._relit import Gains

SHARE = 0.75  # s: of what is carried, whose mean age is s / (1 - s) = 3 frames
UNLIKE = 8.0  # codes, of their mean over a few pixels: where frames that differ so do not agree
LONG_SIDE_PX = 640  # at which motion is found
_ABOUT = 5  # pixels there


class Carried:
    """Follows a film of frames of one size; :meth:`see` each, then carry."""

    def __init__(self) -> None:
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
        self._last: UInt8[ndarray, "p q"] | None = None
        self._at: tuple[Float[ndarray, "h w"], Float[ndarray, "h w"]] | None = None
        self._trust: Float[ndarray, "h w"] | None = None

    def see(self, codes: UInt8[ndarray, "h w 3"]) -> None:
        """The next frame."""
        height, width = codes.shape[:2]
        scale = min(1.0, LONG_SIDE_PX / max(height, width))
        size = max(16, round(width * scale)), max(16, round(height * scale))
        small = cv2.cvtColor(
            cv2.resize(codes, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY
        )
        last, self._last = self._last, small
        self._at = self._trust = None
        if last is None:
            return
        flow = self._flow.calc(small, last, np.zeros((*small.shape, 2), np.float32))
        y, x = np.mgrid[: size[1], : size[0]].astype(np.float32)
        there = cv2.remap(
            last, x + flow[..., 0], y + flow[..., 1], cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        apart = small.astype(np.float32) - there
        apart -= np.median(apart)  # a camera's exposure
        apart = cv2.blur(apart, (_ABOUT, _ABOUT))
        full = resized(flow, (height, width)) / scale
        y, x = np.mgrid[:height, :width].astype(np.float32)
        self._at = x + full[..., 0], y + full[..., 1]
        self._trust = resized(np.exp(-((apart / UNLIKE) ** 2) / 2), (height, width))

    def forget(self) -> None:
        """Nothing is carried to the next frame: a cut."""
        self._last = self._at = self._trust = None

    def moved(self, before: Float[ndarray, "h w *c"]) -> Float[ndarray, "h w *c"] | None:
        """What belonged to the last frame, where its things are now; None after none."""
        if self._at is None:
            return None
        return cv2.remap(
            float32(before), *self._at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )

    def mean(self, before: Gains, now: Gains) -> Gains:
        """The module's g_k, of the last frame's g and this frame's own gains."""
        times = self.mixed(before.times, now.times)
        edge = now.edge
        if edge is not None and before.edge is not None:
            edge = self.mixed(before.edge, edge)
        return replace(now, times=times, edge=edge)

    def mixed(
        self, before: Float[ndarray, "h w *c"], now: Float[ndarray, "h w *c"]
    ) -> Float[ndarray, "h w *c"]:
        """The same of anything that is found anew in every frame."""
        moved = self.moved(before)
        if moved is None or self._trust is None:
            return now
        share = SHARE * (self._trust if now.ndim == 2 else self._trust[..., None])
        return share * moved + (1 - share) * now
