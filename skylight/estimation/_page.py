"""A page of pictures and words, drawn by OpenCV and Pillow: what a report is made of.

matplotlib draws the same in three times the time, and takes as long again to be imported, which
is much of an estimate.
"""

import importlib.util
import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageColor, ImageDraw, ImageFont

from skylight._figures import ACCENT, INK
from skylight.errors import AssetError
from skylight.io._atomic import atomic_path

BORDER = "#c5ccd3"
SIZE, SMALL, TITLE = 17.5, 16.0, 19.2  # letters, pixels an em
_FINE = 16  # parts of a pixel in which OpenCV places lines
_FROM_TOP = 10  # pixels from a title's foot to what is under it


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Where a picture is on a page: its upper left corner, and page pixels for each of its own."""

    left: float
    top: float
    width: float
    height: float
    scale: float

    def at(self, column: float, row: float) -> tuple[float, float]:
        """(x, y) on the page of a place of the picture: whole numbers are centres of pixels."""
        return self.left + (column + 0.5) * self.scale, self.top + (row + 0.5) * self.scale


@dataclass(frozen=True, kw_only=True)
class Words:
    """A line of text: ``anchor`` is Pillow's, which part of it is at x, y."""

    x: float
    y: float
    text: str
    size: float
    color: str
    bold: bool
    anchor: str


class Page:
    """A white page; places are pixels from its upper left corner.

    Pictures and lines are drawn at once, later ones over earlier ones; ``words`` come last, over
    all of them. ``panels`` are the pictures that have a title.
    """

    def __init__(self, width: int, height: int) -> None:
        self.canvas: UInt8[np.ndarray, "h w 3"] = np.full((height, width, 3), 255, np.uint8)
        self.words: list[Words] = []
        self.panels: dict[str, Panel] = {}

    def write(
        self,
        x: float,
        y: float,
        text: str,
        *,
        size: float = SIZE,
        color: str = INK,
        bold: bool = False,
        anchor: str = "ls",
    ) -> None:
        """Text with its left (``anchor`` "ls") or right end ("rs") on its foot at x, y."""
        self.words.append(
            Words(x=x, y=y, text=text, size=size, color=color, bold=bold, anchor=anchor)
        )

    def show(
        self,
        picture: UInt8[np.ndarray, "h w 3"],
        title: str,
        *,
        box: tuple[float, float, float, float],
        smooth: bool = False,
    ) -> Panel:
        """A picture, as large as fits into ``box`` (left, top, width, height), under its title.

        Enlarged pixels are squares, or blend where they are ``smooth``.
        """
        left, top, most_wide, most_high = box
        height, width = picture.shape[:2]
        scale = min(most_wide / width, most_high / height)
        size = max(1, round(scale * width)), max(1, round(scale * height))
        larger = cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST
        how = cv2.INTER_AREA if scale < 1 else larger
        x, y = round(left), round(top)
        shown = cv2.resize(np.ascontiguousarray(picture), size, interpolation=how)
        self.canvas[y : y + size[1], x : x + size[0]] = shown
        corner = (x + size[0] - 1, y + size[1] - 1)
        cv2.rectangle(self.canvas, (x, y), corner, ImageColor.getrgb(BORDER), 1)
        panel = Panel(
            left=float(x),
            top=float(y),
            width=float(size[0]),
            height=float(size[1]),
            scale=size[0] / width,
        )
        self.title(panel.left, panel.top, title)
        self.panels[title] = panel
        return panel

    def title(self, x: float, y: float, text: str) -> None:
        """Over what begins at x, y."""
        self.write(x, y - _FROM_TOP, text, size=TITLE, bold=True)

    def line(
        self,
        points: Sequence[tuple[float, float]] | Float[np.ndarray, "k 2"],
        color: str,
        width: int,
        *,
        closed: bool = False,
    ) -> None:
        """Through points, smoothed at its rims."""
        corners = np.round((np.asarray(points, dtype=float) - 0.5) * _FINE).astype(np.int32)
        cv2.polylines(
            self.canvas, [corners], closed, ImageColor.getrgb(color), width, cv2.LINE_AA, 4
        )

    def ring(self, x: float, y: float, radius: float, color: str, width: int) -> None:
        """Smoothed at its rims."""
        centre = round((x - 0.5) * _FINE), round((y - 0.5) * _FINE)
        cv2.circle(
            self.canvas,
            centre,
            round(radius * _FINE),
            ImageColor.getrgb(color),
            width,
            cv2.LINE_AA,
            4,
        )

    def label(
        self, x: float, y: float, text: str, *, side: Literal["left", "right"], size: float
    ) -> None:
        """Bold white letters on a plate whose left or right ``side`` is at x, its middle at y."""
        wide = font(size, bold=True).getlength(text)
        left = x if side == "left" else x - wide
        high, rim = 0.62 * size, 0.25 * size
        low, far = (round(left - rim), round(y - high)), (round(left + wide + rim), round(y + high))
        cv2.rectangle(self.canvas, low, far, ImageColor.getrgb(ACCENT), -1)
        self.write(left, y, text, size=size, color="white", bold=True, anchor="lm")

    def save(self, path: Path) -> None:
        """As PNG, whole or not at all."""
        image = Image.fromarray(self.canvas)
        draw = ImageDraw.Draw(image)
        for each in self.words:
            letters = font(each.size, bold=each.bold)
            draw.text((each.x, each.y), each.text, each.color, letters, anchor=each.anchor)
        drawn = io.BytesIO()  # so that only the disk can fail while the file is open
        # the default level takes twice as long for 12 % less
        image.save(drawn, "PNG", compress_level=3)
        with atomic_path(path) as temporary:
            temporary.write_bytes(drawn.getvalue())


@cache
def font(size: float, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """DejaVu Sans, which comes with matplotlib; that is looked up and not imported."""
    found = importlib.util.find_spec("matplotlib")
    if found is None or found.origin is None:
        raise AssetError("matplotlib is not installed, whose letters reports take")
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    file = Path(found.origin).parent / "mpl-data" / "fonts" / "ttf" / name
    try:
        return ImageFont.truetype(str(file), size, layout_engine=ImageFont.Layout.BASIC)
    except OSError as error:
        raise AssetError(f"{file} cannot be read ({error}); reinstall matplotlib") from error
