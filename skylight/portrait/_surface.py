"""Head, hair and bust as the camera sees them, and their shading by any distant light.

**Bust.** The head model ends at the neck. What the light does to shoulders, and which of it the
head keeps from them, is taken from :func:`~skylight.faces._bust.bust`.

**Hair.** The head model is bald. Where a photograph shows hair on scalp or forehead, its triangles
are repeated :data:`THICKNESS_M` farther out, so that hair hides the light from the skin below it
and is shaded as the round thing that it is. Thickness, locks and strands are not the person's.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray
from torch import Tensor
from torch.nn.functional import normalize

from skylight.faces._bust import bust
from skylight.faces._fit import FaceFit
from skylight.faces._model import HeadModel, Region
from skylight.faces._normal_errors import normal_changes
from skylight.faces._observe import SKIN_SPECULAR, skin_seen
from skylight.sphere._envmap import EnvironmentMap, bilinear_taps
from skylight.sphere._frame import pixel_from_direction
from skylight.transport._cameras import Camera
from skylight.transport._matrix import SeenDirections
from skylight.transport._rays import Raycaster
from skylight.transport._reflection import specular_lobe
from skylight.transport._render import (
    SMOOTH_HEIGHT,
    GBuffer,
    Specular,
    rasterize,
    split_bright,
    vertex_normals,
)
from skylight.transport._visibility import adaptive_visibility
from skylight.work._progress import Progress

THICKNESS_M = 0.011  # as that of the rendered people, 6 to 16 mm; longer hair stands off farther


def hair_shell(
    fit: FaceFit, hair: Float[ndarray, "h w"]
) -> tuple[Float[ndarray, "n 3"], Int[ndarray, "f 3"]]:
    """Vertices (metres, the camera's frame) and triangles, counter-clockwise from outside.

    ``hair`` is how likely a pixel of the photograph shows hair. It stands where that is more than a
    half at what the picture shows of scalp and forehead. The scalp that it does not show is as
    hairy as what it shows in the mean. Both arrays are empty of a bald head.
    """
    model = HeadModel.load()
    vertices, faces = torch.from_numpy(fit.vertices), torch.from_numpy(model.faces.copy())
    normals = vertex_normals(vertices, faces)
    scalp = model.regions == Region.SCALP
    height = model.mean[:, 1]
    brows = height[model.regions == Region.BROW].max()
    forehead = (model.regions == Region.FACE) & (height > brows)
    places = fit.camera.project(vertices).numpy().astype(np.float32)
    inside = ((places >= 0) & (places < (fit.camera.width, fit.camera.height))).all(1)
    seen = inside & _faces_camera(vertices, normals, Raycaster(vertices, faces))
    x, y = (places[:, None, k] - 0.5 for k in (0, 1))  # of cv2's pixels, whose centres are whole
    likely = cv2.remap(
        hair.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )[:, 0]
    hidden = scalp & ~seen
    likely[hidden] = likely[scalp & seen].mean() if (scalp & seen).any() else 0
    hairy = (likely > 0.5) & (hidden | seen & (scalp | forehead))
    kept, shell = np.unique(model.faces[hairy[model.faces].all(1)], return_inverse=True)
    return fit.vertices[kept] + THICKNESS_M * normals[kept].numpy(), shell.reshape(-1, 3)


def _faces_camera(
    vertices: Float[Tensor, "n 3"], normals: Float[Tensor, "n 3"], raycaster: Raycaster
) -> Bool[ndarray, " n"]:
    """Which vertices the camera at the origin sees, in the picture or beside it."""
    towards = normalize(-vertices, dim=1)
    starts = vertices + raycaster.epsilon * normals
    hidden = raycaster.occluded(starts.float(), towards.float())
    return (((normals * towards).sum(1) > 0) & ~hidden).numpy()


@dataclass(frozen=True, kw_only=True)
class PersonMesh:
    """Head, bust and, where there is one, the shell of hair, in the camera's frame.

    The head's vertices come first; ``regions`` (n,) are values of
    :class:`~skylight.faces._model.Region`, :data:`HAIR` or :data:`BUST`.
    """

    vertices: Float[Tensor, "n 3"]
    faces: Int[Tensor, "f 3"]
    regions: UInt8[Tensor, " n"]

    @staticmethod
    def of(fit: FaceFit, hair: Float[np.ndarray, "h w"] | None) -> "PersonMesh":
        """Of a fitted head; ``hair`` as for :meth:`PersonSurface.of`."""
        model = HeadModel.load()
        parts = [(fit.vertices, model.faces), bust(fit)]
        if hair is not None:
            parts.append(hair_shell(fit, hair))
        starts = np.cumsum([0, *(len(points) for points, _ in parts)])
        faces = [part + start for (_, part), start in zip(parts, starts[:-1], strict=True)]
        regions = np.repeat([0, BUST, HAIR][: len(parts)], np.diff(starts)).astype(np.uint8)
        regions[: len(model.regions)] = model.regions
        return PersonMesh(
            vertices=torch.from_numpy(np.concatenate([points for points, _ in parts])),
            faces=torch.from_numpy(np.concatenate(faces)),
            regions=torch.from_numpy(regions),
        )

    def regions_at(self, surface: GBuffer) -> UInt8[Tensor, " m"]:
        """Those of the nearest vertices."""
        nearest = surface.barycentric.argmax(1, keepdim=True)
        return self.regions[self.faces[surface.faces].gather(1, nearest)[:, 0]]


FACE_PX = 96  # height of the face's skin where shading is computed; photographs are not enlarged
HAIR, BUST = 254, 255  # among the regions
# Scalp is skin where no hair covers it: bald heads, and foreheads higher than the model's
SKIN = (Region.FACE, Region.LIPS, Region.BROW, Region.SCALP, Region.EAR, Region.NECK)
FINE_ROWS = 128  # of the grid of bright pixels: cells of 1.4 degrees
_BLOCK_POINTS = 64  # whose lobes stay in a core's cache


@dataclass(frozen=True, kw_only=True)
class Shading:
    """``diffuse`` and ``specular`` (m,3): what skin of albedo 1 sends to the camera; else 0."""

    diffuse: Float[Tensor, "m 3"]
    specular: Float[Tensor, "m 3"]


@runtime_checkable
class LitPerson(Protocol):
    """The surface of a person at a picture's pixels, and what any light makes of it."""

    @property
    def surface(self) -> GBuffer: ...
    @property
    def face_px(self) -> float: ...
    @property
    def regions(self) -> UInt8[Tensor, " m"]: ...
    def shade(self, light: EnvironmentMap, specular: Specular | None) -> Shading:
        """Direct light with shadows, of albedo 1. Where ``specular`` is None its part is 0, which
        saves most of the time."""
        ...


def region_image(person: LitPerson) -> Int[np.ndarray, "h w"]:
    """The regions as a picture, -1 where there is no surface."""
    shown = person.surface.image(person.regions[:, None].float() + 1)
    return shown[..., 0].long().numpy() - 1


@dataclass(frozen=True, kw_only=True)
class PersonSurface:
    """The surface at the pixels of ``camera``, whose face is ``face_px`` high.

    ``regions`` (m,) are values of :class:`~skylight.faces._model.Region`, :data:`HAIR` or
    :data:`BUST`. Light is traced to its k points of :data:`SKIN` alone, a fifth of all in a usual
    portrait: ``skin`` (k,) are their indices, and ``normals``, as an estimate has turned them, and
    ``sight`` are theirs.
    """

    surface: GBuffer
    camera: Camera
    face_px: float
    regions: UInt8[Tensor, " m"]
    skin: Int[Tensor, " k"]
    normals: Float[Tensor, "k 3"]
    sight: SeenDirections

    @staticmethod
    def of(
        fit: FaceFit,
        head_error: Float[Tensor, " d"] | None = None,
        hair: Float[np.ndarray, "h w"] | None = None,
        *,
        face_px: int = FACE_PX,
        workers: int = 1,
        progress: Progress | None = None,
    ) -> "PersonSurface":
        """Of a fitted head whose face is at most ``face_px`` high.

        ``head_error`` turns its normals by :func:`~skylight.faces._normal_errors.normal_changes`.
        ``hair`` is how likely a pixel of the photograph shows hair; without it the head has no
        shell of hair.

        Visibility is that of 32 rows of directions, 2 kB a point; what is received and reflected
        from each, kept for the next light, another 16 kB: 110 MB of 6,000 points.
        """
        height = float(np.ptp(skin_seen(HeadModel.load(), fit)[:, 1]))
        scale = min(1.0, face_px / height)
        camera = scaled(fit.camera, scale)
        model, mesh = HeadModel.load(), PersonMesh.of(fit, hair)
        raycaster = Raycaster(mesh.vertices, mesh.faces)
        surface = rasterize(camera, mesh.vertices, mesh.faces, raycaster)
        regions = mesh.regions_at(surface)
        skin = torch.isin(regions, torch.tensor(SKIN)).nonzero()[:, 0]
        normals = surface.normals[skin]
        if head_error is not None:
            turns = normal_changes(model, fit, surface, skin, head_error)
            normals = normalize(normals + turns, dim=1)
        sight = adaptive_visibility(
            surface.origins[skin],
            normals,
            surface.geometric_normals[skin],
            raycaster,
            SMOOTH_HEIGHT,
            workers=workers,
            progress=progress,
        )
        return PersonSurface(
            surface=surface,
            camera=camera,
            face_px=scale * height,
            regions=regions,
            skin=skin,
            normals=normals,
            sight=sight,
        )

    def shade(self, light: EnvironmentMap, specular: Specular | None) -> Shading:
        """Of the skin, with shadows: ``sum_w V <n, w>+ L dw / pi``, and so with f_s for 1 / pi.

        On the 32 rows on which sight is kept: no light is narrower than their 5.6 degrees.
        """
        assert specular in (None, SKIN_SPECULAR)  # whose matrix is kept for the next light
        radiance = softened(light).flat.float()
        diffuse, reflected = torch.zeros(2, len(self.regions), 3)
        diffuse[self.skin] = self._transport @ radiance
        if specular is not None:
            reflected[self.skin] = self._reflected @ radiance
        return Shading(diffuse=diffuse, specular=reflected)

    @cached_property
    def _transport(self) -> Float[Tensor, "k n"]:
        """V <n, w>+ dw / pi: 8 kB a point, for every light."""
        return self.sight[:]

    @cached_property
    def _reflected(self) -> Float[Tensor, "k n"]:
        """pi T f_s: as large."""
        return reflected_transport(
            self._transport,
            self.normals.float(),
            -normalize(self.surface.positions[self.skin], dim=1).float(),
            self.sight.grid.directions.float(),
        )


def reflected_transport(
    transport: Float[Tensor, "k n"],
    normals: Float[Tensor, "k 3"],
    views: Float[Tensor, "k 3"],
    towards: Float[Tensor, "n 3"],
) -> Float[Tensor, "k n"]:
    """pi T f_s, of skin that is seen from ``views``."""
    matrix = torch.empty_like(transport)
    for part in torch.arange(len(normals)).split(_BLOCK_POINTS):
        rows = slice(int(part[0]), int(part[-1]) + 1)
        lobe = specular_lobe(normals[rows], views[rows], towards, SKIN_SPECULAR)
        torch.mul(transport[rows], lobe.mul_(math.pi), out=matrix[rows])
    return matrix


def softened(light: EnvironmentMap, turn: Float[Tensor, "3 3"] | None = None) -> EnvironmentMap:
    """A map on 32 rows: bright pixels spread over the four cells about them, the rest averaged.

    So a shadow moves evenly with its light, as it does not where a lamp is in one cell or the next.
    With a ``turn`` R it is the map in another frame, ``L(R d)`` in direction d, of which the same
    is true as R changes: bright pixels keep all of their light, the rest is interpolated.
    """
    smooth, directions, flux = split_bright(light, FINE_ROWS)
    layout, grid = smooth.layout, smooth.grid
    if layout[0] != SMOOTH_HEIGHT:
        raise ValueError(f"a map needs {SMOOTH_HEIGHT} rows or more, got {light.layout[0]}")
    radiance = smooth.flat.double()
    if turn is not None:
        seen = pixel_from_direction(grid.directions @ turn.T, *layout)
        index, share = bilinear_taps(*layout, *seen)
        radiance = (share[..., None].double() * radiance[index]).sum(1)
        directions = directions @ turn
    index, share = bilinear_taps(*layout, *pixel_from_direction(directions, *layout))
    sent = share[..., None] * flux[:, None] / grid.solid_angles[index][..., None]
    radiance = radiance.index_add(0, index.reshape(-1), sent.reshape(-1, 3))
    return EnvironmentMap(radiance=radiance.reshape(smooth.radiance.shape).to(smooth.radiance))


def scaled(camera: Camera, scale: float) -> Camera:
    """The camera of the same picture at ``scale`` times its size, in whole pixels."""
    return camera.resized(*(max(1, round(side * scale)) for side in (camera.width, camera.height)))
