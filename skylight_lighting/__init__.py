"""The ``skylight`` command, outside the package that it runs.

Another distribution, ``skylight`` on the public index, installs a package ``skylight`` too. pip
lets each overwrite files of the other, so that what ``import skylight`` finds may be neither.
This module is ours alone; it looks before it imports.
"""

import sys
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path

_MEND = (
    "the two cannot live in one environment: pip uninstall skylight, then "
    "pip install --force-reinstall --no-deps skylight-lighting, or use another environment"
)


def main() -> int:
    """Run one command and return its exit code; 2 where ``skylight`` is another's package."""
    if problem := wrong_package():
        print(f"skylight: {problem}", file=sys.stderr)
        return 2
    from skylight.__main__ import main

    return main()


def wrong_package() -> str:
    """Why ``import skylight`` would not give the package of this distribution, or ""."""
    found = find_spec("skylight")
    if found is None or found.origin is None:  # uninstalled, or a folder without an __init__.py
        return f"Python finds no package skylight; {_MEND}"
    if Path(found.origin).resolve().parents[1] != Path(__file__).resolve().parents[1]:
        return f"Python finds another skylight first, {found.origin}; {_MEND}"
    if version := _other_version():
        return f"skylight {version} is installed over skylight-lighting's files; {_MEND}"
    return ""


def _other_version() -> str:
    """Version of an installed distribution ``skylight`` that owns a package ``skylight``, or "".

    An editable installation owns none, and egg-info of a source tree records nothing.
    """
    try:
        other = distribution("skylight")
    except PackageNotFoundError:
        return ""
    owns = "skylight/__init__.py," in (other.read_text("RECORD") or "")
    return other.version if owns else ""
