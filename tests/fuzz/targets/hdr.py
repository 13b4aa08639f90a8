"""Radiance RGBE: maps of light."""

import cv2
import numpy as np
import torch

from skylight.io._files import read_environment_map, write_environment_map
from skylight.sphere._envmap import EnvironmentMap
from tests.fuzz.files import as_file, written


def seeds() -> list[bytes]:
    light = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(0))
    wide = np.repeat(light.numpy(), 2, axis=1)[:8, :32]  # runs, in OpenCV's own encoding
    declared = "EXPOSURE=2\nCOLORCORR=2 1 0.5\nGAMMA=2.2\nPRIMARIES=.7 .3 .2 .7 .1 .1 .31 .33\n"
    old = b"\x40\x30\x20\x80\x01\x01\x01\x1f" * 4  # a pixel and a run
    return [
        f"#?RADIANCE\n{declared}\n+X 16 -Y 8\n".encode() + old,
        b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n+Y 8 -X 16\n" + old,
        written("a.hdr", lambda path: write_environment_map(path, EnvironmentMap(radiance=light))),
        written("b.hdr", lambda path: cv2.imwrite(str(path), wide)),
    ]


def read(content: bytes) -> None:
    light = read_environment_map(as_file(content, "light.hdr"), repair=True).radiance
    assert bool(light.isfinite().all())
    assert bool((light >= 0).all())
