"""Which sources make earlier results stale: all that a number may depend on."""

import ast
from pathlib import Path

import pytest

import skylight
from skylight.evaluation import _run as run

ROOT = Path(str(skylight.__path__[0]))
# they run items, show how far they are and write pages: no number is theirs
TOLD_APART = {
    "cli.py",
    "evaluation/_main.py",
    "evaluation/_tables.py",
    "maps",
    "studio",
    "training",
    "work/_cluster.py",
    "work/_memory.py",
    "work/_processes.py",
    "work/_progress.py",
    "work/_resumable.py",
}


def parts() -> set[str]:
    """The package's folders and files; of the two that are told apart, their own."""
    own = {path.name for path in ROOT.iterdir() if path.suffix == ".py" or path.is_dir()}
    for folder in ("evaluation", "work"):
        own |= {f"{folder}/{path.name}" for path in (ROOT / folder).glob("_*.py")}
    return own - {"evaluation", "work", "__pycache__"}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file for each part of the real package, of which the hash is taken."""
    for name in parts():
        path = tmp_path / name if name.endswith(".py") else tmp_path / name / "_a.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text("a = 1\n")
    monkeypatch.setattr(skylight, "__path__", [str(tmp_path)])
    return tmp_path


def code_hash() -> str:
    return run.code_hash.__wrapped__()


def test_every_part_that_makes_numbers_counts(package: Path) -> None:
    before, counted = code_hash(), set()
    for name in parts():
        path = package / name if name.endswith(".py") else package / name / "_a.py"
        path.write_text("a = 2\n")
        if code_hash() != before:
            counted.add(name)
        path.write_text("a = 1\n")
    assert code_hash() == before
    assert counted == parts() - TOLD_APART


def test_names_and_data_count_and_pages_do_not(package: Path) -> None:
    hashes = [code_hash()]
    (package / "models" / "data").mkdir()
    (package / "models" / "data" / "a.safetensors").write_bytes(b"1")
    hashes.append(code_hash())
    (package / "models" / "data" / "a.safetensors").write_bytes(b"2")
    hashes.append(code_hash())
    (package / "csc" / "_a.py").rename(package / "csc" / "_b.py")
    hashes.append(code_hash())
    assert len(set(hashes)) == 4
    (package / "csc" / "README.md").write_text("words")
    assert code_hash() == hashes[-1]


def test_no_evaluation_imports_what_does_not_count() -> None:
    """Neither directly nor by others, but for what runs its items."""
    waiting = [ROOT / "evaluation" / path.name for path in (ROOT / "evaluation").glob("_*.py")]
    waiting.remove(ROOT / "evaluation" / "_main.py")
    found: set[str] = set()
    while waiting:
        path = waiting.pop()
        name = path.relative_to(ROOT).as_posix()
        if name in found:
            continue
        found.add(name)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):  # `from skylight.sphere import _harmonics` too
                names = [f"{node.module}.{alias.name}" for alias in node.names]
                for module in (str(node.module), *names):
                    target = ROOT.parent / (module.replace(".", "/") + ".py")
                    if module.startswith("skylight.") and target.is_file():
                        waiting.append(target)
    assert "csc/_greedy.py" in found
    apart = {name for name in found if name.startswith(tuple(TOLD_APART))}
    assert {name for name in apart if not name.startswith(("work/", "evaluation/"))} == set()
