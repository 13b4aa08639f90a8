"""A virtual scene on the marker board, lit by a probe and put into a photograph of the board.

Differential rendering (Debevec 1998, "Rendering synthetic objects into real scenes"): the ground
under the scene changes by what the scene does to its light,
``out = photo + rho / pi (E_with - E_without)``. A photo shows ``rho / pi E_without``, so that with
the ground's own albedo rho this is ``photo * E_with / E_without``. That form is used: rho cancels
(but for interreflections of ground and scene), patterns stay, and nothing becomes negative. The
scene is relit by precomputed transfer and drawn from the radiance at its vertices, in real time.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor, nn

from skylight.errors import check_shape
from skylight.probes.cameras._drawing import (
    NOWHERE,
    UNSEEN,
    Drawing,
    Window,
    box_edges,
    composite,
    is_empty,
    shaded,
    window_of,
)
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.cameras._response import Response
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions.relight._gather import ACROSS, Ground
from skylight.probes.partitions.relight._scene import Scene, texture_at
from skylight.probes.partitions.relight._transfer import (
    TransferCoefficients,
    TransferSampling,
    Turn,
    kept_transfer,
)
from skylight.sphere._rotation import RigidTransform
from skylight.transport._rays import Raycaster
from skylight.work._progress import Progress

_DARK = 1e-4  # an albedo that may be divided by
_STILL = RigidTransform.identity()
Mesh = tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]


class SceneRenderer:
    """Draws one scene from anywhere; its ray caster is made once, also for a scene that moves.

    Surfaces are two-sided. ``real`` (vertices, triangles) is an object in the photograph, in the
    world: it occludes what is behind it, and is not drawn itself. The scene is in a frame of its
    own, which poses take to the world.
    """

    def __init__(self, scene: Scene, real: Mesh | None = None) -> None:
        self.scene = scene
        self._real: _Real | None = None if real is None else _Real(real)
        self._corners = scene.vertices[scene.faces]
        box = box_edges(scene.vertices.amin(0), scene.vertices.amax(0))
        self.box: Float[np.ndarray, "n 3"] = box.numpy()

    def draw(
        self,
        radiance: Float[Tensor, "v 3"],
        rays: Float[Tensor, "h w s 3"],
        pose: RigidTransform,
        world_from_scene: RigidTransform = _STILL,
    ) -> Drawing:
        """By unit ``rays`` of a camera with the pose ``camera_from_world``.

        A pixel is the mean of its s rays. ``radiance`` of the vertices is interpolated; where there
        is a texture, what falls on them is, and the texture reflects it.
        """
        height, width, samples, _ = rays.shape
        eye, directions = _cast(rays, pose @ world_from_scene)
        face = self.scene.raycaster.faces_hit(eye.float().expand(len(directions), 3), directions)
        found = torch.nonzero(face >= 0)[:, 0]
        place = self._barycentric(eye, face[found], directions[found])
        if self._real is not None:
            rays = rays.reshape(-1, 3)[found]
            met = self._real.met(rays, pose)
            points = self.scene.interpolated(self.scene.vertices, face[found[met]], place[met])
            free = torch.ones(len(found), dtype=torch.bool)
            free[met] = self._real.distance(rays[met], pose) > (points - eye).norm(dim=1)
            found, place = found[free], place[free]
        colours = torch.zeros(height * width * samples, 4)
        colours[found, :3] = self._shading(radiance.float(), face[found], place)
        colours[found, 3] = 1
        pixels = colours.reshape(height, width, samples, 4).mean(2)
        return Drawing(radiance=pixels[..., :3], alpha=pixels[..., 3])

    def uncovered(
        self,
        window: Window,
        rays: Float[Tensor, "h w s 3"],
        pose: RigidTransform,
        intrinsics: Intrinsics,
    ) -> Float[Tensor, "h w"]:
        """The share of each pixel of a window without the real thing, were there no scene."""
        share = torch.ones(rays.shape[:2])
        if self._real is None:
            return share
        part = window_of(self._real.box, pose, intrinsics)
        rows, columns = (
            slice(max(a.start, b.start) - b.start, max(min(a.stop, b.stop) - b.start, 0))
            for a, b in zip(part, window, strict=True)
        )
        inner = rays[rows, columns]
        if inner.numel():
            met = self._real.met(inner, pose).float()
            share[rows, columns] = 1 - met.reshape(inner.shape[:3]).mean(2)
        return share

    def _barycentric(
        self, eye: Float[Tensor, "3"], face: Int[Tensor, " r"], directions: Float[Tensor, "r 3"]
    ) -> Float[Tensor, "r 3"]:
        """Ratios of the volumes that a ray d spans with two corners each, as seen from the eye.

        Corner a weighs ``<d, (b - e) x (c - e)>``; the products are worked out once for each
        triangle that is seen, in float64, as they are much larger than the volumes.
        """
        shown = torch.zeros(len(self._corners), dtype=torch.bool)
        shown[face] = True
        a, b, c = (self._corners[shown] - eye).unbind(1)
        planes = torch.stack([b.cross(c, 1), c.cross(a, 1), a.cross(b, 1)], 1).float()
        number = shown.cumsum(0)[face] - 1
        volumes = torch.einsum("rki,ri->rk", planes[number], directions)
        total = volumes.sum(1, keepdim=True)
        # rounding lets hits on an edge lie outside; triangles seen edge-on have no volume
        return torch.where(total == 0, 1 / 3, volumes / total).clamp(0, 1)

    def _shading(
        self, radiance: Float[Tensor, "v 3"], face: Int[Tensor, " r"], place: Float[Tensor, "r 3"]
    ) -> Float[Tensor, "r 3"]:
        scene = self.scene
        if scene.uv is None or scene.texture is None:
            return scene.interpolated(radiance, face, place)
        falling = radiance / scene.albedo.float().clamp(min=_DARK)
        albedo = texture_at(scene.texture, scene.interpolated(scene.uv, face, place))
        return scene.interpolated(falling, face, place) * albedo.float()


class _Real:
    """What is in the photograph before or behind a scene."""

    def __init__(self, mesh: Mesh) -> None:
        vertices, faces = map(torch.from_numpy, mesh)
        self._caster = Raycaster(vertices, faces)
        self.box: Float[np.ndarray, "n 3"] = box_edges(*vertices.aminmax(dim=0)).numpy()

    def met(self, rays: Float[Tensor, "*_ 3"], pose: RigidTransform) -> Bool[Tensor, " r"]:
        """Which of a camera's rays meet it."""
        eye, directions = _cast(rays, pose)
        return self._caster.occluded(eye.float().expand(len(directions), 3), directions)

    def distance(self, rays: Float[Tensor, "r 3"], pose: RigidTransform) -> Float[Tensor, " r"]:
        """How far it is along unit rays."""
        eye, directions = _cast(rays, pose)
        hits = self._caster.intersect(eye.float().expand(len(directions), 3), directions)
        return hits.distance


