"""What is installed: extras that are missing, and packages that are another's."""

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import skylight_lighting
from skylight.errors import EXTRAS, explain

ROOT = Path(__file__).parents[2]
# distributions whose packages have other names
DISTRIBUTIONS = {
    "dlib": "dlib-bin",
    "igl": "libigl",
    "starlette": "fastapi",
    "pillow_heif": "pillow-heif",
    "yaml": "PyYAML",
}
COMMANDS = {
    "studio": ["studio", "--no-browser"],
    "print": ["probe", "voxel", "print", "--out", "out"],
    "train": ["train", "--config", "sky_prior"],
}
WITHOUT_EXTRAS = f"""
import sys
sys.modules.update(dict.fromkeys({sorted(EXTRAS)}))
from skylight.cli import main
for command in {list(COMMANDS.values())}:
    assert main(command) == 1
# what makes no solids needs none
import skylight.probes.partitions._capture_files
import skylight.probes.partitions._relight_files
import skylight.probes.voxel._capture_files
sys.stderr = sys.stdout  # what follows is told apart
for command in (["voxel", "inspect", "--probe", "1"], ["partitions", "cells", "14d"]):
    assert main(["probe", *command]) == 0
"""


def test_extras_hold_what_is_said_of_them() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for package, extra in EXTRAS.items():
        needs = project["optional-dependencies"][extra]
        assert any(one.startswith(DISTRIBUTIONS.get(package, package)) for one in needs)
        assert extra in "".join(project["optional-dependencies"]["dev"])


@pytest.mark.parametrize(("package", "extra"), [("manifold3d", "print"), ("yaml.nodes", "train")])
def test_a_missing_package_is_told_by_its_extra(package: str, extra: str) -> None:
    message, code = explain(ModuleNotFoundError(name=package))
    assert code == 1
    assert f"pip install 'skylight-lighting[{extra}]'" in message


def test_any_other_missing_module_is_a_bug() -> None:
    assert "internal error" in explain(ModuleNotFoundError("No module", name="skylight.x"))[0]


def test_commands_without_their_extras(tmp_path: Path) -> None:
    told = subprocess.run(
        [sys.executable, "-c", WITHOUT_EXTRAS],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    lines = told.stderr.splitlines()
    assert [line.rpartition(": ")[2] for line in lines] == [
        f"pip install 'skylight-lighting[{extra}]'" for extra in COMMANDS
    ]


def other_skylight(folder: Path) -> None:
    """The files that tell of the public index's library."""
    (folder / "skylight").mkdir(parents=True, exist_ok=True)
    (folder / "skylight" / "__init__.py").write_text("raise SystemExit('of another')")
    about = folder / "skylight-1.1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: skylight\nVersion: 1.1\n")
    (about / "RECORD").write_text("skylight/__init__.py,sha256=x,976\n")


@pytest.mark.parametrize(
    ("place", "says"),
    [
        ("site", "skylight 1.1 is installed over skylight-lighting's files"),
        ("other", "Python finds another skylight first, "),
        ("", "Python finds no package skylight"),
    ],
)
def test_the_package_of_another_is_noticed(tmp_path: Path, place: str, says: str) -> None:
    """Over ours, in a folder before ours, and instead of ours."""
    site = tmp_path / "site"
    shutil.copytree(Path(skylight_lighting.__file__).parent, site / "skylight_lighting")
    if place:
        other_skylight(tmp_path / place)
    told = started([tmp_path / "other", site])
    assert told.returncode == 2
    (line,) = told.stderr.splitlines()
    assert line.startswith(f"skylight: {says}")
    assert "pip uninstall skylight" in line


def test_our_own_package_is_run(tmp_path: Path) -> None:
    shutil.copytree(Path(skylight_lighting.__file__).parent, tmp_path / "skylight_lighting")
    (tmp_path / "skylight").mkdir()
    (tmp_path / "skylight" / "__init__.py").touch()
    (tmp_path / "skylight" / "__main__.py").write_text("def main():\n    return 7\n")
    assert started([tmp_path]).returncode == 7


def started(path: list[Path]) -> subprocess.CompletedProcess[str]:
    """What the command's entry point does where packages are found in those folders alone."""
    program = (
        f"import sys; sys.path[:0] = {[str(folder) for folder in path]}\n"
        "from skylight_lighting import main; sys.exit(main())"
    )
    return subprocess.run(
        [sys.executable, "-I", "-S", "-c", program], capture_output=True, text=True
    )
