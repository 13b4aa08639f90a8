"""Records say by which commit they were measured, and the pages say what became of its code."""

import subprocess
from pathlib import Path

import pytest

from tools import records

# Their commits were lost when histories were joined; each of their rows says so.
LOST = {"films", "live"}
history = pytest.mark.skipif(
    not records.has_history(), reason="needs git and all commits of this repository"
)


def git(folder: Path, *arguments: str) -> str:
    identity = ("-c", "user.name=a", "-c", "user.email=a@b")
    done = subprocess.run(
        ["git", "-C", str(folder), *identity, *arguments],
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def commit(folder: Path, files: dict[str, str]) -> str:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    git(folder, "add", "-A")
    git(folder, "commit", "-qm", "m")
    return git(folder, "rev-parse", "--short=7", "HEAD")


@pytest.fixture
def clone(tmp_path: Path) -> tuple[Path, dict]:
    """A repository, and a record of the tool that is in it."""
    folder = tmp_path / "clone"
    folder.mkdir()
    git(folder, "init", "-q")
    files = {
        "tools/measure.py": "from skylight import used\n",
        "skylight/__init__.py": "",
        "skylight/used.py": "def f():\n    from skylight.deep.inner import (\n        x,\n    )\n",
        "skylight/deep/__init__.py": "",
        "skylight/deep/inner.py": "x = 1\n",
        "skylight/deep/data/table.csv": "1\n",
        "skylight/other.py": "",
    }
    first = commit(folder, files)
    return folder, {"command": "python -m tools.measure --out DIR", "commit": first}


@history
@pytest.mark.parametrize("name", records.every())
def test_the_commit_of_every_record_is_in_the_history(name: str) -> None:
    age = records.age(records.results(name))
    assert (age.commits is None) == (name in LOST)
    assert (age.mark == records.LOST) == (name in LOST)


@pytest.mark.parametrize("name", records.every())
def test_what_a_record_was_made_by_is_known(name: str) -> None:
    started = records.started_by(records.results(name))
    assert started
    assert [path for path in started if not (records.ROOT / path).is_file()] == []
    assert set(started) <= set(records.sources(started))


def test_evaluations_speak_of_the_code_that_they_measure() -> None:
    coding, faces = (
        set(records.sources(records.started_by(records.results(name))))
        for name in ("sparse-coding", "rendered-faces")
    )
    assert {"skylight/csc/_greedy.py", "skylight/imaging/_metrics.py"} <= coding
    around = ("skylight/evaluation/_tables.py", "skylight/work/_progress.py")
    assert not any(path.startswith(("skylight/faces", *around)) for path in coding)
    assert {"skylight/inverse/_sky.py", "skylight/models/data"} <= faces


def test_a_record_of_this_code_has_no_mark(clone: tuple[Path, dict]) -> None:
    folder, record = clone
    commit(folder, {"skylight/other.py": "y = 1\n", "README.md": "r"})
    assert records.age(record, folder) == records.Age(commits=1, changed=())
    assert records.age(record, folder).mark == ""


@pytest.mark.parametrize(
    "changed",
    ["tools/measure.py", "skylight/deep/inner.py", "skylight/deep/data/table.csv"],
)
def test_a_record_whose_code_changed_is_older(clone: tuple[Path, dict], changed: str) -> None:
    folder, record = clone
    (folder / changed).write_text("z = 2\n")  # not committed yet
    found = records.age(record, folder)
    assert (found.commits, found.changed, found.mark) == (0, (changed,), records.OLDER)


def test_what_starts_commands_uses_all_of_the_package(clone: tuple[Path, dict]) -> None:
    folder, record = clone
    now = commit(folder, {"tools/measure.py": "import subprocess\n"})
    commit(folder, {"skylight/other.py": "y = 1\n"})
    found = records.age(record | {"commit": now}, folder)
    assert found == records.Age(commits=1, changed=("skylight/other.py",))


def test_a_commit_from_elsewhere_is_lost(clone: tuple[Path, dict]) -> None:
    folder, record = clone
    assert records.age(record | {"commit": "0123456"}, folder).mark == records.LOST
    git(folder, "checkout", "-q", "--orphan", "alone")
    commit(folder, {"a": "b"})
    assert records.age(record, folder).mark == records.LOST  # here, but no ancestor


def test_a_record_of_a_changed_checkout_is_of_no_commit(clone: tuple[Path, dict]) -> None:
    folder, record = clone
    dirty = record | {"commit": f"{record['commit']}+"}
    assert records.commit_of(dirty) == f"{record['commit']}+"
    assert records.age(dirty, folder) == records.Age(commits=0, changed=(records.UNCOMMITTED,))
    bench = {"commit_info": {"id": "75c0a0597e17cf0", "dirty": True}}
    assert records.commit_of(bench) == "75c0a05+"


def test_archives_and_shallow_clones_have_no_history(clone: tuple[Path, dict]) -> None:
    folder, _ = clone
    commit(folder, {"a": "b"})
    assert records.has_history(folder)
    shallow = folder.with_name("shallow")
    git(folder.parent, "clone", "-q", "--depth", "1", folder.as_uri(), str(shallow))
    assert not records.has_history(shallow)
    assert not records.has_history(folder / "tools")  # an archive within another's repository
    (folder.with_name("archive")).mkdir()
    assert not records.has_history(folder.with_name("archive"))
