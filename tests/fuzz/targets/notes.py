"""What commands go on from: manifests, settings, tables of captures, proposals, rendered faces.

A content is some of the files of a folder; of the others there is a whole one.
"""

import json
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

from skylight.estimation._manifest import MANIFEST, Entry, append_entry, read_manifest
from skylight.faces._captures import CAPTURES_NAME, capture_hash, read_captures
from skylight.people._azimuth import FOLDER, choose
from skylight.people._files import read_scene_facts
from skylight.work._resumable import SETTINGS, keep_settings
from tests.fuzz.files import PLACE, joined, parted, read_by_any, written

_PHOTO = "anna.jpg"
_PROPOSAL = f"{FOLDER}/{_PHOTO}.json"
_SETTINGS: dict[str, object] = {"light": "sunsky", "rate": 30.0}
_READERS: dict[str, Callable[[Path], object]] = {
    CAPTURES_NAME: read_captures,
    _PROPOSAL: lambda folder: choose(folder, {_PHOTO: 1}),
    MANIFEST: lambda folder: read_manifest(folder / MANIFEST),
    SETTINGS: lambda folder: keep_settings(folder / SETTINGS, _SETTINGS),
    "face.json": read_scene_facts,
}


def seeds() -> list[bytes]:
    whole = _whole()
    return [*(joined({name: data}) for name, data in whole.items()), joined(whole)]


def read(content: bytes) -> None:
    folder, members = PLACE / "notes", parted(content)
    for name, data in _whole().items():
        (folder / name).write_bytes(members.get(name, data))
    named = [read for name, read in _READERS.items() if name in members]
    read_by_any(partial(read, folder) for read in named)


@cache
def _whole() -> dict[str, bytes]:
    folder = PLACE / "notes"
    (folder / FOLDER).mkdir(parents=True, exist_ok=True)
    for name in (_PHOTO, "noon.exr", f"{FOLDER}/{_PHOTO}.png"):
        (folder / name).touch()
    table = f"photo,probe,azimuth_deg,visible_sun,person\n{_PHOTO},noon.exr,,1,anna\n".encode()
    (folder / CAPTURES_NAME).write_bytes(table)
    (capture,) = read_captures(folder)
    named = capture_hash(folder, capture)
    proposal = {"hash": named, "azimuths_deg": [30.0, 60.0], "errors": [0.1, 0.2]}
    entry = Entry(source="a.jpg", sha256="0", settings="1", status="done", results="a_jpg")
    face = {"map": "noon.exr", "category": None, "turn_deg": 30.0}
    return {
        CAPTURES_NAME: table,
        _PROPOSAL: json.dumps(proposal).encode(),
        MANIFEST: written("manifest", lambda path: append_entry(path, entry)),
        SETTINGS: json.dumps(_SETTINGS).encode(),
        "face.json": json.dumps(face).encode(),
    }
