"""Folders of captured skies: checks, and an index."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from skylight.errors import InputError
from skylight.io.collection import names_categories, read_categories
from skylight.io.hdr import SUFFIXES, read_linear
from skylight.io.listing import visible_files
from skylight.skies.capture_dates import capture_of, read_days
from skylight.skies.index import INDEX_NAME, SkyRecord, is_index, read_rows, write_rows
from skylight.skies.layouts import FIELD_DEG, SQUARE, Layout, read_pixels, sky_of
from skylight.skies.sky_above import NO_SKY, why_no_sky
from skylight.skies.splits import divide
from skylight.skies.sun_in_map import PLATEAU_PIXELS, find_sun, plateau_size
from skylight.work.progress import CountProgress

LEAST_ROWS = 32  # of a sky, as many as the models' skies have


@dataclass(frozen=True, kw_only=True)
class Refusal:
    """A map that is not used, and why, in words; ``is_sky``: because of a fault of its file."""

    file: str
    reason: str
    is_sky: bool = True


def index_captures(
    folder: Path,
    *,
    layout: Layout | None = None,
    field_deg: float = FIELD_DEG,
    days: Path | None = None,
    all_maps: bool = False,
    progress: CountProgress | None = None,
) -> tuple[list[SkyRecord], list[Refusal]]:
    """Look at every .exr and .hdr map in ``folder`` and the folders in it; writes nothing.

    The records' files are relative to ``folder``, and their days not yet divided into splits.
    ``layout`` None tells it from each map's shape. ``days`` is a list for
    :func:`read_days`. ``sun_transmittance`` is 1 for a visible sun, else 0.

    Unless ``all_maps``, maps that show no sky are left out: those that an ``index.csv`` with the
    columns file and category calls indoor, studio or night, and those of :func:`why_no_sky`.

    Raises :class:`InputError` where there are no maps, the list names one that is not there, or
    an ``index.csv`` of the folder is damaged.
    """
    maps = visible_files(folder, SUFFIXES, recursive=True)
    files = sorted(path.relative_to(folder).as_posix() for path in maps)
    if not files:
        raise InputError(f"{folder}: no .exr or .hdr maps there to index")
    listed = read_days(days) if days else {}
    if absent := sorted(set(listed) - set(files)):
        raise InputError(f"{days}: lists {absent[0]}, which is not in {folder}; correct the list")
    categories = {} if all_maps else _categories(folder)
    records: list[SkyRecord] = []
    refusals: list[Refusal] = []
    for number, file in enumerate(files):
        if progress:
            progress(number, len(files))
        category = categories.get(file, "")
        if category.startswith(NO_SKY):
            reason = f"no sky above: {INDEX_NAME} calls it {category}"
            refusals.append(Refusal(file=file, reason=reason, is_sky=False))
            continue
        try:
            found = _look(folder, file, layout, field_deg)
            reason = None if all_maps else _no_sky(folder, found)
        except InputError as error:
            reason = str(error).removeprefix(f"{folder / file}: ")
            refusals.append(Refusal(file=file, reason=reason))
            continue
        if reason is not None:
            refusals.append(Refusal(file=file, reason=reason, is_sky=False))
            continue
        capture = capture_of(folder, file, listed)
        records.append(replace(found, day=capture.day, time=capture.time))
    return records, refusals


def index_folder(
    folder: Path,
    *,
    out: Path | None = None,
    layout: Layout | None = None,
    field_deg: float = FIELD_DEG,
    days: Path | None = None,
    tolerance: float | None = None,
    all_maps: bool = False,
    progress: CountProgress | None = None,
) -> tuple[Path, list[SkyRecord], list[Refusal]]:
    """Write an index of the usable maps of ``folder``; (the index, its records, what is refused).

    ``out`` is by default ``folder/index.csv``; in an index elsewhere the maps' paths are
    absolute. ``tolerance`` is that of :func:`divide`.

    Raises :class:`InputError` where no map can be used, and for an ``out`` that holds anything
    but an index of captured skies; that of a folder of simulated skies knows more than their
    maps show.
    """
    out = out or folder / INDEX_NAME
    if out.exists() and not is_index(out):
        raise InputError(
            f"{out}: is no index of skies of this version, and is not overwritten; write one "
            f"beside it with: skylight skies index {folder} --out {folder / 'skies.csv'}"
        )
    if out.exists() and any(record.seed is not None for record in read_rows(out)):
        raise InputError(
            f"{out}: indexes simulated skies, of which it knows more than their maps show; "
            "use it as it is, or name another file with --out"
        )
    records, refusals = index_captures(
        folder,
        layout=layout,
        field_deg=field_deg,
        days=days,
        all_maps=all_maps,
        progress=progress,
    )
    if not records:
        first = refusals[0]
        raise InputError(
            f"{folder}: none of its {len(refusals)} map(s) can be used; {first.file}: "
            f"{first.reason}"
        )
    if out.resolve().parent != folder.resolve():
        home = folder.resolve()
        records = [replace(r, file=(home / r.file).as_posix()) for r in records]
    records = divide(records, tolerance=tolerance)
    write_rows(out, records)
    return out, records, refusals


def _categories(folder: Path) -> dict[str, str]:
    """File -> category of a folder whose index names them; nothing where there is no such index."""
    if is_index(folder / INDEX_NAME) or not names_categories(folder):
        return {}
    return read_categories(folder)


def _no_sky(folder: Path, record: SkyRecord) -> str | None:
    if record.layout != "latlong":  # maps of a sky alone show nothing to compare it with
        return None
    radiance = torch.from_numpy(read_linear(folder / record.file))
    return why_no_sky(radiance, sun_is_visible=record.sun_transmittance > 0)


def _look(folder: Path, file: str, layout: Layout | None, field_deg: float) -> SkyRecord:
    """What a map shows, its capture not yet known; :class:`InputError` says why it is unusable."""
    layout, pixels = read_pixels(folder / file, layout, field_deg=field_deg)
    square = layout in SQUARE
    rows = pixels.shape[0] // (2 if square else 1)
    if rows < LEAST_ROWS:
        raise InputError(f"too small: {rows} rows from zenith to horizon, at least {LEAST_ROWS}")
    if not pixels.any():
        raise InputError("the sky is all black")
    plateau = plateau_size(pixels, wraps=not square)
    if plateau >= PLATEAU_PIXELS:
        raise InputError(
            f"clipped: {plateau} pixels at its brightest place are equally bright, so the light "
            "of the sun is cut off; merge exposures that are short enough"
        )
    sun = find_sun(sky_of(pixels, layout, field_deg=field_deg))
    return SkyRecord(
        file=file,
        day="",
        time="",
        regime="clear" if sun.visible else "overcast",
        sun_zenith_deg=math.degrees(sun.zenith_rad),
        map_azimuth_deg=math.degrees(sun.azimuth_rad),
        sun_transmittance=float(sun.visible),
        layout=layout,
        field_deg=field_deg if square else math.nan,
    )
