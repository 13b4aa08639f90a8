"""Code broken in one place at a time: do the tests notice?

::

    python tools/mutate.py --sample 240 --minutes 60 --out out/night/mutants.json

First the tests of :data:`TESTS` run once under coverage, which says which of them run a line. Then
each mutant of the sample (drawn by ``--seed``) is written into a copy of the repository, and those
of its tests that are quickest run in a forked process until one fails. What is known is kept in
the record beside the lists of survivors, so that a run goes on where it was stopped.

Not broken, since nobody asks tests for it: texts, annotations, messages of errors, how figures and
pictures look, and the settings of quick runs.
"""

import argparse
import importlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from tools.mutations import Mutant, mutants_of  # noqa: E402

SCOPE = (
    *("skylight/evaluation/_[a-z]*.py", "skylight/imaging/_metrics.py", "skylight/work/_[a-z]*.py"),
    *("skylight/training/_[a-z]*.py", "tools/build_figures.py", "tools/build_measurements.py"),
    *("tools/figures/[a-z]*.py", "tools/records.py"),
)
LOOKS = ("skylight/evaluation/_pictures.py",)
TESTS = (
    *("tests/evaluation", "tests/imaging/test_metrics.py", "tests/work", "tests/training"),
    *("tests/test_pages.py", "tests/test_records.py"),
)
# imported before forking, so that no mutant waits for them; and so are skylight's own modules,
# under the hook by which tests check annotations
HEAVY = ("scipy.optimize", "trimesh", "skimage.metrics", "hypothesis", "onnxruntime")
OPTIONS = "addopts=-ra --strict-markers --import-mode=importlib"  # without that hook
EVERYWHERE = ("skylight/work/", "skylight/imaging/")  # nearly all imports these: begin anew
PYTEST = ("-q", "-x", "-p", "no:cacheprovider", "-m", "not slow", "-o", OPTIONS)
MOST_SECONDS = 60.0  # of the tests of one mutant, as they take without it
GOAL = 0.95


@dataclass(frozen=True, kw_only=True)
class Tests:
    """``of_line``: file -> line -> tests; ``seconds``: what each takes with its fixtures."""

    of_line: dict[str, dict[int, list[str]]]
    seconds: dict[str, float]

    def of(self, mutant: Mutant) -> list[str]:
        """Those that may notice a mutant, the quickest first, within a time.

        What runs at import is noticed by whatever runs its file or one that imports it.
        """
        if mutant.in_function:
            lines = self.of_line.get(mutant.file, {})
            found = {test for line in mutant.lines for test in lines.get(line, [])}
        else:
            package, _, name = mutant.file.removesuffix(".py").replace("/", ".").rpartition(".")
            imports = re.compile(rf"from {package}(\.| import [^#]*\b){name}\b")
            users = [file for file in self.of_line if imports.search((ROOT / file).read_text())]
            files = [self.of_line.get(file, {}) for file in (mutant.file, *users)]
            found = {test for lines in files for tests in lines.values() for test in tests}
            own = {test.partition("::")[0] for test in self.seconds}
            own = {file for file in own if imports.search((ROOT / file).read_text())}
            found |= {test for test in self.seconds if test.partition("::")[0] in own}
        chosen, total = [], 0.0
        for test in sorted(found, key=lambda test: (self.seconds[test], test)):
            total += self.seconds[test]
            if chosen and total > MOST_SECONDS:
                break
            chosen.append(test)
        return chosen


def sources() -> list[str]:
    files = sorted(path.relative_to(ROOT).as_posix() for glob in SCOPE for path in ROOT.glob(glob))
    return [file for file in files if file not in LOOKS]


