"""Light probes, meshes and lists of photographs in the data folder of an evaluation."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from skylight.errors import InputError
from skylight.io.bounded import json_content
from skylight.io.collection import INDEX_NAME
from skylight.io.listing import visible_files
from skylight.transport.mesh import MESH_SUFFIXES


def probes_folder(data: Path) -> Path:
    """``data/hdr`` where it has an index of maps, else ``data`` itself.

    Raises
    ------
    InputError
        Neither has one.
    """
    for folder in (data / "hdr", data):
        if (folder / INDEX_NAME).is_file():
            return folder
    raise InputError(
        f"{data}: no {INDEX_NAME} in it or in its folder hdr; it lists light probes (.exr, .hdr) "
        "in the columns file and category"
    )


def mesh_files(data: Path, usual: Sequence[str]) -> list[Path]:
    """As many meshes as are ``usual``, at least one: those where they are, others in their place.

    They are in ``data/meshes``, or in ``meshes`` beside ``data``.

    Raises
    ------
    InputError
        There is no mesh.
    """
    data = data.resolve()
    for folder in (data / "meshes", data.parent / "meshes"):
        found = visible_files(folder, MESH_SUFFIXES) if folder.is_dir() else []
        if found:
            here = {path.name: path for path in found}
            others = [path for path in found if path.name not in usual]
            return [*(here[name] for name in usual if name in here), *others][: len(usual)]
    raise InputError(
        f"{data}: no mesh in its folder meshes; put one or more there ({', '.join(MESH_SUFFIXES)})"
    )


def read_index(path: Path) -> Any:
    """What a JSON file about a folder's photographs holds.

    Raises
    ------
    InputError
        It cannot be read, or is not JSON.
    """
    try:
        return json_content(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise InputError(f"{path}: not JSON ({error})") from error
