"""Printing of a partition probe, and its shading under a light."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.app.figures.exposure import white_of
from skylight.app.probes.partitions.printing import (
    describe_partition_print,
    write_printed_partitions,
)
from skylight.imaging.colour import tone_map
from skylight.io.files import write_png
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.design.designs import design_names, named_design
from skylight.probes.partitions.picture import cell_colours, draw_cells
from skylight.probes.partitions.printed.fitting import AskedSizes
from skylight.probes.partitions.printed.printing import print_fitted
from skylight.probes.partitions.probe import PartitionProbe
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.grid import DirectionGrid
from skylight.studio.tasks.lights import Light, read_light
from skylight.studio.tasks.partition_preview import write_partition_preview
from skylight.studio.tasks.voxel import STARS
from skylight.work.progress import StageProgress

PARTITIONS_ALBEDO = 0.8  # of the white kernel
_SIZE_MM = 80.0
# designs whose narrowest cells need larger shells
_LARGER_MM = {
    "110d": 140.0,
    "14d-outdoor": 130.0,
    "6d-sun-6": 200.0,
    "6d-sun-12": 130.0,
    "6d-tilted-sun-12": 130.0,
    "14d-sun-6": 180.0,
    "14d-sun-12": 130.0,
    "14d-tilted-sun-12": 150.0,
}
_PREVIEW_ROWS = 256
_DIGITS = 4


def describe_designs(*, tell: StageProgress) -> dict[str, Any]:
    """The probes that jobs can make, by name."""
    tell("listing the designs", 0.0)
    designs = {name: named_design(name) for name in design_names()}
    return {
        "voxel": [
            {"probe": size, "title": f"{size}-probe, {what}"} for size, what in STARS.items()
        ],
        "partitions": [
            {
                "name": name,
                "title": f"{name}, {design.count} cells",
                "cells": design.count,
                "size_mm": size_of(name),
            }
            for name, design in designs.items()
        ],
    }


def size_of(design: str) -> float:
    """The diameter of the shell that the named design has where none is named, mm."""
    return _LARGER_MM.get(design, _SIZE_MM)


def make_partition_probe(
    folder: str, design: str, size_mm: float | None, light: Light | None, *, tell: StageProgress
) -> dict[str, Any]:
    """Print files of a named design, and its cells under a light.

    ``size_mm`` is the diameter of the shell, by default :func:`size_of` the design; the other sizes
    are chosen (:func:`~skylight.probes.partitions.printed.fitting.fitted_sizes`).

    Directions are in the design's axes, which for a light are those of its map. Of each cell:
    ``direction`` in which its face looks, ``outline`` (polygons of unit vectors), ``colour`` in
    pictures and, with a light, the ``shading`` of its face and the mean ``radiance`` it tells of.
    """
    out = Path(folder)
    asked = AskedSizes(outer_mm=size_mm)
    printed = print_fitted(named_design(design), asked, progress=tell)
    tell("writing the results", 0.9)
    write_printed_partitions(out, printed)
    write_png(out / "cells.png", draw_cells(printed.cells))
    described = [_described(printed.cells, number) for number in range(printed.cells.count)]
    shading = None
    if light is not None:
        tell("lighting the probe", 0.95)
        environment = read_light(light)
        probe = PartitionProbe(printed.cells, PARTITIONS_ALBEDO).requires_grad_(False)
        shading = probe.encode_map(environment)
        radiance = probe.light(shading)
        for cell, s, value in zip(described, shading.tolist(), radiance.tolist(), strict=True):
            cell |= {"shading": s, "radiance": value}
        _write_lightmap(out / "lightmap.png", environment, probe, shading)
    colours = cell_colours(printed.cells) if shading is None else shading / white_of(shading)
    write_partition_preview(out / "preview.glb", printed, colours.double().numpy())
    return {"design": design, "cells": described, "report": describe_partition_print(printed)}


def _described(cells: Cells, number: int) -> dict[str, Any]:
    mine = torch.nonzero(cells.design.labels == number)[:, 0].tolist()
    return {
        "number": number,
        "solid_angle_sr": float(cells.solid_angles[number]),
        "direction": cells.normals[number].tolist(),
        "outline": [cells.regions[seed].round(decimals=_DIGITS).tolist() for seed in mine],
        "colour": cell_colours(cells)[number].tolist(),
    }


def _write_lightmap(
    path: Path, environment: EnvironmentMap, probe: PartitionProbe, shading: Float[Tensor, "n 3"]
) -> None:
    """The light above, and below it what the probe tells of it, under one exposure."""
    seen = environment.resize(min(_PREVIEW_ROWS, environment.layout[0])).radiance
    larger = max(1, _PREVIEW_ROWS // len(seen))
    seen = seen.repeat_interleave(larger, 0).repeat_interleave(larger, 1)
    grid = DirectionGrid.latlong(len(seen))
    told = probe.decode(shading, grid).clamp(min=0).reshape(seen.shape)
    white = white_of(seen.reshape(-1, 3))
    write_png(path, np.concatenate([tone_map(each, white=white) for each in (seen, told)]))
