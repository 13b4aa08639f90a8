"""A printed board has its true size, and is what OpenCV looks for."""

import re
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from skylight._names import Page
from skylight.errors import InputError
from skylight.probes.cameras._board import (
    MARGIN_MM,
    PAGES_MM,
    Board,
    write_board,
)
from skylight.probes.cameras._pose import find_corners

BOARDS = [
    (Board(), "A4"),
    (Board(columns=9, rows=6, square_mm=28.0, marker_mm=20.0, dictionary="DICT_5X5_100"), "A4"),
    (Board(columns=6, rows=7, square_mm=24.0, marker_mm=17.0, first_marker=25), "letter"),
]
PER_MM = 5


def svg_rectangles(path: Path) -> tuple[np.ndarray, tuple[float, float]]:
    """(left, top, width, height) of all black rectangles and the page's size, mm."""
    text = path.read_text()
    size = re.search(
        r'width="([\d.]+)mm" height="([\d.]+)mm" viewBox="0 0 ([\d.]+) ([\d.]+)"', text
    )
    assert size
    assert size[1] == size[3]
    assert size[2] == size[4]
    found = re.findall(r"M([\d.]+) ([\d.]+)h([\d.]+)v([\d.]+)h-[\d.]+z", text)
    return np.array(found, dtype=float), (float(size[1]), float(size[2]))


def pdf_rectangles(path: Path) -> tuple[np.ndarray, tuple[float, float]]:
    data = path.read_bytes()
    box = re.search(rb"/MediaBox \[ *0 0 ([\d.]+) ([\d.]+) *\]", data)
    assert box
    width, height = (float(each) * 25.4 / 72 for each in box.groups())
    for stream in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", data, re.S):
        try:
            content = zlib.decompress(stream).decode("latin-1")
        except zlib.error:
            continue
        corner = r"([-\d.]+) ([-\d.]+) [ml]\s+"
        found = re.findall(corner * 4 + "h", content)
        if found:
            # the first is the white page
            xy = np.array(found[1:], dtype=float).reshape(-1, 4, 2) * 25.4 / 72
            low, high = xy.min(1), xy.max(1)
            top = height - high[:, 1]
            return np.stack([low[:, 0], top, *(high - low).T], 1), (width, height)
    raise AssertionError("no rectangles in the page")


def rasterised(rectangles: np.ndarray, size: tuple[float, float]) -> np.ndarray:
    """The page as pixels, 5 a millimetre, each the mean of 4 x 4 samples."""
    fine = 4 * PER_MM
    page = np.full((round(size[1] * fine), round(size[0] * fine)), 255, dtype=np.uint8)
    for x, y, w, h in rectangles:
        page[round(y * fine) : round((y + h) * fine), round(x * fine) : round((x + w) * fine)] = 0
    small = cv2.resize(page, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    return np.repeat(small[..., None], 3, axis=2)


@pytest.mark.parametrize(("board", "page"), BOARDS)
@pytest.mark.parametrize("ending", ["svg", "pdf"])
def test_all_corners_are_found_at_the_right_millimetres(
    tmp_path: Path, board: Board, page: Page, ending: str
) -> None:
    path = tmp_path / f"board.{ending}"
    write_board(path, board, page)
    rectangles, size = (svg_rectangles if ending == "svg" else pdf_rectangles)(path)
    assert sorted(size) == pytest.approx(sorted(PAGES_MM[page]), abs=1e-3)
    found = find_corners(rasterised(rectangles, size), board)
    assert found is not None
    assert len(found) == (board.columns - 1) * (board.rows - 1)
    printed = (found.pixels + 0.5) / PER_MM
    offset = printed - found.points[:, [0, 2]]
    np.testing.assert_allclose(offset, np.broadcast_to(offset.mean(0), offset.shape), atol=0.05)
    assert offset.mean(0)[1] == pytest.approx(MARGIN_MM, abs=0.05)


@pytest.mark.parametrize("ending", ["svg", "pdf"])
def test_the_ruler_is_100_mm_long_and_inside_the_page(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"board.{ending}"
    write_board(path, Board(columns=3, rows=9, square_mm=27.0, marker_mm=19.0), "A4")
    rectangles, (width, height) = (svg_rectangles if ending == "svg" else pdf_rectangles)(path)
    (bar,) = rectangles[np.isclose(rectangles[:, 2], 100, atol=1e-3)]
    ticks = rectangles[np.isclose(rectangles[:, 3], 3.0, atol=1e-3)]
    assert len(ticks) == 11
    assert ticks[:, 0].min() == pytest.approx(bar[0], abs=1e-3)
    assert (ticks[:, 0] + ticks[:, 2]).max() == pytest.approx(bar[0] + 100, abs=1e-3)
    assert rectangles[:, 0].min() >= MARGIN_MM - 1e-3
    assert (rectangles[:, 0] + rectangles[:, 2]).max() <= width - MARGIN_MM + 1e-3
    assert (rectangles[:, 1] + rectangles[:, 3]).max() <= height - MARGIN_MM


@pytest.mark.parametrize("board", [each for each, _ in BOARDS])
def test_the_pattern_is_opencvs(board: Board) -> None:
    side = 56  # with others, OpenCV's drawing can miss its own picture by a pixel, and fails
    drawn = board.charuco().generateImage((board.columns * side, board.rows * side), marginSize=0)
    fine = side / board.square_mm
    ours = np.full(drawn.shape, 255, dtype=np.uint8)
    for x, y, w, h in board.dark_rectangles() * fine:
        ours[round(y) : round(y + h), round(x) : round(x + w)] = 0
    # OpenCV rounds markers to whole pixels
    assert (cv2.erode(ours, np.ones((3, 3))) > cv2.dilate(drawn, np.ones((3, 3)))).sum() == 0
    assert (cv2.erode(drawn, np.ones((3, 3))) > cv2.dilate(ours, np.ones((3, 3)))).sum() == 0


def test_boards_with_other_markers_are_told_apart() -> None:
    first = Board(columns=5, rows=5)
    second = Board(columns=5, rows=5, first_marker=20)
    page = rasterised(first.dark_rectangles() + np.array([10, 10, 0, 0]), (145, 145))
    assert find_corners(page, first) is not None
    assert find_corners(page, second) is None


def test_the_same_board_is_the_same_file(tmp_path: Path) -> None:
    for name in ("a.pdf", "b.pdf"):
        write_board(tmp_path / name, Board())
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()


def test_a_board_that_does_not_fit_is_refused_with_what_would(tmp_path: Path) -> None:
    board = Board(columns=7, rows=10, square_mm=30.0, marker_mm=21.0)
    with pytest.raises(InputError, match=r"does not fit on A4.*squares 26.7 mm or less"):
        write_board(tmp_path / "a.pdf", board, "A4")
    write_board(tmp_path / "a.pdf", board, "A3")
    assert [path.name for path in tmp_path.iterdir()] == ["a.pdf"]
    largest = Board(columns=7, rows=10, square_mm=26.7, marker_mm=20.0)
    write_board(tmp_path / "b.svg", largest, "A4")


def test_other_endings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="written as"):
        write_board(tmp_path / "a.png", Board())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"columns": 2}, "3 or more"),
        ({"square_mm": 0.0, "marker_mm": 0.0}, "above 0"),
        ({"marker_mm": 24.0}, "0.3 to 0.9"),
        ({"dictionary": "DICT_9X9"}, "unknown marker dictionary"),
        ({"first_marker": 20}, "has 50"),
        ({"first_marker": -1}, "has 50"),
    ],
)
def test_impossible_boards_are_refused(change: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Board(**change)
