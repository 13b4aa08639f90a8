"""Cube maps as six files, in a folder or named by a pattern."""

import re
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._names import PLAIN_READING, MapReading
from skylight.errors import InputError
from skylight.io._files import read_light, visible_files, write_light
from skylight.io._hdr import check_suffix
from skylight.io._light import READ_SUFFIXES
from skylight.sphere._projections import FACES
from skylight.work._resumable import results_folder

# in the order of FACES; the first are written
NAMINGS = (
    FACES,
    ("posx", "negx", "posy", "negy", "posz", "negz"),
    ("right", "left", "top", "bottom", "front", "back"),
)
PLACE = "{}"  # of a pattern: where the face's name stands


def written_faces(out: Path) -> list[Path]:
    """The six files that ``out`` stands for, checked.

    A pattern, ``sky_{}.exr``, or a folder, which gets px.hdr to nz.hdr.
    """
    pattern = out if PLACE in out.name else out / f"{PLACE}.hdr"
    if pattern is not out and out.suffix:
        raise InputError(
            f"{out}: six faces are six files: name a folder, or a pattern such as "
            f"{out.stem}_{PLACE}{out.suffix}"
        )
    check_suffix(pattern)
    return [pattern.with_name(pattern.name.replace(PLACE, name)) for name in FACES]


def write_faces(
    out: Path, faces: Float[Tensor, "6 s s 3"], *, header: dict[str, object], half: bool = False
) -> list[Path]:
    """Write six faces: all of them, or none."""
    files = written_faces(out)
    with results_folder(files[0].parent) as folder:
        for face, file in zip(faces, files, strict=True):
            write_light(folder / file.name, face, header=header, half=half)
    return files


def read_faces(source: Path, reading: MapReading = PLAIN_READING) -> Float[Tensor, "6 s s 3"]:
    """Six faces of a folder or pattern, px to nz.

    Raises
    ------
    InputError
        Six files that are not there, more than one set of them, or faces that are not square and
        of one size.
    """
    faces = [read_light(file, **vars(reading)) for file in face_files(source)]
    size = faces[0].shape[0]
    for face, name in zip(faces, FACES, strict=True):
        if face.shape[:2] != (size, size):
            raise InputError(
                f"{source}: the faces of a cube are square and of one size, but {name} has "
                f"{face.shape[1]}x{face.shape[0]} pixels beside {size} rows of {FACES[0]}"
            )
    return torch.stack(faces)


def face_files(source: Path) -> list[Path]:
    """Those of a folder or pattern, px to nz; :class:`InputError` as :func:`read_faces`."""
    is_pattern = PLACE in source.name
    folder = source.parent if is_pattern else source
    if not folder.is_dir():
        raise InputError(
            f"{source}: six faces are read from a folder that holds them, or by a pattern such as "
            f"sky_{PLACE}.hdr"
        )
    sets: dict[tuple[str, ...], dict[str, Path]] = {}
    for file in visible_files(folder, READ_SUFFIXES):
        for naming in NAMINGS:
            for name in naming:
                before = _before(file, name, source.name if is_pattern else None)
                if before is not None:
                    sets.setdefault((*naming, before), {})[name] = file
    whole = [(list(key[:6]), found) for key, found in sets.items() if len(found) == 6]
    if not whole:
        named = "; ".join(", ".join(naming) for naming in NAMINGS)
        raise InputError(f"{source}: no six files named as the faces of a cube: {named}")
    if len(whole) > 1:
        raise InputError(
            f"{source}: several sets of six faces; say which by a pattern, as "
            f"{folder / PLACE}{whole[0][1][whole[0][0][0]].suffix}"
        )
    ((naming, found),) = whole
    return [found[name] for name in naming]


def _before(file: Path, name: str, pattern: str | None) -> str | None:
    """What a file's name has round that of a face, which stands alone or after a mark."""
    if pattern is not None:
        return pattern if file.name.lower() == pattern.replace(PLACE, name).lower() else None
    found = re.fullmatch(rf"((?:.*[^a-z0-9])?){name}", file.stem.lower())
    return None if found is None else found[1] + file.suffix.lower()
