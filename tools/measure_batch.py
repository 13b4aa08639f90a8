"""Throughput and memory of batch estimates over the number of workers.

    python -m tools.measure_batch PHOTOS --workers 1 2

Runs ``skylight estimate`` on the first pictures of a folder as a user would, so that the time
takes in starting the workers and loading the models. ``seconds_of_a_photo`` is the median within
a worker, from the manifest; ``largest_process_mb`` the resident memory of the largest process of
all runs. Nothing else should run on the machine.
"""

import argparse
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from skylight.app.estimate.folder.listing import list_photos
from skylight.app.estimate.folder.manifest import MANIFEST, read_manifest
from skylight.models.names import DEFAULT_LIGHT
from tools.measured import write_measured


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("photos", type=Path)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--count", type=int, default=12, help="photos")
    parser.add_argument("--light", default=DEFAULT_LIGHT)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/batch.json"))
    arguments = parser.parse_args()
    if len(arguments.workers) < 2 or len(set(arguments.workers)) < len(arguments.workers):
        parser.error("--workers takes two different numbers or more")
    begun = time.time()
    facts: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as temporary:
        photos = Path(temporary) / "photos"
        photos.mkdir()
        for source in list_photos(arguments.photos, Path(temporary))[: arguments.count]:
            shutil.copy(arguments.photos / source, photos / source.replace("/", "_"))
        for workers in arguments.workers:
            out = Path(temporary) / f"out{workers}"
            found = measure(photos, out, workers, arguments.light)
            facts |= {f"{workers}_workers_{name}": value for name, value in found.items()}
        count = len(list(photos.iterdir()))
    first, *_, last = arguments.workers
    speedup = facts[f"{last}_workers_per_minute"] / facts[f"{first}_workers_per_minute"]
    facts[f"{last}_workers_to_{first}"] = speedup
    # kilobytes on Linux
    largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    facts["largest_process_mb"] = largest
    listed = " ".join(map(str, arguments.workers))
    write_measured(
        arguments.out,
        name="batch",
        what=f"{count} photos, light {arguments.light}, by so many workers of one thread",
        command=f"python -m tools.measure_batch {arguments.photos.name} --workers {listed} "
        f"--count {arguments.count} --light {arguments.light}",
        begun=begun,
        facts=facts,
    )


def measure(photos: Path, out: Path, workers: int, light: str) -> dict[str, float]:
    """One run of the command on an empty ``out``."""
    options = ["--out", str(out), "--workers", str(workers), "--light", light]
    begun = time.monotonic()
    subprocess.run(
        [sys.executable, "-m", "skylight", "estimate", str(photos), *options], check=True
    )
    seconds = time.monotonic() - begun
    entries = read_manifest(out / MANIFEST).values()
    done = [entry.seconds for entry in entries if entry.status == "done" and entry.seconds]
    return {
        "seconds": seconds,
        "per_minute": 60 * len(entries) / seconds,
        "done": len(done),
        "seconds_of_a_photo": statistics.median(done),
    }


if __name__ == "__main__":
    main()
