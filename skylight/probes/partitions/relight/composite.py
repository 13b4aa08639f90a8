"""A virtual scene on the marker board, lit by a probe and put into a photograph of the board.

Differential rendering (Debevec 1998, "Rendering synthetic objects into real scenes"): the ground
under the scene changes by what the scene does to its light,
``out = photo + rho / pi (E_with - E_without)``. A photo shows ``rho / pi E_without``, so that with
the ground's own albedo rho this is ``photo * E_with / E_without``. That form is used: rho cancels
(but for interreflections of ground and scene), patterns stay, and nothing becomes
negative.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from skylight.cameras.drawing import (
    NOWHERE,
    UNSEEN,
    Window,
    composite,
    is_empty,
    shaded,
    window_of,
)
from skylight.cameras.intrinsics import Intrinsics
from skylight.cameras.response import Response
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.relight.drawing import Mesh, SceneRenderer
from skylight.probes.partitions.relight.ground import ACROSS, Ground
from skylight.probes.partitions.relight.relit import Relighting, TurningRelighting
from skylight.probes.partitions.relight.scene import Scene
from skylight.probes.partitions.relight.transfer import TransferCoefficients, TransferSampling
from skylight.probes.partitions.relight.transfer_file import kept_transfer, kept_turning_transfer
from skylight.probes.partitions.relight.turning import Turn, TurningCoefficients
from skylight.sphere.rigid_transform import RigidTransform
from skylight.transport.raycast import Raycaster
from skylight.work.progress import Progress



@dataclass(frozen=True, kw_only=True, eq=False)
class LitScene:
    """``radiance`` of a scene's vertices, and ``shade`` E_with / E_without of the ground's.

    Both are where ``board_from_scene`` takes them.
    """

    radiance: Float[Tensor, "v 3"]
    shade: Float[Tensor, "k k 3"]
    board_from_scene: RigidTransform = _STILL


class _OnBoard:
    """A scene in the board's frame (mm) and the ground under it.

    A direction w of the probe's frame, in which ``cells`` lie, is ``rotation @ w`` on the board.
    The ``real`` probe with its pole hides what is behind it; the light that it takes from scene and
    ground is neglected.
    """

    def __init__(
        self,
        scene: Scene,
        ground: Ground,
        cells: Cells,
        rotation: Float[Tensor, "3 3"],
        real: Mesh | None = None,
    ) -> None:
        self.scene, self.ground = scene, ground
        self._renderer = SceneRenderer(scene, real)
        up = rotation.double()[1:2]  # +Y of the board in the probe's frame
        self._bare = ground.albedo / torch.pi * cells.clamped_cosine(up)[0]
        self._fade = ground.fade()[..., None]

    def put_into(
        self,
        image: UInt8[np.ndarray, "h w 3"],
        lit: LitScene,
        pose: RigidTransform,
        intrinsics: Intrinsics,
        response: Response,
        rays: Callable[[Window], Float[Tensor, "h w s 3"]],
    ) -> UInt8[np.ndarray, "h w 3"]:
        """A picture with the scene in it, by the camera's ``rays`` for a window of the picture."""
        camera_from_scene = pose @ lit.board_from_scene
        around = self.ground.extent(lit.shade, UNSEEN).numpy()
        window = window_of(around, camera_from_scene, intrinsics) if len(around) else NOWHERE
        if not is_empty(window):
            through = rays(window)
            shade = self.ground.seen(lit.shade, through, camera_from_scene)
            free = self._renderer.uncovered(window, through, pose, intrinsics)
            image = shaded(image, 1 + free[..., None] * (shade - 1), response, window)
        window = self._renderer.window(camera_from_scene, intrinsics)
        if is_empty(window):
            return image.copy()
        drawing = self._renderer.draw(lit.radiance, rays(window), pose, lit.board_from_scene)
        return composite(image, drawing, response, window)

    def _smooth(self, values: Float[Tensor, "m n 3"]) -> Float[Tensor, "m n 3"]:
        """Coefficients of the scene, then the ground's without their noise."""
        count = len(self.scene.vertices)
        return torch.cat([values[:count], self.ground.smoothed(values[count:])])

    def _lit(
        self,
        radiance: Float[Tensor, "m 3"],
        light: Float[Tensor, "n 3"],
        board_from_scene: RigidTransform = _STILL,
    ) -> LitScene:
        count = len(self.scene.vertices)
        bare = self._bare.float() @ light
        with_scene = radiance[count:].reshape(ACROSS, ACROSS, 3)
        ratio = torch.where(bare > 0, with_scene / bare.clamp(min=1e-12), 1.0)
        shade = 1 + self._fade * (ratio - 1)
        return LitScene(
            radiance=radiance[:count].contiguous(), shade=shade, board_from_scene=board_from_scene
        )


