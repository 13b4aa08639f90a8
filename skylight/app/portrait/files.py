"""Relit portraits as files."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8
from numpy import ndarray
from PIL import Image, ImageDraw, ImageFont

from skylight.app.portrait.relit import RelitPortrait, shown
from skylight.io.files import write_light, write_png


def write_relit(path: Path, relit: RelitPortrait) -> None:
    """A .png (8-bit sRGB, with lines below it where there is a warning) or a linear .exr."""
    if path.suffix.lower() == ".exr":
        write_light(path, torch.from_numpy(relit.picture), header={})
        return
    codes = shown(relit)
    write_png(path, np.concatenate([codes, _strip(relit.warning, codes.shape[1])]))


def _strip(text: str, width: int) -> UInt8[ndarray, "h {width} 3"]:
    """The text below a picture of that width, in as many lines as it takes; no rows without any."""
    if not text:
        return np.zeros((0, width, 3), np.uint8)
    size = max(10, min(width // 40, 28))
    font = ImageFont.load_default(size)
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if font.getlength(longer) > width - size and lines[-1]:
            lines.append(word)
        else:
            lines[-1] = longer
    picture = Image.new("RGB", (width, round((1.25 * len(lines) + 0.75) * size)), (40, 40, 40))
    draw, spacing = ImageDraw.Draw(picture), 1.25 * size
    for number, line in enumerate(lines):
        draw.text((size / 2, size / 2 + number * spacing), line, (255, 210, 63), font)
    return np.array(picture)
