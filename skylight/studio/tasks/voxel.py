"""Printing of a voxel probe, and its shading under a light."""

from pathlib import Path
from typing import Any

import torch

from skylight.app.figures.exposure import white_of
from skylight.app.probes.voxel.printing import describe_print, write_printed_probe
from skylight.fabrication.sizes import PrintSizes
from skylight.io.files import write_png
from skylight.probes.voxel.faces import OCCLUDERS, ORIENTATIONS, exposed_faces
from skylight.probes.voxel.interreflection.global_illumination import ALBEDO, GlobalReconstruction
from skylight.probes.voxel.interreflection.transfer import DEGREE, transfer_vectors
from skylight.probes.voxel.lightmap import Lightmap
from skylight.probes.voxel.model import VoxelModel, star_probe
from skylight.probes.voxel.printed.printing import print_voxel_probe
from skylight.probes.voxel.relight.export import write_glb
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.grid import DirectionGrid
from skylight.sphere.harmonics import project
from skylight.studio.tasks.lights import Light, read_light
from skylight.work.progress import StageProgress

STARS = {1: "one voxel", 3: "a cross of seven", 5: "a star of 25", 7: "a star of 63"}
_MM = 0.001


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
    write_glb(out / "preview.glb", model, completed, voxel_size=face_mm * _MM, exposure=exposure)
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