class SceneOnBoard(_OnBoard):
    """A scene that stands still on the board; ``transfer`` is that of :func:`board_transfer`."""

    def __init__(
        self,
        scene: Scene,
        ground: Ground,
        transfer: TransferCoefficients,
        cells: Cells,
        rotation: Float[Tensor, "3 3"],
        real: Mesh | None = None,
    ) -> None:
        super().__init__(scene, ground, cells, rotation, real)
        self.transfer = transfer
        self._relighting = Relighting(replace(transfer, values=self._smooth(transfer.values)))

    def lit(self, light: Float[Tensor, "n 3"]) -> LitScene:
        """Eq. 4.16 by the radiance of the cells; what is below 0 by noise counts as 0."""
        light = light.clamp(min=0).float()
        return self._lit(self._relighting(light[None])[0], light)


class TurningSceneOnBoard(_OnBoard):
    """A scene that turns about the vertical through the middle of its ground, which it shades.

    ``transfer`` is that of :func:`turning_board_transfer`. Scene and ground are told in the frame
    that turns; its patch of ground takes its shadow along, and what is there of the board is
    multiplied by it wherever that lies.
    """

    def __init__(
        self,
        scene: Scene,
        ground: Ground,
        transfer: TurningCoefficients,
        cells: Cells,
        rotation: Float[Tensor, "3 3"],
        real: Mesh | None = None,
    ) -> None:
        super().__init__(scene, ground, cells, rotation, real)
        values = torch.stack([self._smooth(each) for each in transfer.values])
        self._relighting = TurningRelighting(replace(transfer, values=values))

    def lit(self, light: Float[Tensor, "n 3"], angle_rad: float) -> LitScene:
        """As :meth:`SceneOnBoard.lit`, turned counter-clockwise seen from above."""
        light = light.clamp(min=0).float()
        radiance = self._relighting(light[None], angle_rad)[0].clamp(min=0)
        return self._lit(radiance, light, self.turned(angle_rad))

    def turned(self, angle_rad: float) -> RigidTransform:
        """``board_from_scene``."""
        x, z = self.ground.centre
        middle = torch.tensor([x, 0.0, z], dtype=torch.float64)
        return Turn().rotation(angle_rad).about(middle)


def meets(scene: Scene, real: Mesh) -> bool:
    """Whether a scene intersects a real object.

    Edges of one pass through the other, or the object's centre has the scene on all six sides.
    """
    vertices, faces = map(torch.from_numpy, real)
    if _goes_through(scene.vertices, scene.faces, Raycaster(vertices, faces)):
        return True
    if _goes_through(vertices, faces, scene.raycaster):
        return True
    low, high = vertices.aminmax(dim=0)
    axes = torch.cat([torch.eye(3), -torch.eye(3)])
    hit = scene.raycaster.faces_hit(((low + high) / 2).expand(6, 3), axes)
    return bool((hit >= 0).all())


def _goes_through(
    vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"], caster: Raycaster
) -> bool:
    """Whether an edge of the triangles meets those of the caster."""
    start, end = vertices[faces].reshape(-1, 3), vertices[faces.roll(-1, 1)].reshape(-1, 3)
    return bool((caster.intersect(start, end - start).distance <= 1).any())


def board_transfer(
    path: Path,
    scene: Scene,
    ground: Ground,
    cells: Cells,
    rotation: Float[Tensor, "3 3"],
    *,
    sampling: TransferSampling | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> TransferCoefficients:
    """Of the scene's vertices, then the ground's; kept in ``path``."""
    together = _in_probe_frame(scene, ground, rotation)
    return kept_transfer(
        path, together, cells, sampling=sampling, workers=workers, progress=progress
    )


def turning_board_transfer(
    path: Path,
    scene: Scene,
    ground: Ground,
    cells: Cells,
    rotation: Float[Tensor, "3 3"],
    *,
    angles: int,
    sampling: TransferSampling | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> TurningCoefficients:
    """:func:`board_transfer` for so many angles about the board's vertical."""
    x, y, z = rotation.double()[1].tolist()  # +Y of the board in the probe's frame
    together = _in_probe_frame(scene, ground, rotation)
    return kept_turning_transfer(
        path, together, cells, Turn(angles=angles, axis=(x, y, z)),
        sampling=sampling, workers=workers, progress=progress,
    )  # fmt: skip


def _in_probe_frame(scene: Scene, ground: Ground, rotation: Float[Tensor, "3 3"]) -> Scene:
    to_probe = torch.eye(4, dtype=torch.float64)
    to_probe[:3, :3] = rotation.double().T
    return Scene.joined([scene, ground.scene()]).placed(to_probe)
