"""OpenEXR: maps of light, and linear photographs."""

import numpy as np
import OpenEXR
import torch

from skylight.io._files import read_environment_map, write_environment_map
from skylight.skies._captures import header_date
from skylight.sphere._envmap import EnvironmentMap
from tests.fuzz.files import as_file, written


def seeds() -> list[bytes]:
    light = EnvironmentMap(
        radiance=torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(0))
    )
    made = [
        written("a.exr", lambda path: write_environment_map(path, light)),
        written("b.exr", lambda path: write_environment_map(path, light, half=True)),
    ]
    pixels = light.radiance.numpy()
    for compression in (OpenEXR.NO_COMPRESSION, OpenEXR.PIZ_COMPRESSION, OpenEXR.RLE_COMPRESSION):
        header = {"compression": compression, "type": OpenEXR.scanlineimage}
        file = OpenEXR.File(header, {"RGB": np.ascontiguousarray(pixels)})
        made.append(written("c.exr", lambda path, file=file: file.write(str(path))))
    header = {"type": OpenEXR.scanlineimage, "colorInteropID": "srgb_ap1_scene"}
    layers = {f"a.b.{c}": pixels[..., k].copy() for k, c in enumerate("RGB")}
    layered = OpenEXR.File(header, {**layers, "N.X": pixels[..., 0].copy()})
    made.append(written("d.exr", lambda path: layered.write(str(path))))
    return made


def read(content: bytes) -> None:
    path = as_file(content, "light.exr")
    header_date(path)
    light = read_environment_map(path, repair=True).radiance
    assert bool(light.isfinite().all())
    assert bool((light >= 0).all())