def _cast(
    rays: Float[Tensor, "*_ 3"], pose: RigidTransform
) -> tuple[Float[Tensor, "3"], Float[Tensor, "r 3"]]:
    """(the camera's place, directions) in the frame from which ``pose`` goes to the camera's."""
    back = pose.inverse()
    return back.translation, back.directions(rays.reshape(-1, 3).float())


class Relighting(nn.Module):
    """L_c(x) = sum_i L_ic t_ic(x) (thesis, Eq. 4.16, with the probe's weights in the light).

    One product for each colour, linear in the light and so differentiable.
    """

    transfer: Tensor

    def __init__(self, coefficients: TransferCoefficients) -> None:
        super().__init__()
        # cells by receivers: the fastest layout for one light, and for few
        self.register_buffer("transfer", coefficients.values.permute(2, 1, 0).contiguous())

    def forward(self, light: Float[Tensor, "*b n 3"]) -> Float[Tensor, "*b m 3"]:
        """Radiance of every receiver from the radiance of every cell, in the light's dtype.

        A view whose colours lie apart in memory.
        """
        check_shape("light", light.shape, self.transfer.shape[1], 3)
        lights = light.to(self.transfer.dtype).reshape(-1, *light.shape[-2:])
        radiance = torch.bmm(lights.permute(2, 0, 1), self.transfer)  # (3, b, m)
        return radiance.permute(1, 2, 0).reshape(*light.shape[:-2], -1, 3).to(light.dtype)