def copied(folder: Path) -> None:
    """The repository's files in ``folder``, data as links."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "-z"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    for name in filter(None, listed.split("\0")):
        source, target = ROOT / name, folder / name
        if source.is_file():
            target.parent.mkdir(parents=True, exist_ok=True)
            if source.suffix == ".py":
                shutil.copy2(source, target)
            else:
                target.symlink_to(source)


def imported(folder: Path) -> None:
    """What the tests will need, of the copy in ``folder``."""
    from jaxtyping import install_import_hook

    sys.path[:] = [str(folder), *(p for p in sys.path if Path(p or ".").resolve() != ROOT)]
    os.environ["PYTHONPATH"] = str(folder)
    for name in HEAVY:
        importlib.import_module(name)
    install_import_hook(["skylight"], "beartype.beartype")
    importlib.import_module("tests.annotations")
    for path in sorted((folder / "skylight").rglob("_*.py")):
        if path.name != "__main__.py" and "studio" not in path.parts:
            importlib.import_module(_module(path.relative_to(folder).as_posix()))


def _module(file: str) -> str:
    return file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def forget(file: str, folder: Path) -> None:
    """A module and all that import it, so that they are imported again."""
    from beartype._cache.cacheclear import clear_caches

    waiting, gone = [_module(file)], set()
    while waiting:
        module = waiting.pop()
        if module in gone:
            continue
        gone.add(module)
        package, _, name = module.rpartition(".")
        imports = re.compile(rf"from {package}(\.{name}\b| import [^#]*\b{name}\b)")
        for other, loaded in list(sys.modules.items()):
            path = getattr(loaded, "__file__", None) or ""
            if path.startswith(str(folder)) and imports.search(Path(path).read_text()):
                waiting.append(other)
    clear_caches()  # which know classes by their names
    for module in gone:
        sys.modules.pop(module, None)
        package, _, name = module.rpartition(".")
        vars(sys.modules.get(package, sys)).pop(name, None)


def forked(
    folder: Path, work: list[str], log: Path, record: Path | None = None, changed: str = ""
) -> int:
    """Process id of a child that runs these tests in ``folder``, whose file ``changed`` did."""
    child = os.fork()
    if child:
        return child
    status = 70
    try:
        os.setsid()
        with log.open("wb") as stream:
            os.dup2(stream.fileno(), 1)
            os.dup2(stream.fileno(), 2)
        os.chdir(folder)
        if changed.startswith(EVERYWHERE):
            os.execv(sys.executable, [sys.executable, "-m", "pytest", *PYTEST[:-2], *work])
        import pytest

        if changed.startswith("skylight/"):
            forget(changed, folder)
        if record is None:
            status = int(pytest.main([*PYTEST, *work]))
        else:
            status = recorded(folder, work, record)
    finally:
        os._exit(status)


def recorded(folder: Path, work: list[str], record: Path) -> int:
    """Runs tests and writes which of them run which lines."""
    import coverage
    import pytest

    files = [str(folder / file) for file in sources()]
    cover = coverage.Coverage(data_file=None, include=files, config_file=False)

    class Contexts:
        """A context for each test and fixture: what a fixture runs, all its tests need."""

        now = ""
        seconds: dict[str, float] = {}  # noqa: RUF012
        fixtures: dict[str, list[str]] = {}  # noqa: RUF012

        def within(self, name: str):
            before, self.now = self.now, name
            cover.switch_context(name)
            start = time.perf_counter()
            try:
                return (yield)
            finally:
                self.seconds[name] = time.perf_counter() - start
                self.now = before
                cover.switch_context(before)

        @pytest.hookimpl(wrapper=True)
        def pytest_runtest_call(self, item):
            return (yield from self.within(item.nodeid))

        @pytest.hookimpl(wrapper=True)
        def pytest_runtest_setup(self, item):
            for name, module in list(sys.modules.items()):
                if name.startswith("skylight.evaluation"):  # what is made once, all tests need
                    for value in vars(module).values():
                        getattr(value, "cache_clear", lambda: None)()
            known = item._fixtureinfo.name2fixturedefs.values()
            self.fixtures[item.nodeid] = [f"{d.baseid}::{d.argname}" for ds in known for d in ds]
            return (yield)

        @pytest.hookimpl(wrapper=True)
        def pytest_fixture_setup(self, fixturedef, request):
            return (yield from self.within(f"{fixturedef.baseid}::{fixturedef.argname}"))

    contexts = Contexts()
    with cover.collect():
        status = int(pytest.main([*PYTEST, *work], plugins=[contexts]))
    tests_of: dict[str, list[str]] = defaultdict(list)
    for test, fixtures in contexts.fixtures.items():
        for name in (test, *fixtures):
            tests_of[name].append(test)
    data = cover.get_data()
    of_line = {
        file: {
            line: sorted({test for name in names for test in tests_of.get(name, [])})
            for line, names in data.contexts_by_lineno(str(folder / file)).items()
        }
        for file in sources()
    }
    took = contexts.seconds
    seconds = {
        test: took.get(test, 0.0) + sum(took.get(name, 0.0) for name in fixtures)
        for test, fixtures in contexts.fixtures.items()
    }
    record.write_text(json.dumps({"of_line": of_line, "seconds": seconds}))
    return status


def merged(old: dict | None, new: dict, changed: list[str]) -> dict:
    """``new``, and of ``old`` what is of other files of tests."""
    for file, of in old["of_line"].items() if old else ():
        into = new["of_line"].setdefault(file, {})
        for line, tests in of.items():
            kept = {test for test in tests if test.partition("::")[0] not in changed}
            into[line] = sorted(kept.union(into.get(line, [])))
    return {"of_line": new["of_line"], "seconds": (old or new)["seconds"] | new["seconds"]}


def finished(child: int, seconds: float) -> int | None:
    """Its exit status; None where it takes longer, and is killed."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def judged(mutant: Mutant, tests: Tests, folder: Path, log: Path, stamp: int) -> dict[str, object]:
    """What became of one mutant."""
    chosen = tests.of(mutant)
    found: dict[str, object] = {"file": mutant.file, "line": mutant.lines[0]}
    found |= {"change": mutant.change}
    if not chosen:
        return found | {"outcome": "not covered"}
    target, source = folder / mutant.file, ROOT / mutant.file
    target.write_bytes(mutant.source)
    os.utime(target, (stamp, stamp))  # bytecode is told apart by the second
    start = time.monotonic()
    limit = min(600.0, 60 + 10 * sum(tests.seconds[test] for test in chosen))
    status = finished(forked(folder, chosen, log, changed=mutant.file), limit)
    shutil.copy2(source, target)
    outcome = {0: "survived", None: "killed (no end)"}.get(status, "killed")
    found |= {"outcome": outcome, "seconds": round(time.monotonic() - start, 1)}
    if outcome == "killed":
        failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", log.read_text(errors="replace"), re.M)
        found["by"] = failed[0] if failed else f"exit {status}"
    return found


