"""Throughput and memory of batch estimates over workers, or over photos solved together.

    python -m tools.measure_batch PHOTOS --workers 1 2
    python -m tools.measure_batch PHOTOS --workers 2 --device cuda --batch 1 16

Runs ``skylight estimate`` on the first pictures of a folder as a user would, so that the time
takes in starting the workers and loading the models. ``seconds_of_a_photo`` is the median within
a worker, from the manifest; ``largest_process_mb`` the resident memory of the largest process of
all runs; ``sun_off_deg_...`` how far suns are from those of the first run. Nothing else should run
on the machine.
"""

import argparse
import math
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import torch
from torch import Tensor

from skylight.estimate._manifest import MANIFEST, list_photos, read_manifest
from skylight.models._names import DEFAULT_LIGHT
from skylight.sphere._frame import angle_between, direction_from_angles
from tools.measured import write_measured


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("photos", type=Path)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    parser.add_argument("--batch", type=int, nargs="+", default=[1], help="solved together")
    parser.add_argument("--count", type=int, default=12, help="photos")
    parser.add_argument("--light", default=DEFAULT_LIGHT)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/batch.json"))
    arguments = parser.parse_args()
    runs = [(workers, batch) for batch in arguments.batch for workers in arguments.workers]
    if len(runs) < 2 or len(set(runs)) < len(runs):
        parser.error("--workers or --batch takes two different numbers or more")
    begun = time.time()
    facts: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as temporary:
        photos = Path(temporary) / "photos"
        photos.mkdir()
        for source in list_photos(arguments.photos, Path(temporary))[: arguments.count]:
            shutil.copy(arguments.photos / source, photos / source.replace("/", "_"))
        suns: list[dict[str, Tensor]] = []
        for workers, batch in runs:
            out = Path(temporary) / f"out{workers}_{batch}"
            options = ["--workers", str(workers), "--batch", str(batch), "--light", arguments.light]
            found = measure(photos, out, [*options, "--device", arguments.device])
            suns.append(suns_of(out))
            if len(suns) > 1:
                found |= apart(suns[0], suns[-1])
            facts |= {f"{_named(workers, batch)}_{name}": value for name, value in found.items()}
        count = len(list(photos.iterdir()))
    first, last = (_named(*runs[k]) for k in (0, -1))
    facts[f"{last}_to_{first}"] = facts[f"{last}_per_minute"] / facts[f"{first}_per_minute"]
    # kilobytes on Linux
    largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    facts["largest_process_mb"] = largest
    workers, batches = (" ".join(map(str, each)) for each in (arguments.workers, arguments.batch))
    write_measured(
        arguments.out,
        name=arguments.out.stem,
        what=f"{count} photos, light {arguments.light}, on {arguments.device}, by so many workers "
        "of one thread, so many solved together",
        command=f"python -m tools.measure_batch {arguments.photos.name} --workers {workers} "
        f"--device {arguments.device} --batch {batches} --count {arguments.count} "
        f"--light {arguments.light}",
        begun=begun,
        facts=facts,
    )


def _named(workers: int, batch: int) -> str:
    return f"{workers}_workers" + (f"_batch_{batch}" if batch > 1 else "")


def suns_of(out: Path) -> dict[str, Tensor]:
    """Where each photo's sun is, as a direction."""
    return {
        source: direction_from_angles(
            torch.tensor(math.radians(entry.sun["azimuth_deg"])),
            torch.tensor(math.radians(entry.sun["zenith_deg"])),
        )
        for source, entry in read_manifest(out / MANIFEST).items()
        if entry.sun is not None
    }


def apart(first: dict[str, Tensor], other: dict[str, Tensor]) -> dict[str, float]:
    """Angles between the suns of two runs, degrees."""
    off = [math.degrees(float(angle_between(sun, other[name]))) for name, sun in first.items()]
    return {"sun_off_deg_median": statistics.median(off), "sun_off_deg_most": max(off)}


def measure(photos: Path, out: Path, options: list[str]) -> dict[str, float]:
    """One run of the command on an empty ``out``."""
    begun, before = time.monotonic(), _processor_s()
    subprocess.run(
        [sys.executable, "-m", "skylight", "estimate", str(photos), "--out", str(out), *options],
        check=True,
    )
    seconds, processor = time.monotonic() - begun, _processor_s() - before
    entries = read_manifest(out / MANIFEST).values()
    done = [entry.seconds for entry in entries if entry.status == "done" and entry.seconds]
    return {
        "seconds": seconds,
        "processor_seconds": processor,
        "per_minute": 60 * len(entries) / seconds,
        "done": len(done),
        "seconds_of_a_photo": statistics.median(done),
    }


def _processor_s() -> float:
    """Of all processes that this one has started and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
