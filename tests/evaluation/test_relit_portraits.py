"""Relit portraits scored against the same people under the other light."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from skimage.color import rgb2lab

from skylight.errors import InputError
from skylight.evaluation import _known_faces as known_faces, _relit_portraits as relit_portraits
from skylight.evaluation._main import run_evaluation
from skylight.evaluation._relit_portraits import (
    RelitPortraits,
    colour_transfer,
    nearest_exposure,
    score,
)
from skylight.faces._observe import observe_face
from skylight.faces._synthetic import SyntheticFace, render_face
from skylight.imaging._colour import linear_to_srgb
from skylight.portrait._relit import portrait_of
from skylight.sphere._envmap import EnvironmentMap
from tests.evaluation.quick import QUICK
from tests.evaluation.rendered import write_face

MASK = np.zeros((24, 32), bool)
MASK[4:20, 6:30] = True


def picture(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(0.35, 0.65, (24, 32, 3)).astype(np.float32)


def test_a_transferred_picture_has_the_statistics_of_the_other() -> None:
    moved = colour_transfer(picture(0), 0.9 * picture(1), MASK)
    own, wanted = rgb2lab(moved)[MASK], rgb2lab(0.9 * picture(1))[MASK]
    np.testing.assert_allclose(own.mean(0), wanted.mean(0), atol=0.3)
    np.testing.assert_allclose(own.std(0), wanted.std(0), rtol=0.03)
    same = colour_transfer(picture(0), picture(0), MASK)
    np.testing.assert_allclose(same, picture(0), atol=1e-4)


def test_the_exposure_of_a_picture_that_is_another_times_a_factor() -> None:
    linear = np.random.default_rng(2).uniform(0.05, 0.9, (24, 32, 3)).astype(np.float32)
    truth = linear_to_srgb(torch.from_numpy(linear)).numpy()
    assert nearest_exposure(0.3 * linear, truth, MASK) == pytest.approx(1 / 0.3, rel=0.03)


def test_what_is_shown_lies_between_black_and_white() -> None:
    shown = relit_portraits._encoded(np.array([-1.0, 0.0, 0.5, 1.0, 2.0]))
    middle = float(linear_to_srgb(torch.tensor(0.5)))
    np.testing.assert_allclose(shown, [0, 0, middle, 1, 1], atol=1e-6)


def test_scores_are_of_the_mask_alone() -> None:
    truth = picture(3)
    other = truth.copy()
    other[:1] = 0  # farther from the mask than a window reaches
    assert score(other, truth, MASK) == pytest.approx({"srgb_rmse": 0.0, "srgb_ssim": 1.0})
    lighter = score(truth + np.float32(0.1), truth, MASK)
    assert lighter["srgb_rmse"] == pytest.approx(0.1, abs=1e-5)
    assert lighter["srgb_ssim"] < 1


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

    mesh = data / "to" / "face0000" / "mesh.npz"
    with np.load(mesh) as arrays:
        np.savez(mesh, **{**arrays, "vertices": arrays["vertices"] + 0.01})
    with pytest.raises(InputError, match="another person"):
        RelitPortraits(data=data)
