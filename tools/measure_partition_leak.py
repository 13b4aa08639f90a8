"""What the faces of printed partition probes see of other cells, by the sizes they are printed to.

Of kernels of 8 mm in shells of several sizes, with plain walls and with flared ones; and of all
named designs with the sizes that ``skylight probe partitions print`` chooses::

    python -m tools.measure_partition_leak --figure docs/images/partition_leak.png
"""

import argparse
import time
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from skylight._figures import ACCENT, INK, STYLE, save
from skylight.probes.fabrication._mount import Pole
from skylight.probes.partitions._optimise import design_names, named_design
from skylight.probes.partitions.printed._assembly import AskedSizes
from skylight.probes.partitions.printed._printing import (
    PrintedPartitions,
    print_fitted,
    print_partition_probe,
)
from skylight.probes.partitions.printed._solids import ProbeSizes
from tools.measured import write_measured

_SWEPT = ("6d", "14d", "38d")
_KERNEL_MM = 8.0
_OUTERS_MM = (60.0, 80.0, 120.0, 160.0)
_PLAIN, _FLARED = 0.0, 1.0
_POLE = Pole(length_mm=450.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--figure", type=Path, default=None)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/partition-leak.json"))
    arguments = parser.parse_args()
    begun = time.time()
    swept = {design: {flare: _sweep(design, flare) for flare in (_PLAIN, _FLARED)}
             for design in _SWEPT}  # fmt: skip
    facts: dict[str, Any] = {
        f"{design} {'flared' if flare else 'plain'} {outer:g} mm": leak
        for design, found in swept.items()
        for flare, leaks in found.items()
        for outer, leak in zip(_OUTERS_MM, leaks, strict=True)
    }
    for design in design_names():
        facts |= _chosen(design, print_fitted(named_design(design), AskedSizes(), pole=_POLE))
    write_measured(
        arguments.out,
        name="partition-leak",
        what="what a face gathers from other cells, over what it should gather from its own: of "
        "kernels of 8 mm in shells of several sizes, and of all named designs with the sizes that "
        "are chosen for them",
        command="python -m tools.measure_partition_leak --figure docs/images/partition_leak.png",
        begun=begun,
        facts=facts,
    )
    if arguments.figure is not None:
        _draw(arguments.figure, swept)


def _sweep(design: str, flare: float) -> list[float]:
    return [
        float(
            print_partition_probe(
                named_design(design),
                ProbeSizes(outer_mm=outer, kernel_mm=_KERNEL_MM, flare=flare),
                pole=_POLE,
            ).visibility.leak.mean()
        )
        for outer in _OUTERS_MM
    ]


def _chosen(design: str, result: PrintedPartitions) -> dict[str, Any]:
    sizes, seen = result.sizes, result.visibility
    return {
        f"{design} chosen outer mm": sizes.outer_mm,
        f"{design} chosen kernel mm": sizes.kernel_mm,
        f"{design} chosen wall mm": sizes.wall_mm,
        f"{design} chosen flare": sizes.flare,
        f"{design} chosen least disc mm": 2 * float(result.face_radii_mm.min()),
        f"{design} chosen leak": float(seen.leak.mean()),
        f"{design} chosen leak max": float(seen.leak.max()),
        f"{design} chosen loss": float(seen.loss.mean()),
        f"{design} chosen sound": result.report.sound,
    }


def _draw(path: Path, swept: dict[str, dict[float, list[float]]]) -> None:
    with rc_context(STYLE):
        figure = Figure(figsize=(10.5, 3.4), dpi=100, facecolor="white")
        panels = figure.subplots(1, len(swept), sharey=True)
        for axes, (design, found) in zip(panels, swept.items(), strict=True):
            ratio = [outer / 2 / _KERNEL_MM for outer in _OUTERS_MM]
            for flare, colour, name in ((_PLAIN, INK, "plain walls"), (_FLARED, ACCENT, "flared")):
                percent = [100 * leak for leak in found[flare]]
                axes.plot(ratio, percent, "o-", color=colour, label=name)
            axes.set_title(design.upper())
            axes.set_xlabel("radius of the shell / of the kernel")
        panels[0].set_ylim(bottom=0)
        panels[0].set_ylabel("light of other cells, %")
        panels[-1].legend(frameon=False)
        figure.tight_layout()
        save(figure, path)


if __name__ == "__main__":
    main()
