"""The package's source files and others, parsed once for the rules about them."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "skylight"


def python_files(*folders: str) -> list[Path]:
    """Those of folders at the root, and ``train.py``."""
    return [
        *(p for each in folders for p in sorted((ROOT / each).rglob("*.py"))),
        ROOT / "train.py",
    ]


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))
