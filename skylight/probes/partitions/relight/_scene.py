"""Virtual scenes: Lambertian triangle meshes with albedo per vertex or texture, from mesh files."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from PIL import Image
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, KDTree
from torch import Tensor
from torch.nn.functional import normalize

from skylight.errors import InputError
from skylight.imaging._colour import srgb_to_linear
from skylight.io._bounded import require_pixels
from skylight.transport._mesh import CREASE_RAD, FARTHEST, loaded_parts, require_coordinates
from skylight.transport._rays import Raycaster
from skylight.transport._render import vertex_normals

if TYPE_CHECKING:
    from trimesh import Trimesh


_SAME_PLANE = 1e-4  # of normals, and of distances over the scene's diagonal
# of a triangle: a rule of degree 2 that keeps off the corners, and the middle
_PLACES = torch.tensor([[4, 1, 1], [1, 4, 1], [1, 1, 4], [2, 2, 2]]).double() / 6


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A mesh in the world's frame (+Y up), any unit of length; make it with :meth:`of`.

    ``normals`` are unit, smooth within smooth parts; the vertices are split at edges and at seams
    of the texture. ``albedo`` is linear, in 0..1, at the vertices; a textured scene has ``uv``
    (u to the right, v up, repeating beyond 0..1) and ``texture`` (linear) besides, and its
    ``albedo`` holds the texture's means around the vertices.
    """

    vertices: Float[Tensor, "n 3"]
    faces: Int[Tensor, "f 3"]
    normals: Float[Tensor, "n 3"]
    albedo: Float[Tensor, "n 3"]
    uv: Float[Tensor, "n 2"] | None = None
    texture: Float[Tensor, "h w 3"] | None = None

    def __post_init__(self) -> None:
        if not len(self.faces):
            raise InputError("the scene has no triangles: points and curves show no shading")
        if not bool(self.vertices.isfinite().all()):
            raise InputError("the scene has vertices that are NaN or infinite; repair the mesh")
        if (self.uv is None) != (self.texture is None):
            raise InputError("a textured scene needs both texture coordinates and a texture")
        for values in (self.albedo, self.texture):
            if values is not None and not bool(((values >= 0) & (values <= 1)).all()):
                raise InputError(
                    f"albedos lie in 0 to 1, got {float(values.min()):g} to {float(values.max()):g}"
                )

    @staticmethod
    def of(
        vertices: Float[Tensor, "v 3"],
        faces: Int[Tensor, "f 3"],
        albedo: Float[Tensor, "*v 3"],
        *,
        uv: Float[Tensor, "v 2"] | None = None,
        texture: Float[Tensor, "h w 3"] | None = None,
    ) -> "Scene":
        """From a mesh and one albedo, or one for each vertex; a texture goes before it.

        Vertices in one place are shaded as one, unless the triangles there meet at more than 40
        degrees.
        """
        if len(faces) and (int(faces.min()) < 0 or int(faces.max()) >= len(vertices)):
            raise InputError(f"the triangles must index the {len(vertices)} vertices")
        vertices, albedo = vertices.double(), albedo.double().expand(len(vertices), 3)
        smooth, corner_normals = _smooth_corners(vertices, faces)
        # one vertex for each smooth part's vertex and what else the mesh tells apart there
        known = [vertices, albedo] if uv is None else [vertices, albedo, uv.double()]
        first, same = _places(torch.cat(known, 1))
        pairs, number = (smooth * len(first) + same[faces]).unique(return_inverse=True)
        part, kept = pairs // len(first), first[pairs % len(first)]
        scene = Scene(
            vertices=vertices[kept],
            faces=number,
            normals=corner_normals[part],
            albedo=albedo[kept],
            uv=None if uv is None else uv.double()[kept],
            texture=texture,
        )
        return scene if texture is None else replace(scene, albedo=scene._mean_albedo())

    @staticmethod
    def joined(scenes: Sequence["Scene"]) -> "Scene":
        """Several as one; of several, textures become their means around the vertices."""
        if len(scenes) == 1:
            return scenes[0]
        first = np.cumsum([0] + [len(scene.vertices) for scene in scenes]).tolist()
        return Scene(
            vertices=torch.cat([scene.vertices for scene in scenes]),
            faces=torch.cat([s.faces + n for s, n in zip(scenes, first[:-1], strict=True)]),
            normals=torch.cat([scene.normals for scene in scenes]),
            albedo=torch.cat([scene.albedo for scene in scenes]),
        )

    def placed(self, matrix: Float[Tensor, "4 4"]) -> "Scene":
        """Moved, turned and scaled: x' = A x + b for an affine [[A, b], [0, 1]]."""
        matrix = matrix.double()
        linear, last = matrix[:3, :3], torch.tensor([0, 0, 0, 1.0]).double()
        determinant = float(torch.linalg.det(linear))
        if not bool(matrix.isfinite().all()) or determinant == 0 or not matrix[3].equal(last):
            raise InputError("a placement is an affine 4 x 4 matrix that can be undone")
        return replace(
            self,
            vertices=self.vertices @ linear.T + matrix[:3, 3],
            # a mirror image is wound the other way
            faces=self.faces if determinant > 0 else self.faces.flip(1),
            normals=normalize(self.normals @ torch.linalg.inv(linear), dim=1),
        )

    @cached_property
    def raycaster(self) -> Raycaster:
        return Raycaster(self.vertices, self.faces)

    @property
    def area(self) -> float:
        """Of all triangles, one side."""
        return float(self._doubled_areas().norm(dim=1).sum()) / 2

    @cached_property
    def face_normals(self) -> Float[Tensor, "f 3"]:
        """Unit, by the right hand; 0 for triangles without area."""
        return normalize(self._doubled_areas(), dim=1)

    @cached_property
    def two_sided(self) -> Bool[Tensor, " f"]:
        """Triangles whose back light may leave for the scene: open ones with the scene behind.

        That is not so for a ground under everything.
        """
        result = self.open_faces.clone()
        which = torch.nonzero(result)[:, 0]
        if not len(which) or len(_places(self.vertices)[0]) <= 3:
            return torch.zeros_like(result)
        # nothing is behind a triangle if, turned round, it lies in the scene's convex hull
        places = (self.vertices - self.vertices.mean(0)) / self.raycaster.diagonal
        # joggled, so that flat scenes have a hull as well
        hull = KDTree(ConvexHull(places.numpy(), qhull_options="QJ").equations)
        normal, corner = self.face_normals[which], places[self.faces[which, 0]]
        plane = torch.cat([-normal, (normal * corner).sum(1, keepdim=True)], 1)
        apart, _ = hull.query(plane.numpy(), distance_upper_bound=_SAME_PLANE)
        result[which] = torch.from_numpy(np.isinf(apart))
        return result

    @cached_property
    def open_faces(self) -> Bool[Tensor, " f"]:
        """Triangles of parts with borders or wound both ways, whose back may be lit.

        A part is closed if each of its edges is run through once in each direction.
        """
        place = _places(self.vertices)[1][self.faces]
        start, end = place.flatten(), place.roll(-1, 1).flatten()
        edge = start * len(self.vertices) + end
        reverse = end * len(self.vertices) + start
        known, uses = edge.unique(return_counts=True)
        found = torch.searchsorted(known, reverse).clamp(max=len(known) - 1)
        paired = (known[found] == reverse) & (uses[found] == 1)
        links = coo_array(
            (np.ones(len(start), np.int8), (start.numpy(), end.numpy())),
            shape=(len(self.vertices), len(self.vertices)),
        )
        parts, part = connected_components(links, directed=False)
        lacking = torch.zeros(parts, dtype=torch.bool)
        part = torch.from_numpy(part).long()
        lacking[part[start[~paired]]] = True
        return lacking[part[place[:, 0]]]

    def albedo_at(
        self, faces: Int[Tensor, " m"], barycentric: Float[Tensor, "m 3"]
    ) -> Float[Tensor, "m 3"]:
        """Albedo on triangles, from the texture where there is one."""
        if self.uv is None or self.texture is None:
            return self.interpolated(self.albedo, faces, barycentric)
        return texture_at(self.texture, self.interpolated(self.uv, faces, barycentric))

    def interpolated(
        self, values: Float[Tensor, "n c"], faces: Int[Tensor, " m"], barycentric: Tensor
    ) -> Float[Tensor, "m c"]:
        """Values at the vertices, in between."""
        return (values[self.faces[faces]] * barycentric[:, :, None].to(values)).sum(1)

    def _doubled_areas(self) -> Float[Tensor, "f 3"]:
        a, b, c = self.vertices[self.faces].unbind(1)
        return torch.linalg.cross(b - a, c - a)

    def _mean_albedo(self) -> Float[Tensor, "n 3"]:
        """The texture around each vertex, weighed as a vertex is in interpolation."""
        total = torch.zeros(len(self.vertices), 4, dtype=torch.float64)
        area = self._doubled_areas().norm(dim=1) + 1e-300
        every = torch.arange(len(self.faces))
        for place in _PLACES:
            colour = self.albedo_at(every, place.expand(len(every), 3)).double()
            seen = torch.cat([colour, torch.ones_like(colour[:, :1])], 1) * area[:, None]
            for corner, share in zip(self.faces.T, place, strict=True):
                total.index_add_(0, corner, share * seen)
        return (total[:, :3] / total[:, 3:].clamp(min=1e-300)).clamp(0, 1)


