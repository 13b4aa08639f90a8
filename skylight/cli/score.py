"""``skylight score``: predicted against true environment maps."""

import sys
from pathlib import Path

from tyro.conf import Positional

from skylight.cli.convert import Convention
from skylight.errors import InputError


def score(
    predicted: Positional[Path],
    true: Positional[Path],
    out: Path | None = None,
    predicted_convention: Convention = "skylight",
    true_convention: Convention = "skylight",
    height: int | None = None,
) -> None:
    """Score predicted light against the truth: each metric unaligned and with its scale aligned.

    Of two folders, maps of the same name are compared, and means and medians added. docs/scores.md
    has the formulas: a shaded scene, the maps' errors by solid angle, the sun's angle, and three
    spheres (mirror, matte silver, matte diffuse).

    Args:
        predicted: .exr or .hdr lat-long map of the sphere or of the sky, or a folder of them.
        true: The truth, of the same kind.
        out: File for the scores: .json for one map, .csv for folders; by default they are printed
            only.
        predicted_convention: Which program's way of turning lat-long maps the prediction has.
        true_convention: The same for the truth.
        height: Rows at which maps are compared; by default the truth's, 64 at most.
    """
    from skylight.app.maps.score import (
        average,
        pair_folders,
        score_files,
        score_folders,
        table,
        write_scores,
        write_table,
    )
    from skylight.app.progress import stage_bar
    from skylight.io.atomic import require_place

    if predicted.is_dir() != true.is_dir():
        raise InputError("give two maps or two folders, not one of each")
    if out is not None:
        ending = ".csv" if predicted.is_dir() else ".json"
        if out.suffix.lower() != ending:
            raise InputError(f"{out}: choose a name that ends in {ending}")
        require_place(out)
    if not predicted.is_dir():
        result = score_files(
            predicted,
            true,
            predicted_convention=predicted_convention,
            true_convention=true_convention,
            height=height,
        )
        if result.upper_only:
            print("skylight: upper halves compared: one map has no other", file=sys.stderr)
        print(table(result.scores))
        if out is not None:
            write_scores(out, result)
        return
    pairs, alone = pair_folders(predicted, true)
    with stage_bar() as progress:
        results = score_folders(
            pairs,
            predicted_convention=predicted_convention,
            true_convention=true_convention,
            height=height,
            progress=lambda share: progress("scoring", share),
        )
    if alone:
        print(f"skylight: left out, in one folder only: {', '.join(alone)}", file=sys.stderr)
    print(f"mean of {len(results)} maps")
    print(table(average(results)))
    if out is not None:
        write_table(out, results)
