"""ChArUco boards: dimensions, printing at true size, files, and a probe's place over one.

A ChArUco board is a chessboard with a marker in every white square (Garrido-Jurado et al. 2014,
"Automatic generation and detection of highly reliable fiducial markers under occlusion"): corners
are as sharp as a chessboard's, and each is known by its neighbours' markers, so that a board may
be partly hidden or out of the picture. All printed probes stand on a pole over such a board.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight._names import Page
from skylight.errors import InputError
from skylight.io._atomic import atomic_path
from skylight.io._bounded import read_number, read_object, read_whole, require_keys, write_json
from skylight.sphere._rotation import RigidTransform
from skylight.transport._rays import Raycaster

PAGES_MM: dict[str, tuple[float, float]] = {  # ISO 216; ANSI/ASME Y14.1
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "letter": (215.9, 279.4),
}
MARGIN_MM = 8.0  # what printers leave blank, and white about the board for the detector
FOOT_MM = 14.0  # ruler and caption below the board
RULER_MM = 100.0
_MOST_SQUARES = 100
_MM_PER_INCH, _POINTS_PER_INCH = 25.4, 72.0
_SIDES = 24  # of the pole, as a prism
Pole = tuple[float, float, float, float]
"""(centre x, centre z, radius, height) of a cylinder, upright on the board, mm."""


@dataclass(frozen=True, kw_only=True)
class Board:
    """A ChArUco board of ``columns`` x ``rows`` squares.

    Its frame is that of a board lying on a table: the origin is the pattern's upper left corner,
    +X runs along the upper edge to the right, +Y out of the paper, +Z towards the lower edge; mm.

    ``first_marker`` is the number of its first marker: boards whose numbers differ can be told
    apart in one picture.
    """

    columns: int = 7
    rows: int = 10
    square_mm: float = 25.0
    marker_mm: float = 18.0
    dictionary: str = "DICT_4X4_50"
    first_marker: int = 0

    def __post_init__(self) -> None:
        if not (self.columns >= 3 and self.rows >= 3):
            raise InputError(
                f"a board needs 3 or more columns and rows, got {self.columns} x {self.rows}"
            )
        if self.columns * self.rows > _MOST_SQUARES**2:
            raise InputError(f"{self.columns} x {self.rows} squares are too many for a board")
        if not (math.isfinite(self.square_mm) and self.square_mm > 0):
            raise InputError(f"the squares' side must be above 0 mm, got {self.square_mm:g}")
        if not 0.3 * self.square_mm <= self.marker_mm <= 0.9 * self.square_mm:
            raise InputError(
                f"a marker must have 0.3 to 0.9 of its square's side ({self.square_mm:g} mm), got "
                f"{self.marker_mm:g} mm"
            )
        if self.dictionary not in dictionaries():
            raise InputError(
                f"unknown marker dictionary {self.dictionary!r}: choose one of "
                f"{', '.join(dictionaries())}"
            )
        has = len(_dictionary(self.dictionary).bytesList)
        if self.first_marker < 0 or self.first_marker + self.markers > has:
            raise InputError(
                f"the board needs {self.markers} markers from number {self.first_marker} on and "
                f"{self.dictionary} has {has}: choose fewer squares or a larger dictionary"
            )

    @property
    def markers(self) -> int:
        """How many white squares, and so markers, there are."""
        return self.columns * self.rows // 2

    @property
    def size_mm(self) -> tuple[float, float]:
        """(width, height) of the pattern."""
        return self.columns * self.square_mm, self.rows * self.square_mm

    def charuco(self) -> "cv2.aruco.CharucoBoard":
        """The same board for OpenCV, whose z axis points into the paper."""
        return cv2.aruco.CharucoBoard(
            (self.columns, self.rows),
            self.square_mm,
            self.marker_mm,
            _dictionary(self.dictionary),
            np.arange(self.first_marker, self.first_marker + self.markers, dtype=np.int32),
        )

    def corners(self) -> Float[np.ndarray, "n 3"]:
        """Inner corners in the board's frame, mm, in the order of OpenCV's numbers."""
        flat = np.asarray(self.charuco().getChessboardCorners(), dtype=np.float64)
        return np.stack([flat[:, 0], np.zeros(len(flat)), flat[:, 1]], 1)

    def dark_rectangles(self) -> Float[np.ndarray, "n 4"]:
        """What is printed black: (left, top, width, height) in mm from the upper left corner."""
        side = self.square_mm
        squares = [
            (column * side, row * side, side, side)
            for row in range(self.rows)
            for column in range(self.columns)
            if (row + column) % 2 == 0
        ]
        cell = self._cell_mm
        cells = [
            (left + start * cell, top + row * cell, count * cell, cell)
            for (left, top), dark in zip(*self._printed_markers(), strict=True)
            for row, values in enumerate(dark)
            for start, count in _runs(values)
        ]
        return np.array(squares + cells, dtype=np.float64)

    def marker_cells(self) -> tuple[Float[np.ndarray, "m k k 3"], Bool[np.ndarray, "m k k"]]:
        """(the middles of all markers' cells in the board's frame, mm; which are printed black).

        Markers are in the order of their numbers; the outermost cells are their black border.
        """
        corners, dark = self._printed_markers()
        middle = (np.arange(dark.shape[1]) + 0.5) * self._cell_mm
        z, x = np.meshgrid(middle, middle, indexing="ij")
        places = np.stack([x, 0 * x, z], -1) + np.insert(corners, 1, 0.0, axis=1)[:, None, None]
        return places, dark

    @property
    def _cell_mm(self) -> float:
        """A marker's bits have a border round them, one cell wide."""
        return self.marker_mm / (_dictionary(self.dictionary).markerSize + 2)

    def _printed_markers(self) -> tuple[Float[np.ndarray, "m 2"], Bool[np.ndarray, "m k k"]]:
        """(upper left corners, mm, which cells are black)."""
        board, dictionary = self.charuco(), _dictionary(self.dictionary)
        bits = dictionary.markerSize
        dark = np.ones((self.markers, bits + 2, bits + 2), dtype=bool)
        for each, number in zip(dark, np.ravel(board.getIds()), strict=True):
            code = dictionary.bytesList[number : number + 1]
            each[1:-1, 1:-1] = cv2.aruco.Dictionary.getBitsFromByteList(code, bits) == 0
        corners = np.array([np.asarray(each)[0, :2] for each in board.getObjPoints()])
        return corners.astype(np.float64), dark


