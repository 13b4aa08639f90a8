"""Environment maps exported for other programs."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from skylight.app.maps.estimated_light import read_light
from skylight.errors import InputError
from skylight.relight.lamp_lights import without_lamps
from skylight.relight.light_files.augmented_reality import write_augmented_reality
from skylight.relight.light_files.blender import write_blender
from skylight.relight.light_files.gltf import write_gltf
from skylight.relight.light_files.harmonics import write_harmonics
from skylight.relight.light_files.mitsuba import write_mitsuba
from skylight.relight.light_files.threejs import write_threejs
from skylight.relight.light_files.usd import write_usd
from skylight.relight.prefilter import LAST_SIZE
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.frame import Convention
from skylight.sphere.harmonic_conventions import HarmonicConvention
from skylight.work.results_folder import results_folder

LightTarget = Literal["threejs", "sh", "ar", "gltf", "usd", "mitsuba", "blender"]
WHOLE = {"sh", "ar"}  # targets that have no lights of an artist's own to move
LARGEST_FACE = 2048


@dataclass(frozen=True, kw_only=True)
class ExportedLight:
    """What was written: ``cut`` is the share of the light that light.glb's reflections lack.

    ``lamps`` is how many became lights of their own.
    """

    files: list[str]
    lamps: int
    cut: float


def export_light(
    probe: Path,
    out: Path,
    targets: Sequence[LightTarget],
    *,
    convention: Convention = "skylight",
    harmonics: HarmonicConvention = "skylight",
    face: int | None = None,
) -> ExportedLight:
    """Write the files of each target into the folder ``out``.

    ``probe`` is a map, or an estimate's folder or estimate.json: its lamps are lights of their own
    of all targets but "sh" and "ar", beside the rest of its map.

    ``face`` is the side of a cube map's faces, a power of two from 32; by default the largest that
    shows no more detail than the map's horizon, from 64 to 512. A sky alone gets a black lower
    half.

    Raises
    ------
    InputError
        A map or estimate that cannot be read, no target, or a face size that cannot be.
    """
    if not targets:
        raise InputError("name at least one target with --as")
    if face is not None and (face & (face - 1) or not 2 * LAST_SIZE <= face <= LARGEST_FACE):
        raise InputError(
            f"a cube map's faces are a power of two from {2 * LAST_SIZE} to {LARGEST_FACE} pixels "
            f"wide, not {face}"
        )
    light, lamps = read_light(probe, convention)
    separate = lamps if set(targets) - WHOLE else ()
    rest = without_lamps(light, separate)
    size = face or default_face(light)
    written: list[str] = []
    cut = 0.0
    with results_folder(out) as folder:
        for target in dict.fromkeys(targets):
            if target == "threejs":
                written += write_threejs(folder, rest, lamps)
            elif target == "sh":
                written += write_harmonics(folder, light, harmonics)
            elif target == "ar":
                written += write_augmented_reality(folder, light, size)
            elif target == "gltf":
                files, cut = write_gltf(folder, rest, size, lamps)
                written += files
            elif target == "usd":
                written += write_usd(folder, rest, lamps)
            elif target == "mitsuba":
                written += write_mitsuba(folder, rest, lamps)
            else:
                written += write_blender(folder, rest, lamps)
    return ExportedLight(files=written, lamps=len(separate), cut=cut)


def default_face(light: EnvironmentMap) -> int:
    """A quarter of the horizon's pixels, rounded up to a power of two between 64 and 512."""
    quarter = light.layout[1] // 4
    return min(512, max(64, 1 << (quarter - 1).bit_length()))
