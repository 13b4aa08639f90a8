"""``skylight evaluate``: runs an evaluation and writes its results."""

import platform
import subprocess
from collections.abc import Callable
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

from skylight.errors import InputError
from skylight.evaluation.codes.lit_object import MESH
from skylight.evaluation.codes.sparse_coding import SparseCoding
from skylight.evaluation.codes.sparse_inverse import SparseInverse
from skylight.evaluation.codes.transport_compression import TransportCompression
from skylight.evaluation.faces.any_light import AnyLight
from skylight.evaluation.faces.captured_faces import CapturedFaces
from skylight.evaluation.faces.face_sensitivity import SIZES, FaceSensitivity
from skylight.evaluation.faces.known_faces import FaceSource
from skylight.evaluation.faces.lamps import Lamps
from skylight.evaluation.faces.options import EstimateOptions
from skylight.evaluation.faces.real_faces import RealFaces
from skylight.evaluation.faces.shared_light import SharedLight
from skylight.evaluation.faces.synthetic_faces import SyntheticFaces
from skylight.evaluation.harness.curves import write_curves
from skylight.evaluation.harness.data_folder import mesh_files, probes_folder
from skylight.evaluation.harness.pictures import write_sheet
from skylight.evaluation.harness.run import Evaluation, Illustrated, measure_all, picture_of
from skylight.evaluation.harness.tables import markdown, summarise, summarise_groups
from skylight.evaluation.portraits.relit_portraits import RelitPortraits
from skylight.evaluation.probes.partition_probe import PartitionProbeTable
from skylight.evaluation.probes.voxel_probe import VoxelProbe
from skylight.evaluation.skies.known_skies import SkyEvaluation
from skylight.evaluation.skies.sky_models import SkyModels
from skylight.evaluation.skies.sky_representations import SkyRepresentations
from skylight.faces.captures import CAPTURES_NAME
from skylight.io.atomic import atomic_path
from skylight.io.json_files import write_json
from skylight.models.names import LightName
from skylight.work.device import choose_device
from skylight.work.resumable import Workers

SHEET_STRIPS = 12
PROBES = "light probes with an index.csv"
PROBES_AND_MESHES = "a folder hdr of light probes with an index.csv, and a folder meshes"


def _synthetic_faces(quick: bool, data: Path | None) -> Evaluation:
    if quick:
        return SyntheticFaces(count=8, data=data, methods=("sh9", "autoencoder"))
    return SyntheticFaces(count=150 if data is None else None, data=data)


def _shared_light(quick: bool, data: Path | None) -> Evaluation:
    needed = "faces in scenes of four, made by 'skylight faces render --per-scene 4'"
    return SharedLight(data=_data("shared-light", data, needed), scenes=8 if quick else None)


def _any_light(quick: bool, data: Path | None) -> Evaluation:
    needed = "faces under given maps, made by 'skylight faces render --maps DIR'"
    return AnyLight(data=_data("any-light", data, needed), count=12 if quick else None)


def _face_sensitivity(quick: bool, data: Path | None) -> Evaluation:
    source = FaceSource(data=data, count=3 if quick else 24, size=max(SIZES))
    if quick:
        methods: tuple[LightName, ...] = ("sh9", "autoencoder")
        few = {"sizes": (90, 192), "angles_deg": (0.0, 15.0), "sigmas": (0.0, 1.1)}
        return FaceSensitivity(source=source, methods=methods, **few)
    return FaceSensitivity(source=source)


def _sky_models(quick: bool, data: Path | None) -> Evaluation:
    return SkyModels(count=24 if quick else 150, data=data)


def _sky_representations(quick: bool, data: Path | None) -> Evaluation:
    return SkyRepresentations(count=12 if quick else 45, data=data)


def _real_faces(quick: bool, data: Path | None) -> Evaluation:
    needed = "photographs with a captures.csv (the true light is known) or an index.json (notes)"
    data = _data("real-faces", data, needed)
    if (data / CAPTURES_NAME).is_file():
        return CapturedFaces(data=data, every=3 if quick else 1)
    return RealFaces(data=data, every=3 if quick else 1)


def _lamps(quick: bool, data: Path | None) -> Evaluation:
    needed = "grey photographs of faces and a lamps.json with the direction of each one's lamp"
    return Lamps(data=_data("lamps", data, needed), every=4 if quick else 1)


def _data(name: str, data: Path | None, needed: str) -> Path:
    if data is None:
        raise InputError(f"{name} needs --data DIR: {needed}")
    if not data.is_dir():
        raise InputError(f"{data}: there is no such folder; {name} needs {needed}")
    return data


def _sparse_coding(quick: bool, data: Path | None) -> Evaluation:
    data = probes_folder(_data("sparse-coding", data, PROBES))
    if quick:  # two maps of 64 rows and short codes
        return SparseCoding(data=data, height=64, counts=(4, 16), indoor=2, outdoor=0, learned=6)
    return SparseCoding(data=data)


def _sparse_inverse(quick: bool, data: Path | None) -> Evaluation:
    data = probes_folder(_data("sparse-inverse", data, PROBES_AND_MESHES))
    mesh_files(data, [MESH])
    if quick:
        return SparseInverse(data=data, every=11, counts=(4, 16))
    return SparseInverse(data=data, every=3)


def _transport_compression(quick: bool, data: Path | None) -> Evaluation:
    data = probes_folder(_data("transport-compression", data, PROBES_AND_MESHES))
    mesh_files(data, [MESH])
    if quick:
        return TransportCompression(data=data, rows=24, chunk=4, nonnegative_every=4, timed_rows=4)
    return TransportCompression(data=data)


