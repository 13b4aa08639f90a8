"""A voxel model and its lightmap as one .glb file that any viewer shows."""

from io import BytesIO
from pathlib import Path

from PIL import Image

from skylight.imaging.atomic import atomic_path
from skylight.probes.voxel.faces import exposed_faces
from skylight.probes.voxel.lightmap import Lightmap, texture_coordinates
from skylight.probes.voxel.model import VoxelModel

_LINEAR, _CLAMP = 9729, 33071  # OpenGL's numbers


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
    from trimesh.visual.material import PBRMaterial

    faces = exposed_faces(model)
    vertices, triangles = faces.triangles()
    uv = texture_coordinates(faces.orientation, faces.configuration, inset=0.5 / lightmap.size)
    picture = Image.fromarray(lightmap.png(exposure))
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
    # mipmaps would mix slots that lie side by side
    sampler = {"magFilter": _LINEAR, "minFilter": _LINEAR, "wrapS": _CLAMP, "wrapT": _CLAMP}
    tree["samplers"] = [sampler]
    for texture in tree["textures"]:
        texture["sampler"] = 0
    for material in tree["materials"]:
        material["extensions"] = {"KHR_materials_unlit": {}}
