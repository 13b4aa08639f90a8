"""Printing of voxel and partition probes, and what they would show under a light."""

import re
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight._figures import white_of
from skylight.imaging._colour import tone_map
from skylight.io._atomic import atomic_path
from skylight.io._files import write_png
from skylight.probes.fabrication._parts import PrintedPart, PrintSizes
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import design_names, named_design
from skylight.probes.partitions._picture import cell_colours, draw_cells
from skylight.probes.partitions._printing_files import (
    describe_partition_print,
    write_printed_partitions,
)
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions.printed._assembly import AskedSizes
from skylight.probes.partitions.printed._printing import PrintedPartitions, print_fitted
from skylight.probes.voxel._interreflection import (
    ALBEDO,
    DEGREE,
    GlobalReconstruction,
    transfer_vectors,
)
from skylight.probes.voxel._lightmap import Lightmap
from skylight.probes.voxel._model import (
    OCCLUDERS,
    ORIENTATIONS,
    VoxelModel,
    exposed_faces,
    star_probe,
)
from skylight.probes.voxel._printing import print_voxel_probe
from skylight.probes.voxel._printing_files import describe_print, write_printed_probe
from skylight.probes.voxel._relight import write_glb
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._harmonics import project
from skylight.studio.tasks._uploads import Light, read_light
from skylight.work._progress import StageProgress

_SHELL = (0.05, 0.05, 0.06)  # linear reflectance of dull black paint
_METRES = 0.001  # of a millimetre


def write_partition_preview(
    path: Path, printed: PrintedPartitions, colours: Float[np.ndarray, "n 3"]
) -> None:
    """The parts as assembled, in metres and the design's axes, as nodes of their names.

    ``colours`` are linear ones of the kernel's faces, cell by cell, as vertex colours.
    """
    from trimesh import Scene, Trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    parts, scene = printed.printed, Scene()
    for part in parts.parts:
        of_faces = np.tile(_SHELL, (len(part.faces), 1))
        if part is parts.kernel:
            of_faces = colours[_cells(part, parts.net.normals)]
        codes = (255 * of_faces.clip(0, 1)).round().astype(np.uint8).repeat(3, 0)
        visual = TextureVisuals(material=PBRMaterial(metallicFactor=0.0, roughnessFactor=1.0))
        visual.vertex_attributes["color"] = np.pad(codes, ((0, 0), (0, 1)), constant_values=255)
        corners = (part.corners @ parts.rotation * _METRES).reshape(-1, 3)
        triangles = np.arange(len(corners)).reshape(-1, 3)
        mesh = Trimesh(corners, triangles, visual=visual, process=False)
        scene.add_geometry(mesh, node_name=part.name, geom_name=part.name)
    buffer = BytesIO()
    scene.export(buffer, file_type="glb", include_normals=True)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


def _cells(kernel: PrintedPart, normals: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " f"]:
    """The cell into which each triangle of the kernel looks: the one with that normal."""
    corners = kernel.corners
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return (cross @ normals.T).argmax(1)


STARS = {1: "one voxel", 3: "a cross of seven", 5: "a star of 25", 7: "a star of 63"}


def make_voxel_probe(
    folder: str,
    probe: int,
    face_mm: float,
    wall_mm: float,
    light: Light | None,
    *,
    tell: StageProgress,
) -> dict[str, Any]:
    """Print files of the star that is so many voxels wide, and its lightmap under a light.

    ``lightmap`` lists all 192 kinds of faces with their mean radiance: as the probe shows it where
    ``captured``, elsewhere completed from those. Without a light there is none, and the preview
    shows the probe under an even sky.
    """
    out = Path(folder)
    model, sizes = star_probe(probe), PrintSizes(face_mm=face_mm, wall_mm=wall_mm)
    printed = print_voxel_probe(model, sizes, title=f"{probe}-probe", progress=tell)
    tell("writing the results", 0.7)
    write_printed_probe(out, printed)
    tell("lighting the probe", 0.9)
    even = EnvironmentMap(radiance=torch.ones(32, 64, 3))
    environment = even if light is None else read_light(light)
    true = lit_slots(environment)
    captured = captured_by(model, true)
    completed = GlobalReconstruction(captured.known).complete(captured)
    exposure = 1 / white_of(completed.image().reshape(-1, 3))
    write_glb(
        out / "preview.glb", model, completed, voxel_size=face_mm * _METRES, exposure=exposure
    )
    result: dict[str, Any] = {
        "voxels": model.occupied.tolist(),
        "report": describe_print(printed),
        "captured": int(captured.known.sum()),
    }
    if light is not None:
        write_png(out / "lightmap.png", completed.png(exposure))
        completed.save(out / "lightmap.npz")
        result["lightmap"] = _listed(completed, captured)
        result["exposure"] = exposure
        result["reconstruction_error"] = reconstruction_error(completed, true, captured)
    return result


