"""Files of boards, lenses and responses: there and back, and what is refused."""

import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skylight.errors import InputError
from skylight.probes.cameras._board import Board, load_board, save_board
from skylight.probes.cameras._intrinsics import load_intrinsics, save_intrinsics
from skylight.probes.cameras._response import Response, load_response, save_response
from tests.probes.cameras.scenes import LENS

CURVE = np.stack([np.linspace(0, 1, 300) ** k for k in (1, 2, 3)])
MISSING = object()
FILES: dict[str, tuple[Callable[..., None], Callable[[Path], Any], list[Any]]] = {
    "board": (save_board, load_board, [Board(), Board(columns=5, rows=4, first_marker=20)]),
    "camera": (save_intrinsics, load_intrinsics, [LENS]),
    "response": (
        save_response,
        load_response,
        [Response(), Response(kind="gamma", gamma=2.2), Response(kind="curve", curve=CURVE)],
    ),
}


@pytest.mark.parametrize("kind", FILES)
def test_there_and_back(tmp_path: Path, kind: str) -> None:
    save, load, values = FILES[kind]
    for value in values:
        save(tmp_path / "a.json", value)
        found = load(tmp_path / "a.json")
        for field in fields(value):
            expected = getattr(value, field.name)
            np.testing.assert_array_equal(getattr(found, field.name), expected)


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        ("board", {"columns": 7.5}, '"columns"'),
        ("board", {"dictionary": 4}, '"dictionary"'),
        ("board", {"rows": 1}, "3 or"),
        ("camera", {"fx": "wide"}, '"fx" must be a number'),
        ("camera", {"fx": -3.0}, "above 0"),
        ("camera", {"fx": 90.0}, "differ too much"),
        ("camera", {"width": 1.5}, '"width"'),
        ("camera", {"k1": None}, '"k1"'),
        ("camera", {"k1": MISSING}, '"k1" is missing'),
        ("response", {"response": "log"}, "unknown response"),
        ("response", {"response": "gamma"}, '"gamma" is missing'),
        ("response", {"response": "gamma", "gamma": "2"}, '"gamma" must be a number'),
        ("response", {"response": "curve", "curve": [1, 2]}, "three rows"),
        ("response", {"response": "curve", "curve": [[1], [1, 2]]}, "three rows"),
        ("response", {"response": MISSING}, '"response" is missing'),
    ],
)
def test_impossible_values_are_refused(
    tmp_path: Path, kind: str, change: dict[str, object], message: str
) -> None:
    save, load, values = FILES[kind]
    path = tmp_path / "a.json"
    save(path, values[0])
    content = json.loads(path.read_text()) | change
    path.write_text(json.dumps({key: v for key, v in content.items() if v is not MISSING}))
    with pytest.raises(InputError, match=message):
        load(path)


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize(
    ("text", "message"),
    [(None, "cannot read"), ("{", "no JSON"), ('{"kind": "something else"}', "no .* file")],
)
def test_other_files_are_refused(tmp_path: Path, kind: str, text: str | None, message: str) -> None:
    path = tmp_path / "a.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=message):
        FILES[kind][1](path)
