# SPDX-License-Identifier: GPL-3.0-or-later
"""What skylight is asked to do, and which versions of it can."""

import re
import shutil
from pathlib import Path

from .run import Failure, Step

COMPATIBLE = (0, 3), (0, 4)  # from the first on, below the second
EXPORTED = "blender"  # folder within an estimate's
KEYS = (
    ("left", "Left", "From the viewer's left, above"),
    ("right", "Right", "From the viewer's right, above"),
    ("top", "Top", "From above the camera"),
    ("rim", "Rim", "From behind the sitter"),
    ("front", "Front", "From the camera"),
)
SIZES_DEG, USUAL_DEG = (2.0, 120.0), 25.0  # of a key light
MOST_STRENGTH, USUAL_STRENGTH = 1000.0, 4.0  # key over fill
LIGHTS = (
    ("sphere", "Any Place", "Outdoors, rooms, studios, streets; uses what is behind the person"),
    ("autoencoder", "Outdoors", "A sky, sun or clouds, over a ground"),
    ("lamps", "Rooms and Nights", "Up to three lamps in soft light"),
    ("auto", "Sky or Lamps", "Whichever of both is likelier; takes half as long again"),
)


def find_skylight(chosen: str) -> str:
    """The program: ``chosen`` in the preferences, or that on PATH."""
    if chosen:
        if not Path(chosen).is_file():
            raise Failure(f"{chosen}: there is no such program: set the path in the preferences")
        return chosen
    found = shutil.which("skylight")
    if found is None:
        raise Failure(
            "skylight was not found: install it, or set its path in the extension's preferences"
        )
    return found


def check_version(printed: str) -> None:
    """Refuse what ``skylight --version`` says where this extension was not made for it."""
    first, below = COMPATIBLE
    found = re.match(r"skylight (\d{1,9})\.(\d{1,9})\b", printed)
    if found is None or not first <= (int(found[1]), int(found[2])) < below:
        wanted = " to below ".join(f"{major}.{minor}" for major, minor in COMPATIBLE)
        is_named = printed.startswith("skylight ")
        name = printed.split("\n")[0] if is_named else "this program is not skylight"
        raise Failure(f"{name}: this extension needs skylight {wanted}")


def estimate_steps(program: str, photo: Path, folder: Path, light: str) -> list[Step]:
    """Estimate the light of a photograph into a folder, and export it for Blender."""
    command = [program, "estimate", str(photo), "--out", str(folder), "--light", light]
    step = Step("starting", [*command, "--progress", "json"])
    check, export = export_steps(program, folder, photo)
    return [check, step, export]


def export_steps(program: str, folder: Path, photo: Path | None = None) -> list[Step]:
    """Export an estimate for Blender; ``photo`` where it is not where the estimate says."""
    command = [program, "export", "blender", str(folder), str(folder / EXPORTED)]
    if photo is not None:
        command += ["--photo", str(photo)]
    return [_asked_version(program), Step("exporting to Blender", command)]


def relight_steps(
    program: str, folder: Path, key: str, *, size_deg: float, strength: float
) -> list[Step]:
    """Relight the portrait of an estimate by a key light, into :func:`relit_picture`."""
    command = [program, "relight-portrait", str(folder), "--key", key, "--size", f"{size_deg:g}"]
    command += ["--strength", f"{strength:g}", "--out", str(relit_picture(folder, key))]
    return [_asked_version(program), Step("relighting the portrait", command)]


def relit_picture(folder: Path, key: str) -> Path:
    """Beside the estimate's files; the next one by the same key takes its place."""
    return folder / f"relit_{key}.png"


def _asked_version(program: str) -> Step:
    return Step("asking for the version", [program, "--version"], check_version)
