"""A printed partition probe as a .glb preview."""

from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from skylight.fabrication.part import PrintedPart
from skylight.io.atomic import atomic_path
from skylight.probes.partitions.printed.printing import PrintedPartitions

_SHELL = (0.05, 0.05, 0.06)  # linear reflectance of dull black paint
_METRES = 0.001  # of a millimetre


def write_partition_preview(
    path: Path, printed: PrintedPartitions, colours: Float[np.ndarray, "n 3"]
) -> None:
    """The parts as assembled, in metres and the design's axes, as nodes of their names.

    ``colours`` are linear ones of the kernel's faces, cell by cell, as vertex colours.
    """
    from trimesh import Scene, Trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    parts, scene = printed.printed, Scene()
    for part in parts.parts:
        of_faces = np.tile(_SHELL, (len(part.faces), 1))
        if part is parts.kernel:
            of_faces = colours[_cells(part, parts.net.normals)]
        codes = (255 * of_faces.clip(0, 1)).round().astype(np.uint8).repeat(3, 0)
        visual = TextureVisuals(material=PBRMaterial(metallicFactor=0.0, roughnessFactor=1.0))
        visual.vertex_attributes["color"] = np.pad(codes, ((0, 0), (0, 1)), constant_values=255)
        corners = (part.corners @ parts.rotation * _METRES).reshape(-1, 3)
        triangles = np.arange(len(corners)).reshape(-1, 3)
        mesh = Trimesh(corners, triangles, visual=visual, process=False)
        scene.add_geometry(mesh, node_name=part.name, geom_name=part.name)
    buffer = BytesIO()
    scene.export(buffer, file_type="glb", include_normals=True)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


def _cells(kernel: PrintedPart, normals: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " f"]:
    """The cell into which each triangle of the kernel looks: the one with that normal."""
    corners = kernel.corners
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return (cross @ normals.T).argmax(1)
