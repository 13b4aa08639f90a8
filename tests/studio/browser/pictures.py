"""What a page shows, as arrays."""

import base64
import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from PIL import Image

from skylight.imaging._colour import linear_to_srgb
from tests.studio.browser.waiting import gathered

if TYPE_CHECKING:
    from playwright.sync_api import Locator, Page

# the documentation's pictures are worth waiting for: of the best light, with all of it in
FOR_DOCUMENTATION = "SKYLIGHT_STUDIO_PICTURES" in os.environ


def pixels(page: "Page", selector: str) -> np.ndarray:
    """A canvas' or a picture's pixels, (h, w, 4)."""
    url = page.evaluate(
        """async selector => {
            const shown = document.querySelector(selector);
            const copy = document.createElement("canvas");
            copy.width = shown.naturalWidth ?? shown.width;
            copy.height = shown.naturalHeight ?? shown.height;
            copy.getContext("2d").drawImage(shown, 0, 0);
            return copy.toDataURL();
        }""",
        selector,
    )
    content = base64.b64decode(url.partition(",")[2])
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGBA")).astype(int)


def photo_pixels(page: "Page") -> np.ndarray:
    """The preview as the browser decodes it, (h, w, 3)."""
    return pixels(page, ".photo img")[..., :3]


def codes(linear: Any) -> np.ndarray:
    """8-bit codes of linear light."""
    value = torch.as_tensor(np.asarray(linear, dtype=np.float64))
    return (255 * linear_to_srgb(value.clamp(0, 1))).numpy()


def finished(page: "Page", share: float) -> np.ndarray:
    """The picture with the object, once at least this share of its light is in."""
    gathered(page, share)
    return pixels(page, "canvas.composite")


def picture(shown: "Page | Locator", path: Path) -> None:
    """A screenshot as the documentation has it: 900 pixels wide at most, of 256 colours."""
    full = Image.open(io.BytesIO(shown.screenshot())).convert("RGB")
    full.thumbnail((900, 2000), Image.Resampling.LANCZOS)
    palette = full.quantize(256)
    full.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG).save(path, optimize=True)
