"""Collections of maps: a folder with an ``index.csv`` of files and categories."""

import csv
from io import StringIO
from pathlib import Path

from skylight.errors import InputError
from skylight.io.bounded import file_text

INDEX_NAME = "index.csv"
_COLUMNS = ("file", "category")


def names_categories(folder: Path) -> bool:
    """Whether the folder has an ``index.csv`` whose first line names file and category.

    Raises
    ------
    InputError
        There is one that is damaged.
    """
    path = folder / INDEX_NAME
    if not path.is_file():
        return False
    try:
        text = file_text(path)
        if not text.strip("\0\r\n "):  # also what a crash leaves of a file
            raise ValueError("it is empty")
        return set(_COLUMNS) <= set(next(csv.reader(StringIO(text, newline=""))))
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(
            f"{path}: cannot be read as CSV ({error}); mend it, or move it away"
        ) from error


def read_categories(folder: Path) -> dict[str, str]:
    """File -> category, in the order of the index.

    Raises
    ------
    InputError
        No readable ``index.csv`` with the columns file and category.
    """
    path = folder / INDEX_NAME
    try:
        reader = csv.DictReader(StringIO(file_text(path), newline=""))
        if not set(_COLUMNS) <= set(reader.fieldnames or ()):
            raise ValueError("its first line names others")
        rows = list(reader)
        if any(row["file"] is None or row["category"] is None for row in rows):
            raise ValueError("a row is too short")
        return {row["file"]: row["category"] for row in rows}
    except (OSError, KeyError, ValueError, csv.Error) as error:
        raise InputError(
            f"{path}: cannot be read as an index of maps with columns file and category ({error}); "
            "mend it, or move it away"
        ) from error
