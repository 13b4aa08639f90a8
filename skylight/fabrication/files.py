"""STL and 3MF files of parts, byte for byte reproducible."""

import zipfile
from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from skylight.errors import InputError
from skylight.fabrication.layout import BedLayout, lay_out
from skylight.fabrication.part import PrintedPart, merged
from skylight.io.atomic import atomic_path

_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_XML = '<?xml version="1.0" encoding="UTF-8"?>\n'
_CONTENT_TYPES = (
    f'{_XML}<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" '
    'ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" '
    'ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
)
_RELATIONSHIPS = (
    f'{_XML}<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Id="rel0" Target="/3D/3dmodel.model" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest that a zip file can name


def write_stl(path: Path, parts: Sequence[PrintedPart]) -> None:
    """All parts as one binary STL file. The format has no units; slicers take them for mm."""
    if not parts:
        raise InputError(f"{path}: there is no part to write")
    vertices, faces, _ = merged(parts)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    records = np.zeros(len(faces), _TRIANGLE)
    records["normal"], records["corners"] = normals, corners
    header = b"binary STL, millimetres".ljust(80)  # must not begin with "solid"
    with atomic_path(path) as temporary:
        temporary.write_bytes(header + np.uint32(len(faces)).tobytes() + records.tobytes())


def write_3mf(path: Path, parts: Sequence[PrintedPart]) -> None:
    """Each part as an object of its own, in millimetres (3MF core specification 1.3).

    https://github.com/3MFConsortium/spec_core
    """
    if not parts:
        raise InputError(f"{path}: there is no part to write")
    files = {
        "[Content_Types].xml": _CONTENT_TYPES,
        "_rels/.rels": _RELATIONSHIPS,
        "3D/3dmodel.model": _model(parts),
    }
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, text in files.items():
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3  # else it differs between operating systems
            archive.writestr(entry, text, compresslevel=9)


def write_printed_parts(folder: Path, bed: BedLayout, base: PrintedPart) -> None:
    """parts.stl and parts.3mf as on the bed, an .stl of each part alone, and the marker base."""
    for name, parts in (("parts", bed.parts), ("marker_base", lay_out([base]).parts)):
        write_stl(folder / f"{name}.stl", parts)
        write_3mf(folder / f"{name}.3mf", parts)
    for part in bed.parts:
        write_stl(folder / f"{part.name}.stl", lay_out([part]).parts)


def _model(parts: Sequence[PrintedPart]) -> str:
    lines = [f'{_XML}<model unit="millimeter" xml:lang="en-US" xmlns="{_CORE}"><resources>']
    for number, part in enumerate(parts, start=1):
        name = quoteattr(part.name)
        lines.append(f'<object id="{number}" name={name} type="model"><mesh><vertices>')
        # 1e-6 mm; + 0.0 turns -0 into 0
        rounded = (np.round(part.vertices, 6) + 0.0).tolist()
        lines += [f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in rounded]
        lines.append("</vertices><triangles>")
        lines += [f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in part.faces.tolist()]
        lines.append("</triangles></mesh></object>")
    lines.append("</resources><build>")
    lines += [f'<item objectid="{number}"/>' for number in range(1, len(parts) + 1)]
    lines.append("</build></model>")
    return "\n".join(lines)
