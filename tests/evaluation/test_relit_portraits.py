"""Relit portraits scored against the same people under the other light."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.evaluation import _known_faces as known_faces, _relit_portraits as relit_portraits
from skylight.evaluation._main import run_evaluation
from skylight.evaluation._relit_portraits import RelitPortraits
from skylight.faces._observe import observe_face
from skylight.faces._synthetic import SyntheticFace, render_face
from skylight.portrait._relit import portrait_of
from skylight.sphere._envmap import EnvironmentMap
from tests.evaluation.quick import QUICK
from tests.evaluation.rendered import write_face


def test_folders_are_checked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no folder from"):
        RelitPortraits(data=tmp_path)
    (tmp_path / "from").mkdir()
    with pytest.raises(InputError, match="--light-seed"):
        RelitPortraits(data=tmp_path)


def a_person(column: int) -> SyntheticFace:
    """Under a lamp on that column of 16."""
    light = torch.full((32, 64, 3), 0.05)
    light[8:12, 4 * column : 4 * column + 4] = 20
    sky = EnvironmentMap(radiance=light)
    return render_face(sky, torch.full((3,), 0.1), seed=3, size=144, azimuth_rad=0.0, light_rows=8)


def test_people_are_relit_and_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From as few pixels as show a face."""
    monkeypatch.setattr(known_faces, "observe_face", partial(observe_face, face_height_px=36))
    monkeypatch.setattr(relit_portraits, "portrait_of", partial(portrait_of, face_px=32))
    data = tmp_path / "faces"
    for folder, column in (("from", 0), ("to", 3)):  # behind the camera, and at its left
        write_face(data / folder, 0, a_person(column))
    evaluation = RelitPortraits(data=data, options=QUICK)
    results = run_evaluation(evaluation, tmp_path / "out", command="c")
    rows = json.loads(results.read_text())["rows"]
    assert set(rows) == {
        "relit",
        "relit_true_light",
        "relit_true_head",
        "relit_true_light_and_head",
        "relit_without_shell",
        "transfer",
        "unchanged",
    }
    rmse = {name: row["srgb_rmse_skin"]["mean"] for name, row in rows.items()}
    assert rmse["relit_true_light"] < rmse["unchanged"]
    assert (tmp_path / "out" / "sheet.png").is_file()
    checks = json.loads(results.read_text())["checks"]
    blotch = [rows[name]["blotch"]["mean"] for name in ("relit", "transfer")]  # of the one face
    assert checks["largest blotch over that of transfer"]["value"] == pytest.approx(
        blotch[0] / blotch[1]
    )

    mesh = data / "to" / "face0000" / "mesh.npz"
    with np.load(mesh) as arrays:
        np.savez(mesh, **{**arrays, "vertices": arrays["vertices"] + 0.01})
    with pytest.raises(InputError, match="another person"):
        RelitPortraits(data=data)