def sampled(count: int, seed: int, only: str) -> Iterator[Mutant]:
    every = [mutant for file in sources() for mutant in mutants_of(ROOT, file)]
    # by a draw of its own each, so that changes elsewhere do not change the sample
    every.sort(key=lambda mutant: random.Random(f"{seed} {mutant.key}").random())
    return (mutant for mutant in every[:count] if re.search(only, mutant.file))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/mutants.json"))
    parser.add_argument("--sample", type=int, default=240)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--only", default="", help="files that match, as a regular expression")
    parser.add_argument("--again", action="store_true", help="judge the survivors again")
    parser.add_argument("--changed", nargs="*", default=[], help="files of tests to record anew")
    options = parser.parse_args()
    end = time.monotonic() + 60 * options.minutes
    out = options.out.resolve()
    out.parent.mkdir(parents=True, exist_ok=True)
    record = json.loads(out.read_text()) if out.is_file() else {}
    log, lines = out.with_suffix(".log"), out.with_suffix(".tests.json")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "copy"
        copied(folder)
        imported(folder)
        known = json.loads(lines.read_text()) if lines.is_file() else None
        if known is None or options.changed:
            work = list(TESTS) if known is None else options.changed
            status = finished(forked(folder, work, log, lines), 3600)
            if status != 0:
                print(f"the tests fail as they are, see {log}")
                return 1
            known = merged(known, json.loads(lines.read_text()), options.changed)
            lines.write_text(json.dumps(known))
        tests = Tests(
            of_line={
                file: {int(line): names for line, names in of.items()}
                for file, of in known["of_line"].items()
            },
            seconds=known["seconds"],
        )
        first = int(time.time()) + 1000
        for number, mutant in enumerate(sampled(options.sample, options.seed, options.only)):
            before = record.get(mutant.key)
            alive = before and not str(before["outcome"]).startswith("killed")
            if before and not (options.again and alive):
                continue
            if time.monotonic() > end:
                print("no time left: the same command goes on")
                break
            record[mutant.key] = judged(mutant, tests, folder, log, first + number)
            out.write_text(json.dumps(record, indent=1))
    keys = {mutant.key for mutant in sampled(options.sample, options.seed, options.only)}
    tried = [one for key, one in record.items() if key in keys]
    alive = [one for one in tried if not one["outcome"].startswith("killed")]
    for one in alive:
        print(f"{one['file']}:{one['line']}: {one['change']} ({one['outcome']})")
    killed = (len(tried) - len(alive)) / max(1, len(tried))
    goal = "" if killed >= GOAL else f", of which {100 * GOAL:.0f} % is the goal"
    print(f"{len(tried)} mutants, {100 * killed:.1f} % killed{goal}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
