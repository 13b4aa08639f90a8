"""Rows of panoramas, and sheets."""

import cv2
import numpy as np
import torch

from skylight.evaluation.pictures import NAMES, ROW, SIDE, panorama_rows, sky_grid, write_sheet
from skylight.evaluation.sky_fits import over_ground
from skylight.imaging.files import write_png

GROUND = torch.tensor([0.1, 0.1, 0.1])


def a_light(level: float):
    sky = torch.full((32, 128, 3), level)
    sky[10, 64] = 300 * level
    return over_ground(sky, GROUND)


def test_a_row_for_the_truth_and_each_estimate_under_one_white():
    truth = a_light(1.0)
    picture = panorama_rows(truth, {"sunsky": truth, "autoencoder": a_light(0.5)})
    rows = picture.reshape(3, ROW + 4, -1, 3)
    assert picture.shape[1] == SIDE + 4 * ROW + ROW * 4 // 3
    # the same light gives the same row, its name apart; half the light a darker one
    assert (rows[0, :, SIDE:] == rows[1, :, SIDE:]).all()
    sky, scene = slice(SIDE, SIDE + 4 * ROW), slice(SIDE + 4 * ROW, None)
    for part in (sky, scene):
        assert rows[2, :ROW, part].mean() < 0.9 * rows[0, :ROW, part].mean()
    # on the left there is something written, and not the same
    labels = rows[:, :ROW, :SIDE]
    assert all((label < 128).sum() > 100 for label in labels)
    assert not (labels[0] == labels[1]).all()


def test_labels_fit_their_column():
    truth = a_light(1.0)
    picture = panorama_rows(truth, {name: truth for name in NAMES if name != "truth"})
    margin = picture[:, SIDE - 4 : SIDE]
    assert (margin == 255).all()


def test_skies_of_a_grid_are_all_of_a_size():
    sky = np.zeros((32, 128, 3), np.uint8)
    five = sky_grid({str(i): sky for i in range(5)})
    eight = sky_grid({str(i): sky for i in range(8)})
    assert five.shape == eight.shape


def test_a_sheet_has_as_many_columns_as_fit(tmp_path):
    paths = []
    for i in range(4):
        paths.append(tmp_path / f"{i}.png")
        write_png(paths[-1], np.full((50, 600, 3), 10 * i, np.uint8))
    write_sheet(tmp_path / "sheet.png", [*paths, tmp_path / "none.png"])
    sheet = cv2.imread(str(tmp_path / "sheet.png"))
    assert sheet.shape == (2 * 54, 3 * 604, 3)
    assert [int(sheet[y, x, 0]) for y, x in ((0, 0), (0, 604), (0, 1208), (54, 0))] == [
        0,
        10,
        20,
        30,
    ]
    write_sheet(tmp_path / "titled.png", paths[:1], ["a sky"])
    titled = cv2.imread(str(tmp_path / "titled.png"))
    assert titled.shape == (50 + 16 + 4, 604, 3)
    assert (titled[:16] < 128).any()