def texture_at(texture: Float[Tensor, "h w 3"], uv: Float[Tensor, "m 2"]) -> Float[Tensor, "m 3"]:
    """Bilinear, repeating; v = 1 is the upper edge, texel centres lie at half numbers."""
    height, width = texture.shape[:2]
    size = torch.tensor([width, height], dtype=torch.float64)
    place = torch.stack([uv[:, 0], 1 - uv[:, 1]], 1).double() * size - 0.5
    corner = place.floor()
    share = place - corner
    column, row = corner.long().unbind(1)
    result = torch.zeros(len(uv), 3, dtype=torch.float64)
    for down in (0, 1):
        for right in (0, 1):
            weight = (share[:, 0] if right else 1 - share[:, 0]) * (
                share[:, 1] if down else 1 - share[:, 1]
            )
            texel = texture[(row + down) % height, (column + right) % width]
            result += weight[:, None] * texel
    return result


def _places(vertices: Float[Tensor, "v c"]) -> tuple[Int[Tensor, " k"], Int[Tensor, " v"]]:
    """(a vertex of each of k different ones, which of them each is); torch.unique is slow."""
    order = torch.from_numpy(np.lexsort(vertices.numpy().T))
    new = (vertices[order].diff(dim=0) != 0).any(1)
    number = torch.empty(len(vertices), dtype=torch.long)
    number[order] = torch.nn.functional.pad(new.long().cumsum(0), (1, 0))
    return order[torch.nn.functional.pad(new, (1, 0), value=True)], number


