"""Scores of predicted environment maps: of one pair, or of two folders."""

import csv
import io
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch

from skylight._names import PLAIN_READING, Convention, MapReading
from skylight.errors import InputError
from skylight.inverse._scores import SCALE_FREE, Scores, score_maps
from skylight.io._atomic import atomic_path
from skylight.io._bounded import write_json
from skylight.io._files import read_environment_map, visible_files
from skylight.io._hdr import SUFFIXES
from skylight.work._progress import Progress

COMPARED_ROWS = 64  # of the thesis' probes; larger maps are averaged down to it
_COLUMNS = ("unaligned", "mean", "least_squares")


@dataclass(frozen=True, kw_only=True)
class ScoredMap:
    """One prediction's scores; ``upper_only`` where one of the two was a sky alone."""

    name: str
    scores: Scores
    sun_visible: bool
    upper_only: bool


def score_files(
    predicted: Path,
    true: Path,
    *,
    predicted_convention: Convention = "skylight",
    true_convention: Convention = "skylight",
    height: int | None = None,
    reading: MapReading = PLAIN_READING,
    name: str | None = None,
) -> ScoredMap:
    """Scores of one map, compared at ``height`` rows of the whole sphere.

    By default that is the truth's height, 64 at most. Where either file is an upper half only,
    the upper halves are compared, over a black lower half.

    Raises
    ------
    InputError
        Files that cannot be read or compared.
    """
    if height is not None and (height < 4 or height % 2):
        raise InputError(f"maps are compared at an even number of rows, 4 or more, not {height}")
    guess = read_environment_map(predicted, convention=predicted_convention, **vars(reading))
    truth = read_environment_map(true, convention=true_convention, **vars(reading))
    upper_only = guess.is_sky or truth.is_sky
    if upper_only:
        guess, truth = (m.with_ground(torch.zeros(3)) for m in (guess, truth))
    rows = height or min(COMPARED_ROWS, truth.layout[0])
    guess, truth = (m if m.layout[0] == rows else m.resize(rows) for m in (guess, truth))
    try:
        scores, sun_visible = score_maps(guess, truth)
    except InputError as error:
        raise InputError(f"{predicted} against {true}: {error}") from error
    return ScoredMap(
        name=name or predicted.name,
        scores=scores,
        sun_visible=sun_visible,
        upper_only=upper_only,
    )


def pair_folders(predicted: Path, true: Path) -> tuple[list[tuple[str, Path, Path]], list[str]]:
    """Maps of one name in both folders (by the path within, without ending), and who is alone.

    Of an .exr and an .hdr of one name the .exr is taken. A folder of an estimate's results stands
    for its probe.exr, named as the photo: ``a/me_jpg`` and ``a/me_light`` are ``a/me``.
    """
    guesses, truths = _maps(predicted), _maps(true)
    pairs = [(name, guesses[name], truths[name]) for name in sorted(guesses.keys() & truths.keys())]
    if not pairs:
        raise InputError(
            f"no .exr or .hdr map has the same name in {predicted} ({len(guesses)} maps) and "
            f"{true} ({len(truths)} maps)"
        )
    alone = [str(guesses[name]) for name in sorted(guesses.keys() - truths.keys())]
    alone += [str(truths[name]) for name in sorted(truths.keys() - guesses.keys())]
    return pairs, alone


def score_folders(
    pairs: list[tuple[str, Path, Path]],
    *,
    predicted_convention: Convention = "skylight",
    true_convention: Convention = "skylight",
    height: int | None = None,
    reading: MapReading = PLAIN_READING,
    progress: Progress = lambda share: None,
) -> list[ScoredMap]:
    """:func:`score_files` of every pair."""
    results = []
    for number, (name, guess, truth) in enumerate(pairs):
        progress(number / len(pairs))
        results.append(
            score_files(
                guess,
                truth,
                predicted_convention=predicted_convention,
                true_convention=true_convention,
                height=height,
                reading=reading,
                name=name,
            )
        )
    return results


def average(
    results: list[ScoredMap], statistic: Callable[[list[float]], float] = statistics.fmean
) -> Scores:
    """A statistic of each score over the maps that have it: overcast ones have none of the sun."""
    gathered: dict[str, dict[str, list[float]]] = {}
    for result in results:
        for metric, values in result.scores.items():
            for alignment, value in values.items():
                gathered.setdefault(metric, {}).setdefault(alignment, []).append(value)
    return {
        metric: {alignment: statistic(values) for alignment, values in kinds.items()}
        for metric, kinds in gathered.items()
    }


def table(scores: Scores) -> str:
    """A line for each metric, a column for each alignment."""
    lines = [f"{'':<20}{'unaligned':>12}{'equal means':>14}{'least squares':>15}"]
    for metric, values in scores.items():
        if SCALE_FREE in values:
            lines.append(f"{metric:<20}{values[SCALE_FREE]:>12.4f}{'(whatever the scale)':>29}")
        else:
            first, *more = (values[column] for column in _COLUMNS)
            lines.append(f"{metric:<20}{first:>12.4f}{more[0]:>14.4f}{more[1]:>15.4f}")
    return "\n".join(lines)


def write_scores(out: Path, result: ScoredMap) -> None:
    """The scores of one map as .json."""
    content = {
        "format": "skylight scores 1",
        "map": result.name,
        "sun_visible": result.sun_visible,
        "upper_half_only": result.upper_only,
        "scores": result.scores,
    }
    write_json(out, content)


def write_table(out: Path, results: list[ScoredMap]) -> None:
    """A .csv with a row for each map, and their mean, median and number at the end."""
    last = [("mean", average(results)), ("median", average(results, statistics.median)),
            ("count", average(results, lambda values: float(len(values))))]  # fmt: skip
    # "(mean)": no map within a folder has such a name
    rows = [{"map": result.name, **_flat(result.scores)} for result in results]
    rows += [{"map": f"({name})", **_flat(scores)} for name, scores in last]
    columns = list(dict.fromkeys(column for row in reversed(rows) for column in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    with atomic_path(out) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")


def _flat(scores: Scores) -> dict[str, float]:
    return {
        metric if alignment == SCALE_FREE else f"{metric}_{alignment}": value
        for metric, values in scores.items()
        for alignment, value in values.items()
    }


def _maps(folder: Path) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for path in visible_files(folder, SUFFIXES, recursive=True):
        inner = path.relative_to(folder)
        if len(inner.parts) > 1 and (path.parent / "estimate.json").is_file():
            if path.name != "probe.exr":
                continue  # the posterior, or the probe once more
            stem, _, _ = inner.parent.name.rpartition("_")
            name = inner.parent.with_name(stem or inner.parent.name).as_posix()
            if name in found:
                raise InputError(
                    f"{path} and {found[name]} have one name, {name}: score them one by one"
                )
            found[name] = path
        else:
            # sorted: .exr comes before .hdr
            found.setdefault(inner.with_suffix("").as_posix(), path)
    return found