class TurningRelighting(nn.Module):
    """L_c(x, a) = sum_i L_ic t_ic(x, a) of what is turned by any angle a, rad.

    Coefficients between the K angles are those of a periodic cubic spline through them::

        t(x, a) = sum_k beta(K a / 2 pi - k) c_k(x),    beta the cubic B-spline

    whose four summands that are not 0 cost four times a :class:`Relighting`. Exact at the K angles;
    linear in the light, differentiable in light and angle. 12 K n bytes for each receiver.

    Half way between the angles, radiance of a cow of 50 mm by 14 cells in eight captured maps is
    off from what is traced there, by root mean square over the mean (in the worst map), by::

        K              6            8            12           16           24           48
        cow       2.7 (4.8) %  1.4 (2.4) %  1.0 (1.5) %  0.8 (1.2) %  0.7 (1.0) %  0.5 (0.7) %
        ground    1.1 (2.1) %  0.6 (1.2) %  0.5 (0.9) %  0.4 (0.8) %  0.4 (0.7) %  0.2 (0.5) %

    (of the ground, over what it has without the cow). The noise of the
    256 traced rays, which moves from cell to cell with the angle, is a part of it.
    """

    spline: Tensor

    def __init__(self, coefficients: TransferCoefficients) -> None:
        super().__init__()
        values = coefficients.values
        knots = _spline_coefficients(len(values)).to(values) @ values.flatten(1)
        self.register_buffer(
            "spline", knots.reshape(values.shape).permute(0, 3, 2, 1).contiguous()
        )  # angles, colours, cells, receivers

    def forward(
        self, light: Float[Tensor, "*b n 3"], angle_rad: float | Float[Tensor, ""]
    ) -> Float[Tensor, "*b m 3"]:
        """Radiance of every receiver, as :meth:`Relighting.forward`, all lights at one angle.

        Between the angles it may be below 0, by as much as the spline is off.
        """
        check_shape("light", light.shape, self.spline.shape[2], 3)
        count = len(self.spline)
        place = torch.as_tensor(angle_rad, dtype=torch.float64) / (2 * math.pi) * count
        below = place.detach().floor()
        weights = _b_spline(place - below).to(self.spline)
        nearest = (below.long() + torch.arange(-1, 3, device=below.device)) % count
        knots = self.spline[nearest.to(self.spline.device)].flatten(0, 1)
        lights = light.to(self.spline.dtype).reshape(-1, *light.shape[-2:]).permute(2, 0, 1)
        weighted = (weights[:, None, None, None] * lights).flatten(0, 1)
        radiance = torch.bmm(weighted, knots).unflatten(0, (4, 3)).sum(0)  # (3, b, m)
        return radiance.permute(1, 2, 0).reshape(*light.shape[:-2], -1, 3).to(light.dtype)


def _b_spline(u: Float[Tensor, ""]) -> Float[Tensor, "4"]:
    """beta of the knots before, at, after, and two after a place that is u beyond a knot."""
    v = 1 - u
    return torch.stack([v**3, 4 - 6 * u**2 + 3 * u**3, 4 - 6 * v**2 + 3 * v**3, u**3]) / 6


def _spline_coefficients(count: int) -> Float[Tensor, "k k"]:
    """From values at K periodic knots to the coefficients of the spline through them."""
    one = torch.eye(count, dtype=torch.float64)
    return torch.linalg.inv((one.roll(1, 0) + 4 * one + one.roll(-1, 0)) / 6)


@dataclass(frozen=True, kw_only=True, eq=False)
class LitScene:
    """``radiance`` of a scene's vertices, and ``shade`` E_with / E_without of the ground's.

    Both are where ``board_from_scene`` takes them.
    """

    radiance: Float[Tensor, "v 3"]
    shade: Float[Tensor, "k k 3"]
    board_from_scene: RigidTransform = _STILL


