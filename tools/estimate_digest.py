"""Print the numbers of one estimate as JSON, so that two installations can be compared.

    OMP_NUM_THREADS=1 python tools/estimate_digest.py --light sh9 > one.json
    python tools/estimate_digest.py --light sh9 --against one.json --tolerance 1e-3

The photograph comes with scikit-image. With ``--against``, the exit code is 1 where a number
differs from the file's by more than the tolerance times the largest of its kind.
"""

import argparse
import json
import sys
from pathlib import Path

import torch
from skimage.data import astronaut

import skylight
from skylight._names import LIGHT_NAMES


def digest(light: str) -> dict[str, object]:
    """What the estimate of the photograph's face says; ``radiance`` is a map of 8 x 16 pixels."""
    found = skylight.estimate(astronaut()[:256, 100:356], light=light)
    small = found.environment.resize(8).radiance
    return {
        "version": skylight.__version__,
        "torch": torch.__version__,
        "threads": torch.get_num_threads(),
        "light": light,
        "sun_direction": found.sun_direction.tolist(),
        "albedo": found.albedo.tolist(),
        "residual": float(found.faces[0].residual),
        "radiance": small.flatten().tolist(),
    }


def largest_difference(a: dict[str, object], b: dict[str, object]) -> float:
    """max |a - b| / max |b| within each kind of number, the largest over the kinds."""
    worst = 0.0
    for name in ("sun_direction", "albedo", "residual", "radiance"):
        x, y = (torch.tensor(each[name], dtype=torch.float64) for each in (a, b))
        worst = max(worst, float((x - y).abs().max() / y.abs().max()))
    return worst


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--light", choices=LIGHT_NAMES, default="sh9")
    parser.add_argument("--against", type=Path)
    parser.add_argument("--tolerance", type=float, default=1e-3)
    options = parser.parse_args()
    found = digest(options.light)
    print(json.dumps(found, indent=2))
    if options.against:
        other = json.loads(options.against.read_text(encoding="utf-8"))
        difference = largest_difference(found, other)
        print(f"largest relative difference: {difference:.3g}", file=sys.stderr)
        sys.exit(not difference <= options.tolerance)


if __name__ == "__main__":
    main()
