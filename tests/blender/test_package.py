"""The extension as a package: its manifest, its licence, and what it imports."""

import ast
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pytest

from tools import build_blender_extension as build

MANIFEST = tomllib.loads((build.SOURCE / build.MANIFEST).read_text())
WITHOUT_BLENDER = {"__init__", "run", "commands", "scene_file", "wording"}


def test_the_manifest_is_whole() -> None:
    assert list(build.faults(MANIFEST)) == []
    assert MANIFEST["license"] == ["SPDX:GPL-3.0-or-later"]
    assert MANIFEST["blender_version_min"] == "4.2.0"


@pytest.mark.parametrize(
    ("changed", "fault"),
    [
        ({"name": " x"}, '"name"'),
        ({"tagline": "It ends."}, '"tagline"'),
        ({"tagline": "x" * 65}, '"tagline"'),
        ({"version": "0.1"}, '"version"'),
        ({"version": "0.01.0"}, '"version"'),
        ({"schema_version": "2.0.0"}, '"schema_version"'),
        ({"id": "a__b"}, '"id"'),
        ({"id": "a-b"}, '"id"'),
        ({"id": "b_"}, '"id"'),
        ({"type": "addon"}, '"type"'),
        ({"license": []}, '"license"'),
        ({"license": ["GPL"]}, '"license"'),
        ({"permissions": {"disk": "Read it"}}, 'permission "disk"'),
        ({"permissions": {"files": "Read it."}}, '"files"'),
        ({"colour": "red"}, '"colour" is not known'),
    ],
)
def test_what_blender_would_refuse_is_found(changed: dict[str, Any], fault: str) -> None:
    found = list(build.faults(MANIFEST | changed))
    assert len(found) == 1
    assert found[0].startswith(fault)


def test_what_is_missing_is_found() -> None:
    assert list(build.faults({})) == [f'"{name}" is missing' for name in build.REQUIRED]


def test_the_zip_has_the_sources_alone_and_the_same_bytes_again(tmp_path: Path) -> None:
    one, other = tmp_path / "one.zip", tmp_path / "other.zip"
    build.pack(one)
    build.pack(other)
    assert one.read_bytes() == other.read_bytes()
    with zipfile.ZipFile(one) as archive:
        names = set(archive.namelist())
        assert archive.read("LICENSE").startswith(b"                    GNU GENERAL PUBLIC")
    modules = {path.name for path in build.SOURCE.glob("*.py")}
    assert names == {"LICENSE", build.MANIFEST, *modules}


@pytest.mark.parametrize("path", sorted(build.SOURCE.glob("*.py")), ids=lambda path: path.stem)
def test_modules_stand_alone(path: Path) -> None:
    """Under the GPL, without skylight; bpy only where Blender is needed."""
    text = path.read_text()
    assert text.startswith("# SPDX-License-Identifier: GPL-3.0-or-later\n")
    roots, near = set(), set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            roots |= {name.name.partition(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            if node.level == 0:
                roots.add(str(node.module).partition(".")[0])
            else:
                assert node.level == 1
                near |= {node.module} if node.module else {name.name for name in node.names}
    blenders = set() if path.stem in WITHOUT_BLENDER else {"bpy", "mathutils"}
    assert roots <= sys.stdlib_module_names | blenders
    if path.stem in WITHOUT_BLENDER - {"__init__"}:
        assert near <= WITHOUT_BLENDER