def _smooth_corners(
    vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"]
) -> tuple[Int[Tensor, "f 3"], Float[Tensor, "k 3"]]:
    """(which of k smooth vertices each corner belongs to, their unit normals)."""
    from trimesh import Trimesh  # slow to import
    from trimesh.graph import smooth_shade

    first, place = _places(vertices)
    welded = Trimesh(vertices[first].numpy(), place[faces].numpy(), process=False)
    smooth = smooth_shade(welded, angle=CREASE_RAD)
    parts = smooth.metadata.get("original_components")
    order = np.arange(len(faces)) if parts is None else np.concatenate(parts)
    numbers = torch.empty_like(faces)
    numbers[torch.from_numpy(order)] = torch.from_numpy(np.array(smooth.faces, np.int64))
    places = torch.from_numpy(np.array(smooth.vertices, np.float64))
    return numbers, vertex_normals(places, torch.from_numpy(np.array(smooth.faces, np.int64)))


DEFAULT_ALBEDO = (0.7, 0.7, 0.7)
# colours at vertices are linear there (glTF 2.0, 3.7.2.1), elsewhere codes by custom
_LINEAR_SUFFIXES = (".glb", ".gltf")


def read_scene(path: str | Path, albedo: tuple[float, float, float] = DEFAULT_ALBEDO) -> Scene:
    """The meshes of a file in its own units and axes; ``albedo`` (linear) where it has no colour.

    Textures and colours are taken as diffuse albedos: a PBR material's base colour, a Phong
    material's diffuse picture or colour, or colours of vertices or faces. Pictures, and colours of
    vertices and faces outside of glTF, are taken for sRGB; materials' colours are linear. Where a
    file has several meshes, textures become colours at the vertices.

    Raises
    ------
    InputError
        A missing or damaged file, another format, no faces, or vertices or
        texture coordinates that are not finite.
    """
    path = Path(path)
    meshes = loaded_parts(path)
    try:
        return scene_of(meshes, albedo, linear=path.suffix.lower() in _LINEAR_SUFFIXES)
    except (InputError, ValueError) as error:
        raise InputError(f"{path}: {error}") from error


