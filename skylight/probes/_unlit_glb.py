"""Meshes with baked light as .glb files of unlit materials."""

from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from skylight.io._atomic import atomic_path

if TYPE_CHECKING:
    from trimesh import Trimesh
    from trimesh.visual.material import PBRMaterial

_LINEAR, _CLAMP = 9729, 33071  # OpenGL's numbers


def baked_material(codes: UInt8[np.ndarray, "h w 3"], *, two_sided: bool = False) -> "PBRMaterial":
    """A texture of sRGB codes, as glTF has them."""
    from trimesh.visual.material import PBRMaterial

    return PBRMaterial(
        baseColorTexture=Image.fromarray(codes),
        metallicFactor=0.0,
        roughnessFactor=1.0,
        doubleSided=two_sided,
    )


def write_unlit_glb(
    path: Path,
    mesh: "Trimesh",
    *,
    normals: bool = False,
    finish: Callable[[dict], None] | None = None,
) -> None:
    """glTF 2.0 with unlit materials (KHR_materials_unlit); ``finish`` may change its JSON."""

    def unlit(tree: dict) -> None:
        tree["extensionsUsed"] = ["KHR_materials_unlit"]
        for material in tree["materials"]:
            material["extensions"] = {"KHR_materials_unlit": {}}
        if "textures" in tree:
            # mipmaps would mix what lies side by side in a texture, but not on the mesh
            sampler = {
                "magFilter": _LINEAR, "minFilter": _LINEAR, "wrapS": _CLAMP, "wrapT": _CLAMP
            }  # fmt: skip
            tree["samplers"] = [sampler]
            for texture in tree["textures"]:
                texture["sampler"] = 0
        if finish is not None:
            finish(tree)

    buffer = BytesIO()
    mesh.export(buffer, file_type="glb", include_normals=normals, tree_postprocessor=unlit)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getvalue())
