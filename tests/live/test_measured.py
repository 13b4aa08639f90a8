"""The tool that measures the live light: what it records, and what it says where there is none."""

import json
import sys
from pathlib import Path

import pytest

from tests.evaluation.rendered import write_face
from tests.sunny_face import sunny_face
from tools import measure_live_light


def measure(monkeypatch: pytest.MonkeyPatch, *words: object) -> None:
    monkeypatch.setattr(sys, "argv", ["measure_live_light", *map(str, words)])
    measure_live_light.main()


def test_the_whole_command_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    faces, kept, out = tmp_path / "faces", tmp_path / "kept", tmp_path / "out.json"
    write_face(faces, 0, sunny_face(140.0, 50.0))
    kept.mkdir()
    (kept / "face0000.json").write_text("[0.0, 0.0, 1.0]")
    measure(monkeypatch, faces, "--least-share", 0.05, "--estimates", kept, "--out", out)
    told = json.loads(out.read_text())
    assert told["command"] == (
        "python -m tools.measure_live_light faces --least-share 0.05 --estimates kept"
    )
    assert (told["faces"], told["with_light"]) == (1, 1)
    assert told["error_deg"] < 30 < told["estimate_error_deg"]


@pytest.mark.parametrize(
    ("is_empty", "line"), [(True, "no rendered faces"), (False, "render more, or lower")]
)
def test_nothing_to_measure_is_a_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    is_empty: bool,
    line: str,
) -> None:
    if not is_empty:
        write_face(tmp_path, 0, sunny_face(140.0, 50.0))
    with pytest.raises(SystemExit):
        measure(monkeypatch, tmp_path, "--least-share", 2, "--out", tmp_path / "out.json")
    assert line in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "out.json").exists()