def dictionaries() -> list[str]:
    """Names of OpenCV's marker dictionaries."""
    return sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))


def write_board(path: str | Path, board: Board, page: Page = "A4") -> None:
    """Draw the board in true size on a page, as .svg or .pdf, with a ruler to check the print."""
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in (".svg", ".pdf"):
        raise InputError(f"{path}: a board is written as .pdf or .svg; choose one of them")
    size, origin = _placed(board, page)
    rectangles = board.dark_rectangles() + np.array([*origin, 0.0, 0.0])
    ruler = _ruler(origin[0], origin[1] + board.size_mm[1] + 5.0)
    text_at = (MARGIN_MM, origin[1] + board.size_mm[1] + 13.0)
    dark = np.concatenate([rectangles, ruler])
    draw = _write_svg if kind == ".svg" else _write_pdf
    with atomic_path(path) as temporary:
        draw(temporary, dark, size, text_at, _caption(board))


def save_board(path: str | Path, board: Board) -> None:
    """Write the board's measures as JSON."""
    write_json(path, {"kind": "charuco board", **asdict(board)})


def load_board(path: str | Path) -> Board:
    """The board that :func:`save_board` wrote.

    Raises
    ------
    InputError
        The file is missing or no such file, or its values cannot be.
    """
    content = read_object(path, "charuco board")
    names = [field.name for field in fields(Board)]
    require_keys(path, content, names)
    dictionary = content["dictionary"]
    try:
        if not isinstance(dictionary, str):
            raise InputError(f'"dictionary" must be a name, got {dictionary!r}')
        return Board(
            columns=read_whole(content, "columns"),
            rows=read_whole(content, "rows"),
            square_mm=read_number(content, "square_mm"),
            marker_mm=read_number(content, "marker_mm"),
            dictionary=dictionary,
            first_marker=read_whole(content, "first_marker"),
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _dictionary(name: str) -> "cv2.aruco.Dictionary":
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _runs(row: np.ndarray) -> list[tuple[int, int]]:
    """(start, length) of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
    return [(int(a), int(b - a)) for a, b in edges.reshape(-1, 2)]


def _placed(board: Board, page: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """((page width, height), the pattern's upper left corner on it), mm; turned as the board is."""
    if page not in PAGES_MM:
        raise InputError(f"unknown page {page!r}: choose one of {', '.join(PAGES_MM)}")
    short, long = PAGES_MM[page]
    width, height = board.size_mm
    page_width, page_height = (short, long) if height >= width else (long, short)
    room = page_width - 2 * MARGIN_MM, page_height - 2 * MARGIN_MM - FOOT_MM
    if width > room[0] or height > room[1]:
        side = math.floor(10 * min(room[0] / board.columns, room[1] / board.rows)) / 10
        raise InputError(
            f"the board of {width:g} x {height:g} mm does not fit on {page}, where there is room "
            f"for {room[0]:g} x {room[1]:g} mm: make its squares {side:g} mm or less, take fewer, "
            "or a larger page"
        )
    left = (page_width - width) / 2
    return (page_width, page_height), (min(left, page_width - MARGIN_MM - RULER_MM), MARGIN_MM)


def _ruler(left: float, top: float) -> Float[np.ndarray, "n 4"]:
    """A bar with a tick every 10 mm; the outer edges of the first and last are 100 mm apart."""
    thin = 0.3
    ticks = [
        (left + min(max(at - thin / 2, 0), RULER_MM - thin), top - 3.0, thin, 3.0)
        for at in np.arange(0.0, RULER_MM + 1, 10.0)
    ]
    return np.array([(left, top, RULER_MM, thin), *ticks])


def _caption(board: Board) -> str:
    return (
        f"{RULER_MM:g} mm: measure it, and print again at 100 % if it differs.  {board.columns} x "
        f"{board.rows}, squares {board.square_mm:g} mm, markers {board.marker_mm:g} mm, "
        f"{board.dictionary} from {board.first_marker}"
    )


def _write_svg(
    path: Path,
    dark: Float[np.ndarray, "n 4"],
    size: tuple[float, float],
    text_at: tuple[float, float],
    caption: str,
) -> None:
    width, height = size
    # one path: rectangles of their own would show hairlines between neighbours
    outline = "".join(f"M{x:.6g} {y:.6g}h{w:.6g}v{h:.6g}h{-w:.6g}z" for x, y, w, h in dark)
    path.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}">\n'
        f'<rect width="{width:g}" height="{height:g}" fill="white"/>\n'
        f'<path fill="black" d="{outline}"/>\n'
        f'<text x="{text_at[0]:.6g}" y="{text_at[1]:.6g}" font-family="sans-serif" '
        f'font-size="2.6">{caption}</text>\n</svg>\n',
        encoding="utf-8",
    )