def _voxel_probe(quick: bool, data: Path | None) -> Evaluation:
    data = _data("voxel-probe", data, PROBES_AND_MESHES)
    if quick:  # one map, one mesh, noisy references, and some of the sets
        return VoxelProbe(data=data, maps=1, models=1, samples=32, best=6, every_set=20)
    return VoxelProbe(data=data)


def _partition_probe(quick: bool, data: Path | None) -> Evaluation:
    data = _data("partition-probe", data, PROBES_AND_MESHES)
    if quick:  # one map each, noisy references, and probes of few cells
        return PartitionProbeTable(
            data=data, indoor=1, sunny=1, samples=64, rays=64, even=(6, 14), width=96, searches=0
        )
    return PartitionProbeTable(data=data)


def _relit_portraits(quick: bool, data: Path | None) -> Evaluation:
    needed = "folders from and to of the same people, made by 'skylight faces render --light-seed'"
    data = _data("relit-portraits", data, needed)
    return RelitPortraits(data=data, count=4 if quick else None)


EVALUATIONS: dict[str, Callable[[bool, Path | None], Evaluation]] = {
    "synthetic-faces": _synthetic_faces,
    "sky-models": _sky_models,
    "real-faces": _real_faces,
    "lamps": _lamps,
    "sky-representations": _sky_representations,
    "sparse-coding": _sparse_coding,
    "sparse-inverse": _sparse_inverse,
    "transport-compression": _transport_compression,
    "voxel-probe": _voxel_probe,
    "partition-probe": _partition_probe,
    "shared-light": _shared_light,
    "any-light": _any_light,
    "face-sensitivity": _face_sensitivity,
    "relit-portraits": _relit_portraits,
}


def evaluate(
    name: str,
    *,
    quick: bool,
    data: Path | None,
    out: Path,
    workers: Workers = 2,
    options: EstimateOptions | None = None,
) -> Path:
    """Run an evaluation by name and write its results into ``out``; returns ``results.json``.

    Beside it lie ``results.md``, curves where something was measured at several counts, a
    picture per item, ``sheet.png`` of the first of them, and
    ``items.jsonl`` from which the same command goes on after an interruption. A missed goal is
    a result like any other.

    Raises
    ------
    InputError
        An unknown name, data that the evaluation cannot use, or ``options`` other than the
        defaults for an evaluation that does not have them.
    """
    if name not in EVALUATIONS:
        raise InputError(
            f"unknown evaluation {name!r}: choose all or one of {', '.join(EVALUATIONS)}"
        )
    if isinstance(workers, int) and workers < 1:
        raise InputError(f"{workers} workers cannot work: use 1 or more")
    command = f"skylight evaluate {name}" + (" --quick" if quick else "")
    command += f" --data {data.name}" if data is not None else ""
    command += f" --model {options.model.name}" if options and options.model else ""
    evaluation = EVALUATIONS[name](quick, data)
    if options is not None:
        evaluation = _with_options(name, evaluation, options)
    return run_evaluation(evaluation, out, command=command, quick=quick, workers=workers)


def _with_options(name: str, evaluation: Evaluation, options: EstimateOptions) -> Evaluation:
    if isinstance(
        evaluation,
        SyntheticFaces
        | SharedLight
        | AnyLight
        | CapturedFaces
        | RealFaces
        | Lamps
        | FaceSensitivity
        | RelitPortraits,
    ):
        choose_device(options.device)
        return replace(evaluation, options=options)
    if not isinstance(evaluation, SkyEvaluation):
        raise InputError(f"{name} uses no trained model: leave --model and --device out")
    if options.device != "auto":
        raise InputError(f"{name} fits skies on the CPU: leave --device out")
    return replace(evaluation, model=options.model)


def run_evaluation(
    evaluation: Evaluation, out: Path, *, command: str, quick: bool = False, workers: Workers = 1
) -> Path:
    """Measure, summarise, write."""
    bar = Progress(
        "{task.description}",
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )
    with bar:
        task = bar.add_task(evaluation.name)
        items = measure_all(
            evaluation,
            out,
            workers=workers,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    if not any(item.metrics for item in items):
        problem = next((item.problem for item in items), "there is nothing to measure")
        raise InputError(f"{evaluation.name} has no result: {problem}")
    rows = summarise(items)
    results = {
        "name": evaluation.name,
        "command": command,
        "commit": commit(),
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "machine": f"{platform.machine()}, torch {torch.__version__}, "
        + (f"{workers} processes" if isinstance(workers, int) else "workers of a cluster"),
        "seed": evaluation.seed,
        "quick": quick,
        "n": len(items),
        "rows": rows,
        "groups": summarise_groups(items),
        "checks": {k: asdict(c) for k, c in evaluation.checks(rows, items).items()},
        "not_found": sum("no face found" in i.problem for i in items),
        "problems": {i.name: i.problem for i in items if i.problem},
        "items": {i.name: i.facts for i in items},
    }
    write_json(out / "results.json", results)
    with atomic_path(out / "results.md") as temporary:
        temporary.write_text(markdown(results), encoding="utf-8")
    write_curves(out, rows)
    strips = [picture_of(out, item.name) for item in items[:SHEET_STRIPS]]
    write_sheet(out / "sheet.png", strips)
    if isinstance(evaluation, Illustrated):
        evaluation.illustrate(out, rows, items)
    return out / "results.json"


def commit() -> str:
    """The commit of the code, ``+`` where the package was changed since; "unknown" outside a
    checkout."""

    def git(*arguments: str) -> str:
        folder = str(Path(__file__).parents[1])
        done = subprocess.run(["git", "-C", folder, *arguments], capture_output=True, text=True)
        if done.returncode:
            raise OSError(done.stderr)
        return done.stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no", ".")
        return git("rev-parse", "--short", "HEAD") + ("+" if changed else "")
    except OSError:
        return "unknown"
