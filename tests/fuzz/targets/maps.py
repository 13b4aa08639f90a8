"""Maps of light converted and exported with any options: layouts, turns, scales, lamps, previews.

The options are bytes beside the map, so that what guides the search sees them too.
"""

import shutil
import struct
from typing import get_args

import torch

from skylight._names import Convention, LightTarget, MapLayout
from skylight.errors import InputError
from skylight.io._files import read_environment_map, write_environment_map
from skylight.maps._convert import Adjustment, convert_file
from skylight.maps._export import export_light
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._projections import FACES
from tests.fuzz.files import PLACE, as_file, clear, is_refused, joined, parted, written

_OPTIONS = "options"
_LAYOUTS, _TARGETS, _CONVENTIONS = map(get_args, (MapLayout, LightTarget, Convention))
_CHOICES, _NUMBERS = 8, struct.Struct("<4d")


def seeds() -> list[bytes]:
    light = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(0))
    light[2, 5] = 500.0  # a sun
    square = torch.rand(12, 9, 3, generator=torch.Generator().manual_seed(1))
    wide = torch.rand(16, 64, 3, generator=torch.Generator().manual_seed(2))
    header: dict[str, object] = {"whiteLuminance": 250.0}

    def write(name: str, radiance: torch.Tensor, **more: object) -> bytes:
        lit = EnvironmentMap(radiance=radiance)
        return written(name, lambda path: write_environment_map(path, lit, **more))

    maps = [write("a.hdr", light), write("b.exr", light, header=header, half=True)]
    maps += [write("c.hdr", wide), write("d.hdr", square[:4, :8].repeat(2, 2, 1))]
    found = []
    for number in range(len(_LAYOUTS)):
        choices = bytes([number, 0, number % 7, number % 6, number % 4, 8, number % 2, 0])
        told = choices + _NUMBERS.pack(30.0 * number, 10.0 * (number % 3), 0.0, 2.0)
        found.append(joined({_OPTIONS: told, "map": maps[number % len(maps)]}))
    return found


def read(content: bytes) -> None:
    members = parted(content)
    told = members.get(_OPTIONS, b"").ljust(_CHOICES + _NUMBERS.size, b"\0")
    to, from_, target, convention, lamps, height, half, name = told[:_CHOICES]
    turns = _NUMBERS.unpack_from(told, _CHOICES)
    layout, was = _LAYOUTS[to % len(_LAYOUTS)], _LAYOUTS[from_ % len(_LAYOUTS)]
    suffix = (".hdr", ".exr", ".pic", ".tif")[name % 4]
    source = out = as_file(members.get("map", b""), f"map{suffix}")
    if was == "cube-faces":
        source = PLACE / "faces"
        shutil.rmtree(source, ignore_errors=True)  # of another suffix
        source.mkdir()
        for side in FACES:
            shutil.copyfile(out, source / f"{side}{suffix}")
    several = layout == "cube-faces"
    out = PLACE / ("out_{}.hdr" if several else "out.exr" if half & 1 else "out.hdr")
    refusals = [
        is_refused(
            lambda: convert_file(
                source,
                out,
                projection=layout,
                convention=_CONVENTIONS[convention % len(_CONVENTIONS)],
                source_projection=was,
                adjustment=Adjustment(
                    rotate_deg=turns[0], pitch_deg=turns[1], roll_deg=turns[2], factor=turns[3]
                ),
                height=height or None,
                half=bool(half & 1),
                preview_file=PLACE / "preview.png" if half & 2 else None,
            )
        )
    ]
    if not refusals[0] and layout == "latlong":
        light = read_environment_map(out).radiance
        assert bool(light.isfinite().all())
        assert bool((light >= 0).all())
    if was == "latlong":
        refusals.append(
            is_refused(
                lambda: export_light(
                    source,
                    PLACE / "exported",
                    [_TARGETS[target % len(_TARGETS)]],
                    convention=_CONVENTIONS[convention % len(_CONVENTIONS)],
                    lamps=lamps % 11 if lamps else None,
                )
            )
        )
    if all(refusals):
        raise InputError(clear(InputError("refused by all")))
