"""Check the manifest of Blender's extension and pack it: dist/world_from_portrait-VERSION.zip.

    python tools/build_blender_extension.py [--out dist]

What is checked is what Blender's ``extension validate`` asks of a manifest ("Extensions", Blender
manual), as far as this one uses it; tests give the result to that very command where the module bpy
is installed. The same sources make the same bytes.
"""

import argparse
import re
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "blender" / "world_from_portrait"
MANIFEST = "blender_manifest.toml"
TEXTS = ("name", "tagline", "maintainer")
VERSIONS = ("schema_version", "version", "blender_version_min")
REQUIRED = (*TEXTS, *VERSIONS, "id", "type", "license")
OPTIONAL = ("tags", "permissions", "website", "copyright")
LONGEST = 64  # of a tagline, and of the reason for a permission
PERMISSIONS = {"files", "network", "clipboard", "camera", "microphone"}
EARLIEST = (1980, 1, 1, 0, 0, 0)  # that a zip can tell


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    out: Path = parser.parse_args().out
    manifest = tomllib.loads((SOURCE / MANIFEST).read_text(encoding="utf-8"))
    found = list(faults(manifest))
    for fault in found:
        print(f"{SOURCE / MANIFEST}: {fault}", file=sys.stderr)
    if found:
        return 2
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{manifest['id']}-{manifest['version']}.zip"
    pack(path)
    print(path)
    return 0


def faults(manifest: dict[str, Any]) -> Iterator[str]:
    """A line for each thing that Blender would refuse."""
    for name in REQUIRED:
        if name not in manifest:
            yield f'"{name}" is missing'
    for name in sorted(manifest.keys() - {*REQUIRED, *OPTIONAL}):
        yield f'"{name}" is not known'
    for name in TEXTS:
        text = manifest.get(name, name)
        if not isinstance(text, str) or not text.isprintable() or text != text.strip() or not text:
            yield f'"{name}" must be a line of text'
    if manifest.get("schema_version", "1.0.0") != "1.0.0":
        yield '"schema_version" must be 1.0.0'
    for name in VERSIONS:
        if not re.fullmatch(r"(0|[1-9]\d*)(\.(0|[1-9]\d*)){2}", str(manifest.get(name, "0.0.0"))):
            yield f'"{name}" must be three numbers with dots between'
    name = str(manifest.get("id", "id"))
    if not name.isidentifier() or "__" in name or name != name.strip("_"):
        yield '"id" must be a name in Python, without underscores that are double or at an end'
    if manifest.get("type", "add-on") != "add-on":
        yield '"type" must be add-on'
    licences = manifest.get("license", ["SPDX:"])
    if not licences or not all(str(each).startswith("SPDX:") for each in licences):
        yield '"license" must be a list of SPDX: and an identifier each'
    permissions = manifest.get("permissions", {})
    for name in sorted(permissions.keys() - PERMISSIONS):
        yield f'permission "{name}" is not known'
    short = {"tagline": manifest.get("tagline", "x"), **permissions}
    for name, text in short.items():
        if len(text) > LONGEST or not text[-1:].isalnum():
            yield f'"{name}" must have {LONGEST} letters at most, the last one no full stop'


def pack(path: Path) -> None:
    """Every file of the extension but what Python compiled."""
    files = [file for file in sorted(SOURCE.rglob("*")) if file.is_file()]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in files:
            if "__pycache__" not in file.parts:
                name = file.relative_to(SOURCE).as_posix()
                info = zipfile.ZipInfo(name, EARLIEST)
                info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
                archive.writestr(info, file.read_bytes())


if __name__ == "__main__":
    raise SystemExit(main())
