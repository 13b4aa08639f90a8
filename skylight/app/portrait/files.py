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
    """A .png (8-bit sRGB, with a line below it where there is a warning) or a linear .exr."""
    if path.suffix.lower() == ".exr":
        write_light(path, torch.from_numpy(relit.picture), header={})
        return
    codes = shown(relit)
    write_png(path, np.concatenate([codes, _strip(relit.warning, codes.shape[1])]))


def _strip(text: str, width: int) -> UInt8[ndarray, "h {width} 3"]:
    """A line of text as wide as the picture; no rows where there is none."""
    if not text:
        return np.zeros((0, width, 3), np.uint8)
    size = max(10, min(width // 40, 28))
    font = ImageFont.load_default(size)
    picture = Image.new("RGB", (width, 2 * size), (40, 40, 40))
    ImageDraw.Draw(picture).text((size / 2, size / 2), text, (255, 210, 63), font)
    return np.array(picture)
