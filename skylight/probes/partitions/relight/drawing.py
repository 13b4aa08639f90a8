"""Rendering of scenes from radiance at their vertices."""

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.cameras.drawing import Drawing, Window, box_edges, window_of
from skylight.cameras.intrinsics import Intrinsics
from skylight.probes.partitions.relight.scene import Scene, texture_at
from skylight.sphere.rigid_transform import RigidTransform
from skylight.transport.raycast import Raycaster

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

    def window(self, pose: RigidTransform, intrinsics: Intrinsics) -> Window:
        """The rectangle of a picture outside of which nothing of the scene is seen.

        ``pose`` is ``camera_from_scene``.
        """
        return window_of(self.box, pose, intrinsics)

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