class SceneOnBoard:
    """A scene in the board's frame (mm) and the ground under it.

    ``transfer`` is that of :func:`board_transfer`. A direction w of the probe's frame, in which
    ``cells`` lie, is ``rotation @ w`` on the board. The ``real`` probe with its pole hides what is
    behind it; the light that it takes from scene and ground is neglected.

    With coefficients of several angles the scene turns about the vertical through the middle of
    its ground, which it shades. Scene and ground are then those of the frame that turns; the patch
    of ground takes its shadow along, and what is there of the board is multiplied by it wherever
    that lies.
    """

    def __init__(
        self,
        scene: Scene,
        ground: Ground,
        transfer: TransferCoefficients,
        cells: Cells,
        rotation: Float[Tensor, "3 3"],
        real: Mesh | None = None,
    ) -> None:
        self.scene, self.ground, self.transfer = scene, ground, transfer
        self._renderer = SceneRenderer(scene, real)
        up = rotation.double()[1:2]  # +Y of the board in the probe's frame
        self._bare = ground.albedo / torch.pi * cells.clamped_cosine(up)[0]
        self._fade = ground.fade()[..., None]
        self._relighting: Relighting | TurningRelighting
        if transfer.values.ndim == 3:
            smooth = self._smooth(transfer.values)
            self._relighting = Relighting(replace(transfer, values=smooth))
        else:
            smooth = torch.stack([self._smooth(each) for each in transfer.values])
            self._relighting = TurningRelighting(replace(transfer, values=smooth))

    def lit(self, light: Float[Tensor, "n 3"], angle_rad: float = 0.0) -> LitScene:
        """Eq. 4.16 by the radiance of the cells; what is below 0 by noise counts as 0.

        A scene that turns is turned by the angle, counter-clockwise seen from above; others stay as
        they were placed.
        """
        light = light.clamp(min=0).float()
        if isinstance(self._relighting, TurningRelighting):
            radiance = self._relighting(light[None], angle_rad)[0].clamp(min=0)
            return self._lit(radiance, light, self.turned(angle_rad))
        return self._lit(self._relighting(light[None])[0], light, _STILL)

    def turned(self, angle_rad: float) -> RigidTransform:
        """``board_from_scene``."""
        x, z = self.ground.centre
        middle = torch.tensor([x, 0.0, z], dtype=torch.float64)
        return Turn().rotation(angle_rad).about(middle)

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
        window = window_of(self._renderer.box, camera_from_scene, intrinsics)
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
        board_from_scene: RigidTransform,
    ) -> LitScene:
        count = len(self.scene.vertices)
        bare = self._bare.float() @ light
        with_scene = radiance[count:].reshape(ACROSS, ACROSS, 3)
        ratio = torch.where(bare > 0, with_scene / bare.clamp(min=1e-12), 1.0)
        shade = 1 + self._fade * (ratio - 1)
        return LitScene(
            radiance=radiance[:count].contiguous(), shade=shade, board_from_scene=board_from_scene
        )


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
    angles: int | None = None,
    sampling: TransferSampling | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> TransferCoefficients:
    """Of the scene's vertices, then the ground's; kept in ``path``.

    With ``angles``, those of each of so many about the board's vertical.
    """
    x, y, z = rotation.double()[1].tolist()  # +Y of the board in the probe's frame
    return kept_transfer(
        path,
        in_probe_frame(Scene.joined([scene, ground.scene()]), rotation),
        cells,
        turn=None if angles is None else Turn(angles=angles, axis=(x, y, z)),
        sampling=sampling,
        workers=workers,
        progress=progress,
    )


def in_probe_frame(scene: Scene, rotation: Float[Tensor, "3 3"]) -> Scene:
    """Of a scene in the board's frame, in which a probe's direction w is ``rotation @ w``."""
    to_probe = torch.eye(4, dtype=torch.float64)
    to_probe[:3, :3] = rotation.double().T
    return scene.placed(to_probe)
