"""A voxel model and its lightmap as one .glb file that any viewer shows."""

from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image

from skylight.imaging.atomic import atomic_path
from skylight.imaging.colour import linear_to_srgb
from skylight.probes.voxel.faces import exposed_faces
from skylight.probes.voxel.lightmap import Lightmap, texture_coordinates
from skylight.probes.voxel.model import VoxelModel


def write_glb(
    path: Path,
    model: VoxelModel,
    lightmap: Lightmap,
    *,
    voxel_size: float = 1.0,
    exposure: float = 1.0,
) -> None:
    """glTF 2.0 with the lightmap as texture, which already holds all light.

    The material is KHR_materials_unlit where a viewer knows it, and black with the lightmap as
    emission where it does not, so that no viewer lights it again. ``exposure`` scales the light;
    what exceeds 1 is clipped, as textures hold no more.
    """
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    faces = exposed_faces(model)
    vertices, triangles = faces.triangles()
    uv = texture_coordinates(faces.orientation, faces.configuration, inset=0.5 / lightmap.size)
    encoded = linear_to_srgb((lightmap.image() * exposure).clamp(0, 1))
    picture = Image.fromarray((encoded.numpy() * 255 + 0.5).astype(np.uint8))
    material = PBRMaterial(baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=1.0)
    mesh = trimesh.Trimesh(
        vertices.numpy() * voxel_size,
        triangles.numpy(),
        visual=TextureVisuals(uv=uv.reshape(-1, 2).numpy(), material=material),
        process=False,
    )
    buffer = BytesIO()
    mesh.export(buffer, file_type="glb", tree_postprocessor=_unlit)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


def _unlit(tree: dict) -> None:
    """The texture holds all light there is: no viewer may light it again."""
    tree["extensionsUsed"] = ["KHR_materials_unlit"]
    for material in tree["materials"]:
        material["extensions"] = {"KHR_materials_unlit": {}}
