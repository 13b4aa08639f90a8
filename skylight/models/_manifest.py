"""``bundle.json`` of a light model's folder, :mod:`skylight.models._bundle`, read without torch."""

from dataclasses import asdict, dataclass
from pathlib import Path

from skylight.errors import InputError
from skylight.io._bounded import read_object, read_whole, require_keys

MANIFEST = "bundle.json"
KIND, VERSION = "light model", 1
MAKE_ONE = "make one with: skylight train FOLDER --out DIR"


@dataclass(frozen=True, kw_only=True)
class BundleManifest:
    """What a :class:`~skylight.models._bundle.LightBundle` is, but for its tensors."""

    name: str
    skies: int
    data_sha256: str
    fingerprint: str

    def entries(self) -> dict[str, object]:
        """The content of the file."""
        return {"kind": KIND, "version": VERSION, **asdict(self)}


def read_manifest(folder: Path) -> BundleManifest:
    """The manifest of a light model's folder."""
    path = folder / MANIFEST
    if not path.is_file():
        kind = f"no light model, it has no {MANIFEST}" if folder.is_dir() else "no folder is there"
        raise InputError(f"{folder}: {kind}; {MAKE_ONE}")
    try:
        entries = read_object(path, KIND)
        require_keys(path, entries, ["version"])
        version = read_whole(entries, "version")
    except InputError as error:
        raise InputError(f"{folder}: {error}; {MAKE_ONE}") from error
    if version > VERSION:
        raise InputError(
            f"{folder}: of format {version}, but this skylight reads formats up to {VERSION}; "
            "upgrade skylight"
        )
    try:
        require_keys(path, entries, ["name", "skies", "data_sha256", "fingerprint"])
        skies = read_whole(entries, "skies")
    except InputError as error:
        raise InputError(f"{folder}: {error}; {MAKE_ONE}") from error
    return BundleManifest(
        name=str(entries["name"]),
        skies=skies,
        data_sha256=str(entries["data_sha256"]),
        fingerprint=str(entries["fingerprint"]),
    )
