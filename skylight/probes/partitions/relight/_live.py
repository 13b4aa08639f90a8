"""Live relighting, frame by frame: track the board, read the faces, relight a scene, draw it."""

import numpy as np
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from skylight.probes._capture import LiveView
from skylight.probes.cameras._drawing import lens_rays
from skylight.probes.cameras._files import Setup
from skylight.probes.cameras._live import Clock, LiveFrame
from skylight.probes.partitions._captured import (
    FaceDiscs,
    FaceSample,
    complete_shading,
    nonnegative_light,
    read_samples,
)
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions.printed._assembly import PlacedPartitions
from skylight.probes.partitions.relight._composite import LitScene, SceneOnBoard
from skylight.sphere._rotation import RigidTransform

NEWER = 0.2  # weight of a new sample: light follows within five frames or so


class RunningShading:
    """Exponential moving average of the faces' shading (thesis, section 4.6.1).

    A new sample of a face changes its value by ``s <- s + 0.2 (new - s)``, which follows changes of
    the light in the faces in view, and averages noise.
    """

    def __init__(self, shading: Float[Tensor, "n 3"], known: Bool[Tensor, " n"]) -> None:
        self.shading, self.known = shading.clone(), known.clone()

    def add(self, samples: list[FaceSample]) -> int:
        """Add samples that are large enough and not over-exposed; returns their number."""
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


class PartitionLiveView(LiveView):
    """Camera frames to frames with a scene in them, as soon as half of the cells were seen.

    ``probe`` makes light of the shading of ``placed``, which ``shading`` begins with. A scene that
    turns is at ``start_rad`` in the first frame, and ``step_rad`` further in each one after it.
    """

    def __init__(
        self,
        setup: Setup,
        *,
        placed: PlacedPartitions,
        probe: PartitionProbe,
        scene: SceneOnBoard,
        shading: RunningShading,
        start_rad: float = 0.0,
        step_rad: float = 0.0,
    ) -> None:
        super().__init__(setup)
        self.counted = f"of {probe.cells.count} cells"
        self._discs, self._probe = FaceDiscs(placed), probe
        self._scene, self.shading = scene, shading
        self._angle_rad, self._step_rad = start_rad - step_rad, step_rad
        self._rays = lens_rays(setup.intrinsics).float()
        self._light: Float[Tensor, "n 3"] | None = None
        self._lit: LitScene | None = None

    @property
    def known(self) -> int:
        return int(self.shading.known.sum())

    def show(self, image: UInt8[np.ndarray, "h w 3"]) -> LiveFrame:
        self._angle_rad += self._step_rad  # in frames without the board too
        return super().show(image)

    def draw(
        self, image: UInt8[np.ndarray, "h w 3"], pose: RigidTransform, clock: Clock
    ) -> UInt8[np.ndarray, "h w 3"] | None:
        lens, response = self.setup.intrinsics, self.setup.response
        taken = self.shading.add(read_samples(image, response, self._discs, pose, lens))
        clock.mark("capture")
        known = self.shading.known
        if (taken or self._light is None) and 2 * int(known.sum()) >= len(known):
            shading = complete_shading(self.shading.shading, known, self._probe)
            self._light = nonnegative_light(shading, self._probe)[0]
        if self._light is not None and (taken or self._lit is None or self._step_rad != 0):
            self._lit = self._scene.lit(self._light, self._angle_rad)
        if self._lit is None:
            return None
        clock.mark("relight")
        picture = self._scene.put_into(
            image, self._lit, pose, lens, response, self._rays.__getitem__
        )
        clock.mark("draw")
        return picture
