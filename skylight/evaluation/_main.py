"""``skylight evaluate``: runs an evaluation and writes its results.

``skylight evaluate all``: each evaluation that there are data for, and one page of results.
"""

import platform
import re
import subprocess
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType

import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

from skylight.errors import InputError
from skylight.evaluation._any_light import AnyLight
from skylight.evaluation._face_sensitivity import FaceSensitivity
from skylight.evaluation._known_faces import EstimateOptions
from skylight.evaluation._lamps import Lamps
from skylight.evaluation._light_representations import LightRepresentations
from skylight.evaluation._partition_probe import PartitionProbeTable
from skylight.evaluation._pictures import write_sheet
from skylight.evaluation._real_faces import RealFaces
from skylight.evaluation._relit_lamps import RelitLamps
from skylight.evaluation._relit_portraits import RelitPortraits
from skylight.evaluation._run import Evaluation, measure_all, picture_of
from skylight.evaluation._shared_light import SharedLight
from skylight.evaluation._sky_models import SkyModels
from skylight.evaluation._sky_representations import SkyRepresentations
from skylight.evaluation._sparse_coding import SparseCoding
from skylight.evaluation._sparse_inverse import SparseInverse
from skylight.evaluation._speed import Speed
from skylight.evaluation._synthetic_faces import SyntheticFaces
from skylight.evaluation._tables import markdown, summarise, summarise_groups, write_curves
from skylight.evaluation._transport_compression import TransportCompression
from skylight.evaluation._voxel_probe import VoxelProbe
from skylight.io._atomic import atomic_path
from skylight.io._bounded import write_json
from skylight.models._bundle import LightBundle, Model
from skylight.models._network_names import network_option
from skylight.models._sphere import Places
from skylight.work._resumable import Workers, locked

SHEET_STRIPS = 12


EVALUATIONS: dict[str, type[Evaluation]] = {
    kind.title: kind
    for kind in (
        SyntheticFaces,
        SkyModels,
        RealFaces,
        Lamps,
        SkyRepresentations,
        LightRepresentations,
        SparseCoding,
        SparseInverse,
        TransportCompression,
        VoxelProbe,
        PartitionProbeTable,
        SharedLight,
        AnyLight,
        FaceSensitivity,
        RelitPortraits,
        RelitLamps,
        Speed,
    )
}


def evaluate(
    name: str,
    *,
    quick: bool,
    data: Path | None,
    out: Path,
    workers: Workers = 2,
    options: EstimateOptions | None = None,
    peers: Mapping[str, Path] = MappingProxyType({}),
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
        defaults or ``peers`` for an evaluation that does not have them.
    """
    if name not in EVALUATIONS:
        raise InputError(
            f"unknown evaluation {name!r}: choose all or one of {', '.join(EVALUATIONS)}"
        )
    if isinstance(workers, int) and workers < 1:
        raise InputError(f"{workers} workers cannot work: use 1 or more")
    command = f"skylight evaluate {name}" + (" --quick" if quick else "")
    command += f" --data {data.name}" if data is not None else ""
    command += f" --model {_named(options.model)}" if options and options.model else ""
    command += "".join(f" --peer {peer}={folder.name}" for peer, folder in peers.items())
    evaluation = EVALUATIONS[name].over(data, quick=quick)
    if options is not None:
        evaluation = evaluation.with_model(options.model, options.device)
    if peers:
        evaluation = evaluation.with_peers(peers)
    return run_evaluation(evaluation, out, command=command, quick=quick, workers=workers)


def _named(model: Model) -> str:
    if isinstance(model, Places):
        return "places"
    if not isinstance(model, LightBundle):
        return Path(model).name
    return model.name + network_option(type(model.network))


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
    with locked(out):
        for name, kind in EVALUATIONS.items():
            begun, problem = time.monotonic(), ""
            own = None if data is None or kind.data_folder is None else data / kind.data_folder
            try:
                evaluate(
                    name,
                    quick=quick,
                    data=own,
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


def _page(out: Path, done: list[_Done], quick: bool) -> str:
    """What was run, for how long (by the last command), and each evaluation's own page below."""
    how = ", small runs that show the form of the results" if quick else ""
    lines = [f"# All evaluations{how}", "", f"Commit {commit()}.", ""]
    lines += ["| evaluation | minutes of the last run | |", "|---|---|---|"]
    for one in done:
        outcome = f"left out: {one.problem}" if one.problem else f"[results](#{one.name})"
        lines.append(f"| {one.name} | {one.seconds / 60:.1f} | {outcome.replace('|', '/')} |")
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