def _write_pdf(
    path: Path,
    dark: Float[np.ndarray, "n 4"],
    size: tuple[float, float],
    text_at: tuple[float, float],
    caption: str,
) -> None:
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    width, height = size
    figure = Figure(figsize=(width / _MM_PER_INCH, height / _MM_PER_INCH), dpi=_POINTS_PER_INCH)
    axes = figure.add_axes((0, 0, 1, 1), frameon=False, xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    x, y, w, h = dark.T
    corners = np.stack([x, y, x + w, y, x + w, y + h, x, y + h, x, y], 1).reshape(-1, 2)
    codes = [Outline.MOVETO, *[Outline.LINETO] * 3, Outline.CLOSEPOLY] * len(dark)
    axes.add_patch(PathPatch(Outline(corners, codes), facecolor="black", linewidth=0, snap=False))
    points = 2.6 / _MM_PER_INCH * _POINTS_PER_INCH
    axes.text(*text_at, caption, fontsize=points, family="sans-serif")
    # without a date, the same board is the same file
    figure.savefig(path, format="pdf", metadata={"CreationDate": None})


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbeAssembly:
    """The pose of a printed probe over its marker board, in mm.

    ``board_mm`` is the width and height of the pattern that it was made for.
    """

    board_from_probe: RigidTransform
    pole_mm: Pole | None
    board_mm: tuple[float, float] | None

    def require_board(self, size_mm: tuple[float, float]) -> None:
        """Refuse a board of another size than the one the probe stands on, where that is known."""
        if self.board_mm is not None and not np.allclose(self.board_mm, size_mm, rtol=0.01):
            has, told = (f"{w:g} x {h:g} mm" for w, h in (self.board_mm, size_mm))
            raise InputError(
                f"the probe stands on a board of {has}, the board's file says {told}: give the "
                "one that was printed"
            )

    def placement_json(self) -> dict[str, object]:
        """What :func:`read_placement` reads."""
        return {
            "rotation": self.board_from_probe.rotation.tolist(),
            "translation_mm": self.board_from_probe.translation.tolist(),
            "pole_mm": None if self.pole_mm is None else list(self.pole_mm),
            "board_mm": None if self.board_mm is None else list(self.board_mm),
        }


def read_placement(content: Mapping[str, object]) -> dict[str, Any]:
    """The fields of a :class:`ProbeAssembly` in an assembly file."""

    def numbers(key: str, *shape: int) -> Float[np.ndarray, "..."]:
        found = np.array(content[key])
        if found.dtype.kind not in "if":  # of texts numpy would make numbers, "inf" among them
            raise TypeError(f"{key}: numbers are needed")
        return found.astype(np.float64).reshape(shape)

    def lengths(key: str, count: int) -> tuple[float, ...] | None:
        if content.get(key) is None:
            return None
        found = numbers(key, count)
        if not (found[-2:] > 0).all():  # radius and height, width and height
            raise ValueError(f"{key}: its last two must be above 0")
        return tuple(found.tolist())

    return {
        "board_from_probe": RigidTransform.from_numpy(
            numbers("rotation", 3, 3), numbers("translation_mm", 3)
        ),
        "pole_mm": lengths("pole_mm", 4),
        "board_mm": lengths("board_mm", 2),
    }


def cylinder_mesh(pole: Pole) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "f 3"]]:
    """(vertices, triangles) of a pole's side, as flat strips."""
    x, z, radius, height = pole
    angle = np.arange(_SIDES) * (2 * np.pi / _SIDES)
    ring = np.stack([x + radius * np.cos(angle), 0 * angle, z + radius * np.sin(angle)], 1)
    i = np.arange(_SIDES)
    j = (i + 1) % _SIDES
    strips = np.concatenate(
        [np.stack([i, j, j + _SIDES], 1), np.stack([i, j + _SIDES, i + _SIDES], 1)]
    )
    return np.concatenate([ring, ring + np.array([0.0, height, 0.0])]), strips


def unoccluded(
    caster: Raycaster, eye: Float[np.ndarray, "3"], points: Float[np.ndarray, "*n 3"]
) -> Float[Tensor, "*n"]:
    """Visibility V: 1 where nothing is between a point of a surface and the eye, 0 elsewhere."""
    flat = torch.from_numpy(points.reshape(-1, 3))
    towards = torch.from_numpy(eye) - flat
    # past the surface the point lies on; the eye is outside of everything
    start = flat + caster.epsilon * towards / towards.norm(dim=1, keepdim=True)
    free = ~caster.occluded(start, towards)
    return free.double().reshape(points.shape[:-1])
