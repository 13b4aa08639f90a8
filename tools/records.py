"""The records in ``benchmarks/results``: their numbers, and whether their code changed since.

A record names its commit and its command. What the command runs, and all that this imports, is the
code that the record speaks of; git tells what of it is different now. In a copy without the
history (an archive, a shallow clone) nothing can be told.
"""

import json
import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from skylight.evaluation._main import EVALUATIONS
from skylight.evaluation._run import UNMEASURED

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
Record = dict[str, Any]
OLDER = "older than its code"
LOST = "its commit is not in this history: to be measured again"
UNCOMMITTED = "changes that it was made with and that were not committed"
# What starts, keeps and shows runs. Tools measure other parts of the package than evaluations do.
_AROUND = tuple(
    f"skylight/{part}" for part in UNMEASURED if part.startswith(("evaluation/", "work/"))
)


@dataclass(frozen=True, kw_only=True)
class Age:
    """``commits`` since, None where its own is not in the history; ``changed``: files since."""

    commits: int | None
    changed: tuple[str, ...] = ()

    @property
    def mark(self) -> str:
        """What a table must say beside the record's numbers; "" where they are of this code."""
        if self.commits is None:
            return LOST
        return OLDER if self.changed else ""


@cache
def results(name: str) -> Record:
    return json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))


def mean(of: str, row: str, metric: str) -> float:
    return results(of)["rows"][row][metric]["mean"]


def every(folder: Path = RESULTS) -> dict[str, Record]:
    """All records of a folder, in the order of their names."""
    return {
        path.stem: json.loads(path.read_text(encoding="utf-8"))
        for path in sorted(folder.glob("*.json"))
    }


def commit_of(record: Record) -> str:
    """Short, with the ``+`` of a changed checkout; pytest-benchmark has its own place for it."""
    if "commit" in record:
        return record["commit"]
    found = record["commit_info"]
    return found["id"][:7] + ("+" if found["dirty"] else "")


def has_history(root: Path = ROOT) -> bool:
    """Whether ``root`` is a clone with all of its commits."""
    told = _git(root, "rev-parse", "--is-shallow-repository", "--show-toplevel")
    return told is not None and told.split("\n") == ["false", str(root.resolve())]


@cache
def _age(commit: str, started: tuple[str, ...], root: Path) -> Age:
    since = _git(root, "rev-list", "--count", f"{commit}..HEAD")
    ancestor = _git(root, "merge-base", "--is-ancestor", commit, "HEAD") is not None
    if since is None or not ancestor:
        return Age(commits=None)
    changed = _git(root, "diff", "--name-only", commit, "--", *sources(started, root))
    return Age(commits=int(since), changed=tuple((changed or "").split()))


def age(record: Record, root: Path = ROOT) -> Age:
    """Of a record, in a clone that :func:`has_history`."""
    commit = commit_of(record)
    found = _age(commit.removesuffix("+"), started_by(record, root), root)
    if commit.endswith("+") and found.commits is not None:
        return replace(found, changed=(*found.changed, UNCOMMITTED))
    return found


def started_by(record: Record, root: Path = ROOT) -> tuple[str, ...]:
    """The files that a record's command runs."""
    command = record.get("command", "pytest benchmarks")  # `make bench`
    found = [kind for title, kind in EVALUATIONS.items() if f"evaluate {title} " in f"{command} "]
    found += [kind for kind in EVALUATIONS.values() if f"{kind.__name__}(" in command]
    paths = [f"{kind.__module__.replace('.', '/')}.py" for kind in found]
    paths += re.findall(r"(?:tools|benchmarks)/\w+\.py", command)
    paths += [f"{name.replace('.', '/')}.py" for name in re.findall(r"-m (tools[.\w]+)", command)]
    if command.endswith(" benchmarks"):
        paths += [str(p.relative_to(root)) for p in sorted(root.glob("benchmarks/test_*.py"))]
    return tuple(paths)


def sources(started: tuple[str, ...], root: Path = ROOT) -> list[str]:
    """These files, all that they import of this repository, and the data files beside those.

    Of a tool that starts commands, all of the package.
    """
    found: set[Path] = set()
    left = [root / path for path in started]
    while left:
        path = left.pop()
        if path not in found and not str(path.relative_to(root)).startswith(_AROUND):
            found.add(path)
            left += _imported(path, root)
    data = {path.parent / "data" for path in found}
    runs = any(_STARTS.search(_text(root / path)) for path in started)
    whole = {root / "skylight"} if runs else set()
    return sorted(str(p.relative_to(root)) for p in found | whole | {d for d in data if d.is_dir()})


_IMPORT = re.compile(r"^\s*(?:from ([\w.]+) import (\([^)]*\)|.+)|import ([\w., ]+))", re.MULTILINE)
_STARTS = re.compile(r"\bsubprocess\b|\bimport_module\b")


@cache
def _imported(path: Path, root: Path) -> list[Path]:
    return [file for name in _modules(_text(path)) for file in _files(name, root)]


@cache
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def _modules(text: str) -> Iterator[str]:
    """Dotted names that may be modules."""
    for package, names, modules in _IMPORT.findall(text):
        yield package
        yield from (f"{package}.{name}" for name in re.findall(r"\w+", names))
        yield from re.findall(r"[\w.]+", modules)


def _files(module: str, root: Path) -> list[Path]:
    if not module:
        return []
    place = root / module.replace(".", "/")
    files = (place.with_name(f"{place.name}.py"), place / "__init__.py")
    return [path for path in files if path.is_file()]


def _git(root: Path, *arguments: str) -> str | None:
    """What it prints; None where it fails or is not there."""
    try:
        done = subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, text=True)
    except OSError:
        return None
    return None if done.returncode else done.stdout.strip()
