"""The commands ``convert``, ``score``, ``code`` and ``decode``: environment maps as files."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import Positional

from skylight._names import PLAIN_READING, Convention, MapLayout, MapReading, Sign
from skylight.errors import InputError
from skylight.work._device import Device

# listed once, in the command's own text
_PROJECTION = tyro.conf.arg(metavar="PROJECTION")


def convert(
    source: Annotated[Positional[Path], tyro.conf.arg(name="in")],
    out: Positional[Path],
    to: Annotated[MapLayout, _PROJECTION] = "latlong",
    convention: Convention = "skylight",
    from_: Annotated[MapLayout, _PROJECTION, tyro.conf.arg(name="from")] = "latlong",
    from_convention: Convention = "skylight",
    height: int | None = None,
    rotate: float = 0.0,
    pitch: float = 0.0,
    roll: float = 0.0,
    scale: float = 1.0,
    ev: float = 0.0,
    half: bool = False,
    preview: Path | None = None,
    reading: Annotated[MapReading, tyro.conf.OmitArgPrefixes] = PLAIN_READING,
) -> None:
    """Write a map of light in another projection, turned or brighter, or as a program turns it.

    A PROJECTION is latlong, octahedral (the zenith in the centre), angular (Debevec's, forwards in
    the centre), mirrorball (what such a ball shows a camera far away), or the faces of a cube:

    cube: a lying cross, 4:3; one that stands, 3:4, is read too.

    cube-vertical: a standing cross.

    cube-row, cube-column: a strip.

    cube-faces: a file each, in a folder (px.hdr, nx.hdr ... are written; posx ... and right, left,
    top, bottom, front, back are read too) or by a pattern such as sky_{}.exr.

    Conventions say where the columns of a lat-long map look.

    Args:
        source: The map to read: .exr, .hdr, .pic, or a .tif of float samples. Colours that it
            declares are converted to linear Rec.709.
        out: The file to write: .exr or .hdr.
        to: Projection of the file to write.
        convention: Which program's way of turning lat-long maps to write.
        from_: Projection of the map to read.
        from_convention: Which program's way of turning lat-long maps it has.
        height: Rows to write; by default about as many as keep the detail.
        rotate: Turn the light about the vertical by so many degrees; positive ones move what is
            ahead to the right.
        pitch: Turn what is ahead up by so many degrees, before --rotate. Resamples the map.
        roll: Turn the light clockwise about what is ahead, before --pitch. Resamples the map.
        scale: Multiply radiance by this.
        ev: Brighten by so many stops: radiance times 2 to that.
        half: Write an .exr in half precision.
        preview: Also write this .png, which shows what was written.
        reading: How the map is read.
    """
    from skylight.maps._convert import Adjustment, convert_file

    if not -60 <= ev <= 60:
        raise InputError(f"--ev takes stops from -60 to 60, not {ev:g}")
    rows, columns = convert_file(
        source,
        out,
        projection=to,
        convention=convention,
        source_projection=from_,
        source_convention=from_convention,
        adjustment=Adjustment(
            rotate_deg=rotate, pitch_deg=pitch, roll_deg=roll, factor=scale * 2**ev
        ),
        height=height,
        half=half,
        preview_file=preview,
        reading=reading,
    )
    each = "six files, each " if to == "cube-faces" else ""
    print(f"{out}: {to}, {each}{columns} x {rows} pixels")


def score(
    predicted: Positional[Path],
    true: Positional[Path],
    out: Path | None = None,
    predicted_convention: Convention = "skylight",
    true_convention: Convention = "skylight",
    height: int | None = None,
    reading: Annotated[MapReading, tyro.conf.OmitArgPrefixes] = PLAIN_READING,
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
        reading: How the maps are read.
    """
    from skylight.io._atomic import require_place
    from skylight.maps._score import (
        average,
        pair_folders,
        score_files,
        score_folders,
        table,
        write_scores,
        write_table,
    )
    from skylight.work._progress import stage_bar

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
            reading=reading,
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
            reading=reading,
            progress=lambda share: progress("scoring", share),
        )
    if alone:
        print(f"skylight: left out, in one folder only: {', '.join(alone)}", file=sys.stderr)
    print(f"mean of {len(results)} maps")
    print(table(average(results)))
    if out is not None:
        write_table(out, results)


def code_probe(
    probe: Positional[Path],
    out: Path,
    dictionary: str = "ani",
    activations: int = 64,
    weights: Sign = "l1",
    height: Literal[32, 64, 128] | None = None,
    device: Device = "auto",
    reading: Annotated[MapReading, tyro.conf.OmitArgPrefixes] = PLAIN_READING,
) -> None:
    """Write a map of light as a sparse code: a few lobes, their directions and colours.

    Beside the code, OUT with the ending .png shows the map, the decoded map and the lobes.

    Args:
        probe: .exr or .hdr lat-long map of the whole sphere (width 2 heights).
        out: The .json file.
        dictionary: Anisotropic Gaussians (ani), the same and boxes of pixels (box), isotropic ones
            (iso), equal lobes (vmf), or the file of a learnt dictionary.
        activations: Most lobes to use; a simple map gets fewer.
        weights: Of either sign with a weak L1 norm, none below 0, or plain least squares.
        height: Rows to average the map down to; by default its own, 128 at most.
        device: Where the search runs; auto is CUDA where there is one.
        reading: How the map is read.
    """
    from skylight.maps._sparse_codes import check_code_name, code_map, summarise_code, write_code
    from skylight.work._progress import stage_bar
    from skylight.work._resumable import results_folder

    check_code_name(out)
    with stage_bar() as progress, results_folder(out.parent) as folder:
        coded = code_map(
            probe,
            dictionary=dictionary,
            activations=activations,
            weights=weights,
            height=height,
            device=device,
            reading=reading,
            progress=progress,
        )
        progress("writing the results", 0.0)
        write_code(folder, out.name, coded, title=probe.name)
    print(summarise_code(coded))
    print(f"written: {out} and {out.with_suffix('.png').name}")


def decode_code(
    code: Positional[Path],
    out: Path,
    height: int | None = None,
    dictionary: Path | None = None,
) -> None:
    """Write the map of a sparse code; what is below zero there is cut off.

    Args:
        code: .json file that `skylight code` wrote.
        out: The map to write: .exr or .hdr.
        height: Rows of the map; by default those of the map that was coded.
        dictionary: File of the learnt dictionary with which the code was made.
    """
    from skylight.maps._sparse_codes import decode_file

    share = decode_file(code, out, height=height, dictionary=dictionary)
    print(f"{out}: {100 * share:.2g} % of the energy cut off below zero")
