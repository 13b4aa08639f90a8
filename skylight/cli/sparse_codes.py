"""``skylight code`` and ``decode``: environment maps as sparse codes, and back."""

from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from skylight.work.device import Device

CodeWeights = Literal["l1", "nonnegative", "free"]  # a test compares it with the coder's own


def code_probe(
    probe: Positional[Path],
    out: Path,
    dictionary: str = "ani",
    activations: int = 64,
    weights: CodeWeights = "l1",
    height: Literal[32, 64, 128] | None = None,
    device: Device = "auto",
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
    """
    from skylight.app.codes.sparse_codes import (
        check_code_name,
        code_map,
        summarise_code,
        write_code,
    )
    from skylight.app.progress import stage_bar
    from skylight.work.results_folder import results_folder

    check_code_name(out)
    with stage_bar() as progress, results_folder(out.parent) as folder:
        coded = code_map(
            probe,
            dictionary=dictionary,
            activations=activations,
            weights=weights,
            height=height,
            device=device,
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
    from skylight.app.codes.sparse_codes import decode_file

    share = decode_file(code, out, height=height, dictionary=dictionary)
    print(f"{out}: {100 * share:.2g} % of the energy cut off below zero")
