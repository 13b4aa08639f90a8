"""``bundle.json`` of a light model's folder, :mod:`skylight.models._bundle`, read without torch."""

from dataclasses import asdict, dataclass
from pathlib import Path

from skylight.errors import InputError
from skylight.io._bounded import read_object, read_whole, require_keys

MANIFEST = "bundle.json"
PLACES = "sphere.safetensors"  # alone in the folder of a model of places
KIND, VERSION = "light model", 2
MAKE_ONE = "make one with: skylight train FOLDER --out DIR"


@dataclass(frozen=True, kw_only=True)
class BundleManifest:
    """What a :class:`~skylight.models._bundle.LightBundle` is, but for its tensors.

    ``network`` names the class of a network that is not skylight's; such a file is of version 2.
    """

    name: str
    skies: int
    data_sha256: str
    fingerprint: str
    network: str | None = None

    def entries(self) -> dict[str, object]:
        """The content of the file."""
        entries = asdict(self)
        if self.network is None:
            del entries["network"]
        return {"kind": KIND, "version": VERSION if self.network else 1, **entries}


def places_file(model: Path) -> Path | None:
    """The file of a model of places: that file itself, or the one in its folder."""
    if model.name == PLACES:
        return model
    return model / PLACES if (model / PLACES).is_file() else None


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
        network = entries.get("network")
        if not (network is None or (isinstance(network, str) and network.isprintable())):
            raise InputError(f"{path}: network names no class")
    except InputError as error:
        raise InputError(f"{folder}: {error}; {MAKE_ONE}") from error
    return BundleManifest(
        name=str(entries["name"]),
        skies=skies,
        data_sha256=str(entries["data_sha256"]),
        fingerprint=str(entries["fingerprint"]),
        network=network,
    )