def scene_of(
    geometries: Iterable[Any], albedo: tuple[float, float, float], *, linear: bool
) -> Scene:
    """trimesh's meshes as one scene; ``linear``: their colours are, if not their textures."""
    scenes = [_one(mesh, albedo, linear) for mesh in geometries if len(getattr(mesh, "faces", ()))]
    if not scenes:
        raise InputError("the mesh has no faces: points and curves show no shading")
    return Scene.joined(scenes)


def _one(mesh: "Trimesh", albedo: tuple[float, float, float], linear: bool) -> Scene:
    vertices = torch.from_numpy(np.array(mesh.vertices, np.float64))
    faces = torch.from_numpy(np.array(mesh.faces, np.int64))
    require_coordinates(vertices.numpy())
    visual: Any = mesh.visual
    plain = torch.tensor(albedo, dtype=torch.float64)
    if visual.kind == "vertex":
        return Scene.of(vertices, faces, _colours(visual.vertex_colors, linear=linear))
    if visual.kind == "face":
        # every triangle its own corners, so that colours do not run
        colours = _colours(visual.face_colors, linear=linear).repeat_interleave(3, 0)
        corners = torch.arange(3 * len(faces)).reshape(-1, 3)
        return Scene.of(vertices[faces].reshape(-1, 3), corners, colours)
    if visual.kind != "texture":
        return Scene.of(vertices, faces, plain)
    picture, colour = _material(visual.material, plain)
    if picture is None or visual.uv is None or len(visual.uv) != len(vertices):
        return Scene.of(vertices, faces, colour)
    codes = _codes(picture)
    return Scene.of(
        vertices,
        faces,
        colour,
        uv=_places_in_texture(visual.uv),
        texture=(srgb_to_linear(torch.from_numpy(codes)) * colour.float()).clamp(0, 1),
    )


def _places_in_texture(uv: Any) -> Float[Tensor, "v 2"]:
    """Readers keep however many numbers a file gives; a third one is for solid textures."""
    places = np.array(uv, np.float64).reshape(len(uv), -1)[:, :2]
    if places.shape[1] != 2 or not (np.abs(places) < FARTHEST).all():  # false for NaN too
        raise InputError(
            "the mesh has texture coordinates that are no pairs of numbers, or NaN, infinite or "
            f"beyond {FARTHEST:g}; repair it"
        )
    return torch.from_numpy(places)


def _codes(picture: Image.Image) -> Float[np.ndarray, "h w 3"]:
    """From 0 to 1; ValueError for a texture that is too large or damaged."""
    require_pixels(*picture.size)
    try:
        if picture.mode.startswith("I"):  # grey of 16 bits, which Pillow would cut at 255
            return np.repeat(np.array(picture, np.float32)[..., None], 3, -1) / 65535
        return np.array(picture.convert("RGB"), np.float32) / 255
    except (OSError, SyntaxError, EOFError) as error:
        raise ValueError(f"its texture is damaged ({error})") from error


def _material(material: Any, plain: Float[Tensor, "3"]) -> tuple[Any, Float[Tensor, "3"]]:
    """(picture or None, the colour that it is multiplied with, or that stands alone)."""
    white = torch.ones(3, dtype=torch.float64)
    picture = getattr(material, "baseColorTexture", None)
    factor = getattr(material, "baseColorFactor", None)
    if picture is None and factor is None:
        picture = getattr(material, "image", None)
        # trimesh gives its own grey where a file names no colour
        named = getattr(material, "kwargs", {}) or {}
        factor = material.diffuse if picture is None and "kd" in named else None
    if factor is not None:
        return picture, _colours(np.atleast_2d(factor), linear=True)[0]
    return picture, plain if picture is None else white


def _colours(codes: Any, *, linear: bool) -> Float[Tensor, "k 3"]:
    values = torch.from_numpy(np.array(codes, np.float64)[:, :3] / 255)
    return values if linear else srgb_to_linear(values)
