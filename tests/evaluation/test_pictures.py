"""Rows of panoramas, and sheets."""

import cv2
import numpy as np
import torch

from skylight.evaluation._pictures import (
    LABEL,
    NAMES,
    ROW,
    SIDE,
    TILE,
    caption,
    captioned_rows,
    panorama_rows,
    write_sheet,
)
from skylight.evaluation._sky_fits import over_ground
from skylight.io._files import write_png

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
    # the same light gives the same row, its name apart
    assert (rows[0, :, SIDE:] == rows[1, :, SIDE:]).all()
    # one white, that of the true sky: half of it is sRGB's code for 0.5
    left_of_the_sun = slice(SIDE, SIDE + ROW)
    assert (rows[0, :ROW, left_of_the_sun] == 255).all()
    assert (rows[2, :ROW, left_of_the_sun] == 188).all()
    scene = slice(SIDE + 4 * ROW, None)
    assert rows[2, :ROW, scene].mean() < 0.9 * rows[0, :ROW, scene].mean()
    for row, name in zip(rows, ("truth", "sunsky", "autoencoder"), strict=True):
        label = row[(ROW - LABEL) // 2 :][:LABEL, :SIDE]
        assert (label == caption(NAMES[name], SIDE)).all()


def test_captions_are_the_words_that_were_asked_for():
    one, same, other = (caption(word, 80) for word in ("sky", "sky", "sun"))
    assert (one == same).all()
    assert (one != other).any()
    assert (one[:, 40:] == 255).all()  # three letters are no longer


def test_labels_fit_their_column():
    truth = a_light(1.0)
    picture = panorama_rows(truth, {name: truth for name in NAMES if name != "truth"})
    margin = picture[:, SIDE - 4 : SIDE]
    assert (margin == 255).all()


def test_skies_of_a_grid_are_all_of_a_size():
    sky = np.zeros((32, 128, 3), np.uint8)
    five = captioned_rows({str(i): sky for i in range(5)}, columns=4, height=TILE)
    eight = captioned_rows({str(i): sky for i in range(8)}, columns=4, height=TILE)
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
    assert (titled[:16, :600] == caption("a sky", 600)).all()
