"""Files of printed parts: STL and 3MF, byte for byte reproducible, read back, and pictures.

The pictures show ambient occlusion, a lamp, and feature lines.
"""

import math
import zipfile
from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import torch
from jaxtyping import Float, UInt8

from skylight.errors import InputError
from skylight.imaging._colour import linear_to_srgb
from skylight.io._atomic import atomic_path
from skylight.probes.fabrication._parts import BedLayout, PrintedPart, lay_out, merged
from skylight.probes.fabrication._report import FileFigures
from skylight.probes.fabrication._watertight import broken_edges, by_place
from skylight.transport._rays import Raycaster

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
_FINE = 2  # rays along a pixel's side
_SKY_RAYS = 4  # per ray that hits
_SKY, _LAMP, _EDGE = 0.62, 0.5, 0.55
_MARGIN = 1.06


def write_stl(path: Path, parts: Sequence[PrintedPart]) -> None:
    """All parts as one binary STL file. The format has no units; slicers take them for mm."""
    if not parts:
        raise InputError(f"{path}: there is no part to write")
    vertices, faces, _ = merged(parts)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    records = np.zeros(len(faces), _TRIANGLE)
    # + 0.0 turns -0 into 0, which readers that compare bytes tell apart
    records["normal"], records["corners"] = normals, corners + 0.0
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


def read_stl(path: Path) -> PrintedPart:
    """A file of :func:`write_stl` as slicers read it, corners at one place taken for one vertex."""
    vertices, faces = by_place(np.frombuffer(path.read_bytes()[84:], _TRIANGLE)["corners"])
    return PrintedPart(name=path.name, vertices=vertices, faces=faces)


def write_printed_parts(folder: Path, bed: BedLayout, base: PrintedPart) -> list[FileFigures]:
    """parts.stl and parts.3mf as on the bed, an .stl of each part alone, and the marker base.

    Returns what the STL files hold, read back.

    Raises
    ------
    InputError
        One is not closed as slicers read it.
    """
    for name, parts in (("parts", bed.parts), ("marker_base", lay_out([base]).parts)):
        write_stl(folder / f"{name}.stl", parts)
        write_3mf(folder / f"{name}.3mf", parts)
    for part in bed.parts:
        write_stl(folder / f"{part.name}.stl", lay_out([part]).parts)
    found = [_file_figures(read_stl(path)) for path in sorted(folder.glob("*.stl"))]
    for file in found:
        if not file.watertight:
            raise InputError(
                f"{file.name} would not be closed as slicers read it, so nothing is written: "
                "choose sizes that differ a little, such as walls 0.05 mm thicker"
            )
    return found


def _file_figures(part: PrintedPart) -> FileFigures:
    return FileFigures(
        name=part.name,
        triangles=len(part.faces),
        watertight=not len(broken_edges(part.corners)) and part.solid() is not None,
        volume_mm3=part.volume_mm3,
    )


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


def shaded_picture(
    parts: Sequence[PrintedPart],
    colours: Float[np.ndarray, "n 3"],
    *,
    size: tuple[int, int],
    up: tuple[int, int, int],
    azimuth_rad: float = 0.6,
    elevation_rad: float = 0.5,
) -> UInt8[np.ndarray, "h w 3"]:
    """Parts on white, seen from far away (parallel rays); ``size`` is (height, width).

    ``colours`` are linear reflectances. The view turns about ``up``: azimuth 0 looks along the
    axis after next (-Z where +Y is up) and grows as the viewer goes to the right.
    """
    vertices, faces, owner = merged(parts)
    right, above, towards = _view(up, azimuth_rad, elevation_rad)
    caster = Raycaster(torch.from_numpy(vertices), torch.from_numpy(faces))
    height, width = (side * _FINE for side in size)
    across, along = vertices @ right, vertices @ above
    scale = _MARGIN * max(np.ptp(across) / width, np.ptp(along) / height)
    x = (np.arange(width) + 0.5 - width / 2) * scale + (across.min() + across.max()) / 2
    y = (height / 2 - np.arange(height) - 0.5) * scale + (along.min() + along.max()) / 2
    far = float((vertices @ towards).max()) + caster.diagonal / 10
    origins = (y[:, None, None] * above + x[None, :, None] * right + far * towards).reshape(-1, 3)
    hits = caster.intersect(torch.from_numpy(origins), torch.from_numpy(-towards)[None])
    face = hits.face.numpy()
    seen = np.flatnonzero(face >= 0)
    points = origins[seen] - hits.distance.numpy()[seen, None] * towards
    corners = vertices[faces[face[seen]]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    light = _light(caster, points, normals, right, above, towards)
    linear = np.ones((height * width, 3))
    linear[seen] = colours[owner[face[seen]]] * light[:, None]
    # lines where the part or the surface's direction changes from one ray to the next
    mark = np.zeros((height * width, 4))
    mark[seen] = np.concatenate([normals, 10.0 + owner[face[seen], None]], 1)
    linear[_breaks(mark.reshape(height, width, 4)).reshape(-1) & (face >= 0)] *= _EDGE
    picture = linear.reshape(size[0], _FINE, size[1], _FINE, 3).mean((1, 3))
    return (255 * linear_to_srgb(torch.from_numpy(picture.clip(0, 1)))).round().byte().numpy()


def _view(up: tuple[int, int, int], azimuth_rad: float, elevation_rad: float) -> np.ndarray:
    """Rows: right, above, towards the viewer."""
    vertical = np.array(up, float)
    front = np.roll(vertical, 1)  # +Z where +Y is up
    side = np.cross(vertical, front)
    level = math.cos(azimuth_rad) * front + math.sin(azimuth_rad) * side
    towards = math.cos(elevation_rad) * level + math.sin(elevation_rad) * vertical
    right = np.cross(vertical, level)
    return np.stack([right, np.cross(towards, right), towards])


def _light(
    caster: Raycaster,
    points: np.ndarray,
    normals: np.ndarray,
    right: np.ndarray,
    above: np.ndarray,
    towards: np.ndarray,
) -> np.ndarray:
    """Sky light that is not hidden, and a lamp at the viewer's upper left that casts shadows."""
    lifted = torch.from_numpy(points + 2 * caster.epsilon * normals)
    generator = np.random.default_rng(0)
    sky = np.zeros(len(points))
    for _ in range(_SKY_RAYS):
        # cosine-weighted: the normal and a point on the unit sphere
        ball = generator.normal(size=(len(points), 3))
        ball /= np.linalg.norm(ball, axis=1, keepdims=True)
        away = normals * (1 + 1e-6) + ball
        sky += ~caster.occluded(lifted, torch.from_numpy(away)).numpy()
    lamp = towards + 0.9 * above - 0.55 * right
    lamp /= np.linalg.norm(lamp)
    lit = ~caster.occluded(lifted, torch.from_numpy(lamp)[None]).numpy()
    return _SKY * sky / _SKY_RAYS + _LAMP * lit * (normals @ lamp).clip(0) + 0.03


def _breaks(mark: np.ndarray) -> np.ndarray:
    """Where the next ray to the right or below sees something else."""
    found = np.zeros(mark.shape[:2], bool)
    found[:, :-1] |= (np.abs(np.diff(mark, axis=1)) > 0.3).any(-1)
    found[:-1] |= (np.abs(np.diff(mark, axis=0)) > 0.3).any(-1)
    return found
