"""A voxel model and its lightmap as one .glb file that any viewer shows."""

from pathlib import Path

from skylight.probes.unlit_glb import baked_material, write_unlit_glb
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
    """glTF 2.0 with the lightmap as texture of an unlit material (KHR_materials_unlit).

    ``voxel_size`` is in glTF's metres. ``exposure`` scales the light; what exceeds 1 is clipped,
    as textures hold no more.
    """
    import trimesh
    from trimesh.visual import TextureVisuals

    faces = exposed_faces(model)
    vertices, triangles = faces.triangles()
    uv = texture_coordinates(faces.orientation, faces.configuration, inset=0.5 / lightmap.size)
    material = baked_material(lightmap.png(exposure))
    mesh = trimesh.Trimesh(
        vertices.numpy() * voxel_size,
        triangles.numpy(),
        visual=TextureVisuals(uv=uv.reshape(-1, 2).numpy(), material=material),
        process=False,
    )
    write_unlit_glb(path, mesh)
