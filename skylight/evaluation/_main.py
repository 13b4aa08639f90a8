"""``skylight evaluate``: runs an evaluation and writes its results.

``skylight evaluate all``: each evaluation that there are data for, and one page of results.
"""

import platform
import re
import subprocess
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

from skylight.errors import InputError
from skylight.evaluation._any_light import AnyLight
from skylight.evaluation._face_sensitivity import SIZES, FaceSensitivity
from skylight.evaluation._known_faces import EstimateOptions, FaceSource
from skylight.evaluation._lamps import Lamps
from skylight.evaluation._lit_object import MESH
from skylight.evaluation._partition_probe import PartitionProbeTable
from skylight.evaluation._pictures import write_sheet
from skylight.evaluation._real_faces import CapturedFaces, RealFaces
from skylight.evaluation._relit_portraits import RelitPortraits
from skylight.evaluation._run import (
    Evaluation,
    Illustrated,
    measure_all,
    mesh_files,
    picture_of,
    probes_folder,
)
from skylight.evaluation._shared_light import SharedLight
from skylight.evaluation._sky_models import SkyEvaluation, SkyModels
from skylight.evaluation._sky_representations import SkyRepresentations
from skylight.evaluation._sparse_coding import SparseCoding
from skylight.evaluation._sparse_inverse import SparseInverse
from skylight.evaluation._synthetic_faces import SyntheticFaces
from skylight.evaluation._tables import markdown, summarise, summarise_groups, write_curves
from skylight.evaluation._transport_compression import TransportCompression
from skylight.evaluation._voxel_probe import VoxelProbe
from skylight.faces._captures import CAPTURES_NAME
from skylight.io._atomic import atomic_path
from skylight.io._bounded import write_json
from skylight.models._names import LightName
from skylight.work._device import choose_device
from skylight.work._resumable import Workers, claimed

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


PAGE = "results.md"
# In the folder of data; the others take that folder itself, or need none.
_FOLDERS = {
    "real-faces": "faces",
    "lamps": "lamps",
    "shared-light": "scenes",
    "any-light": "indoor",
    "relit-portraits": "relit",
}
_WITHOUT = ("synthetic-faces", "face-sensitivity", "sky-models", "sky-representations")


@dataclass(frozen=True)
class _Done:
    name: str
    seconds: float
    problem: str = ""  # why it was left out


def evaluate_all(
    *,
    quick: bool,
    data: Path | None,
    out: Path,
    workers: Workers = 2,
    options: EstimateOptions | None = None,
) -> Path:
    """Run :func:`~skylight.evaluation._main.evaluate` for all, each into a folder of ``out``.

    ``data`` holds hdr (light probes and their index.csv), meshes, and the photographs and rendered
    faces of some evaluations in faces, lamps, scenes, indoor and relit. What cannot be evaluated
    (no such data, no model of that kind) is left out, and the page says why. It is written again
    after each; the same command goes on after an interruption. Returns the page, ``results.md``.

    Raises
    ------
    InputError
        ``data`` is no folder, or nothing could be evaluated.
    """
    if data is not None and not data.is_dir():
        raise InputError(f"{data}: there is no such folder; give one with data, or none")
    done: list[_Done] = []
    with claimed(out):
        for name in EVALUATIONS:
            begun, problem = time.monotonic(), ""
            try:
                evaluate(
                    name,
                    quick=quick,
                    data=_data_of(name, data),
                    out=out / name,
                    workers=workers,
                    options=options,
                )
            except InputError as error:
                problem = str(error)
            done.append(_Done(name, time.monotonic() - begun, problem))
            with atomic_path(out / PAGE) as temporary:
                temporary.write_text(_page(out, done, quick), encoding="utf-8")
    if all(one.problem for one in done):
        raise InputError(f"nothing could be evaluated; {out / PAGE} says why")
    return out / PAGE


def _data_of(name: str, data: Path | None) -> Path | None:
    if data is None or name in _WITHOUT:
        return None
    return data / _FOLDERS[name] if name in _FOLDERS else data


def _page(out: Path, done: list[_Done], quick: bool) -> str:
    """What was run, for how long (by the last command), and each evaluation's own page below."""
    how = ", small runs that show the form of the results" if quick else ""
    lines = [f"# All evaluations{how}", "", f"Commit {commit()}.", ""]
    lines += ["| evaluation | minutes of the last run | |", "|---|---|---|"]
    for one in done:
        told = f"left out: {one.problem}" if one.problem else f"[results](#{one.name})"
        lines.append(f"| {one.name} | {one.seconds / 60:.1f} | {told.replace('|', '/')} |")
    for one in done:
        if not one.problem:
            lines += ["", *_section(out, one.name)]
    return "\n".join(lines) + "\n"


def _section(out: Path, name: str) -> list[str]:
    _, _, own = (out / name / PAGE).read_text(encoding="utf-8").partition("\n")  # without its title
    pictures = sorted(path.name for path in (out / name).glob("*.png"))
    return [
        f"## {name}",
        re.sub(r"^#", "##", own, flags=re.MULTILINE).rstrip(),
        *(f"\n![{name}: {picture}]({name}/{picture})" for picture in pictures),
    ]
