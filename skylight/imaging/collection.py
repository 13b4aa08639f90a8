"""Collections of maps: a folder with an ``index.csv`` that says what each map shows."""

import csv
from pathlib import Path

from skylight.errors import InputError

INDEX_NAME = "index.csv"


def read_categories(folder: Path) -> dict[str, str]:
    """File -> category, in the order of the index.

    Raises
    ------
    InputError
        No readable ``index.csv`` with the columns file and category.
    """
    path = folder / INDEX_NAME
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            return {row["file"]: row["category"] for row in csv.DictReader(stream)}
    except (OSError, KeyError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(
            f"{path}: cannot be read as an index of maps with columns file and category ({error})"
        ) from error
