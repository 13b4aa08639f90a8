"""Visible files of a folder by suffix."""

from collections.abc import Collection
from pathlib import Path


def visible_files(
    folder: Path, suffixes: Collection[str], *, recursive: bool = False
) -> list[Path]:
    """Files in ``folder``, or below it, whose suffix in lower case is one of ``suffixes``; sorted.

    Hidden ones and those in hidden folders are left out: so are called what a run that was killed
    left half written (:func:`skylight.io.atomic.atomic_path`), and what systems put beside
    pictures (``._me.jpg``).
    """
    return sorted(
        path
        for path in (folder.rglob("*") if recursive else folder.iterdir())
        if path.suffix.lower() in suffixes
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
        and path.is_file()
    )