def lit_slots(environment: EnvironmentMap) -> Lightmap:
    """Every kind of face under a light, by its harmonics up to degree 4; below zero cut off."""
    height, width = environment.layout
    coefficients = project(
        environment.radiance.reshape(-1, 3).double(), DirectionGrid.latlong(height, width), DEGREE
    )
    radiance = (transfer_vectors(ALBEDO) @ coefficients).clamp(min=0).float()
    everywhere = torch.ones(radiance.shape[:2])
    return Lightmap(radiance=radiance, coverage=everywhere, confidence=everywhere)


def captured_by(model: VoxelModel, true: Lightmap) -> Lightmap:
    """What a perfect capture of the model would give of these slots."""
    known = (exposed_faces(model).counts() > 0).float()
    radiance = true.radiance * known[:, :, None, None, None]
    return Lightmap(radiance=radiance, coverage=known, confidence=known)


def reconstruction_error(completed: Lightmap, true: Lightmap, captured: Lightmap) -> float:
    """``|completed - true| / |true|`` over what was not captured; 0 where all of it is black."""
    away = (completed.radiance - true.radiance)[~captured.known].double()
    scale = true.radiance[~captured.known].double().norm()
    return float(away.norm() / scale.clamp(min=torch.finfo(torch.float64).tiny))


def _listed(completed: Lightmap, captured: Lightmap) -> list[dict[str, Any]]:
    mean = completed.radiance.mean((2, 3))
    return [
        {
            "orientation": orientation,
            "configuration": configuration,
            "occluders": [name for i, name in enumerate(OCCLUDERS) if configuration >> i & 1],
            "captured": bool(captured.known[o, configuration]),
            "radiance": mean[o, configuration].tolist(),
        }
        for o, orientation in enumerate(ORIENTATIONS)
        for configuration in range(mean.shape[1])
    ]


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
            {"probe": size, "title": f"{what.capitalize()}, {size} wide"}
            for size, what in STARS.items()
        ],
        "partitions": [
            {
                "name": name,
                "title": title_of(name, design.count),
                "cells": design.count,
                "size_mm": size_of(name),
            }
            for name, design in designs.items()
        ],
    }


def title_of(design: str, count: int) -> str:
    """What a named design is, for people who never saw its name."""
    if design == "14d-indoor":
        return f"{count} cells, small above, for rooms"
    if design == "14d-outdoor":
        return f"{count} cells, small along the sun's path"
    if path := re.fullmatch(r"(\d+)d(-tilted)?-sun-(\d+)", design):
        base, tilted, along = path.groups()
        leaning = "a leaning path of the sun" if tilted else "the sun's path"
        return f"{count} cells: {base} all around, {along} along {leaning}"
    return f"{count} cells, even all around"


def size_of(design: str) -> float:
    """The diameter of the shell that the named design has where none is named, mm."""
    return _LARGER_MM.get(design, _SIZE_MM)


def make_partition_probe(
    folder: str, design: str, size_mm: float | None, light: Light | None, *, tell: StageProgress
) -> dict[str, Any]:
    """Print files of a named design, and its cells under a light.

    ``size_mm`` is the diameter of the shell, by default :func:`size_of` the design; the other sizes
    are chosen (:func:`~skylight.probes.partitions.printed._assembly.fitted_sizes`).

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
    decoded = probe.decode(shading, grid).clamp(min=0).reshape(seen.shape)
    white = white_of(seen.reshape(-1, 3))
    write_png(path, np.concatenate([tone_map(each, white=white) for each in (seen, decoded)]))
