"""Scenes from mesh files, with their colours."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from skylight.errors import InputError
from skylight.imaging.colour import srgb_to_linear
from skylight.io.bounded import require_pixels
from skylight.probes.partitions.relight.scene import Scene
from skylight.transport.mesh import FARTHEST, loaded_mesh, require_coordinates

if TYPE_CHECKING:
    from trimesh import Trimesh

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
    import trimesh  # slow to import

    path = Path(path)
    meshes = loaded_mesh(path, lambda file: trimesh.load_scene(file, process=False).dump())
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
