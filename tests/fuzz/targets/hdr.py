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
    return [
        written("a.hdr", lambda path: write_environment_map(path, EnvironmentMap(radiance=light))),
        written("b.hdr", lambda path: cv2.imwrite(str(path), wide)),
    ]


def read(content: bytes) -> None:
    light = read_environment_map(as_file(content, "light.hdr")).radiance
    assert bool(light.isfinite().all())
    assert bool((light >= 0).all())
