"""``skylight evaluate all``: each evaluation that there are data for, and one page of results."""

import re
import time
from dataclasses import dataclass
from pathlib import Path

from skylight.errors import InputError
from skylight.evaluation.faces.options import EstimateOptions
from skylight.evaluation.main import EVALUATIONS, commit, evaluate
from skylight.io.atomic import atomic_path
from skylight.work.resumable import Workers, claimed

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
    """Run :func:`~skylight.evaluation.main.evaluate` for all, each into a folder of ``out``.

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
