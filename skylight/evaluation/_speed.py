"""What an estimate costs: the stages of one photograph, and photographs a minute of the command.

A photograph is estimated in a process that has made an estimate before; each stage has a row. The
items named by workers are runs of ``skylight estimate`` over all photographs, as a user's would be:
seconds in which workers start and load models are in them. ``peak_mib`` is the memory of the
largest process so far. Seconds are those of the machine as it is: nothing else should run on it,
and one process at a time should measure (``--workers 1``).
"""

import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType

from skylight._names import DEFAULT_SKY
from skylight.errors import InputError
from skylight.estimation._manifest import MANIFEST, list_photos, read_manifest
from skylight.estimation._photos import estimate_photo
from skylight.estimation._report import write_results
from skylight.evaluation._known_faces import FaceEvaluation, peak_mib, stage
from skylight.evaluation._run import Item, Metrics
from skylight.models._bundle import LightBundle, Model
from skylight.models._sphere import Places


@dataclass(frozen=True, kw_only=True)
class Speed(FaceEvaluation):
    """The first ``count`` photographs of the folder ``data``.

    ``runs`` of the command are by so many workers, with so many photographs solved together.
    """

    title = "speed"
    needs = "photographs of people"
    data_folder = "faces"
    quick = MappingProxyType({"count": 2, "runs": ((1, 1),)})
    selects = ("runs",)

    data: Path
    count: int = 12
    runs: tuple[tuple[int, int], ...] = ((1, 1), (2, 1), (2, 16))

    def __post_init__(self) -> None:
        _ = self.photos  # refuses a folder without any

    @property
    def photos(self) -> list[str]:
        nowhere = self.data / ".results"  # nothing is written beside the photographs
        return list_photos(self.data, nowhere)[: self.count]

    def items(self) -> list[str]:
        return [*self.photos, *(_named(*run) for run in self.runs)]

    def measure(self, item: str, picture: Path) -> Item:
        for workers, batch in self.runs:
            if item == _named(workers, batch):
                return Item(name=item, metrics={item: self._command(workers, batch)})
        model, device = self.options.model, self.options.device
        _estimated_once(self.data / self.photos[0], model, device)
        began, processor = time.perf_counter(), time.process_time()
        result = estimate_photo(self.data / item, model=model, device=device)
        seconds = dict(result.seconds)
        with tempfile.TemporaryDirectory() as folder, stage(seconds, "report and files"):
            write_results(Path(folder), result)
        metrics: Metrics = {name: {"seconds": took} for name, took in seconds.items()}
        metrics["all"] = {
            "seconds": time.perf_counter() - began,
            "cpu_seconds": time.process_time() - processor,
            "peak_mib": peak_mib(),
        }
        return Item(name=item, metrics=metrics)

    def _command(self, workers: int, batch: int) -> dict[str, float]:
        """One run of ``skylight estimate``."""
        with tempfile.TemporaryDirectory() as temporary:
            photos, out = Path(temporary) / "photos", Path(temporary) / "out"
            photos.mkdir()
            for source in self.photos:
                shutil.copy(self.data / source, photos / source.replace("/", "_"))
            options: dict[str, object] = {"out": out, "workers": workers, "batch": batch}
            options["device"] = self.options.device
            if batch > 1:
                options["light"] = DEFAULT_SKY
            if isinstance(self.options.model, LightBundle | Places):
                raise InputError("speed times commands with skylight's networks: no --network")
            if self.options.model is not None:
                options["model"] = self.options.model
            words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
            began, before = time.perf_counter(), _children_cpu_seconds()
            subprocess.run(
                [sys.executable, "-m", "skylight", "estimate", str(photos), *words],
                check=True,
                capture_output=True,
            )
            seconds = time.perf_counter() - began
            entries = read_manifest(out / MANIFEST).values()
        done = [one.seconds for one in entries if one.status == "done" and one.seconds]
        largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        return {
            "photos_per_minute": 60 * len(entries) / seconds,
            "seconds_of_a_photo": statistics.median(done),
            "cpu_seconds": (_children_cpu_seconds() - before) / len(entries),
            "peak_mib": largest / (2**20 if sys.platform == "darwin" else 2**10),
        }


def _named(workers: int, batch: int) -> str:
    workers_named = f"{workers} worker" + ("s" if workers > 1 else "")
    return workers_named + (f", batches of {batch} ({DEFAULT_SKY})" if batch > 1 else "")


@cache
def _estimated_once(photo: Path, model: Model | None, device: str) -> None:
    """Loads models and whatever else only a process' first estimate does."""
    estimate_photo(photo, model=model, device=device)


def _children_cpu_seconds() -> float:
    """Of all processes that this one has started and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
