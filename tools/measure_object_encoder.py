"""Relighting one object with the illumination measured on another, by sets of points.

    python -m tools.measure_object_encoder --data DIR

A printed-size dragon and bunny light each other (no bounces) under every sixth map of the
collection, from shading of k points with 1 % noise: drawn at random, chosen for conditioning, or
chosen for what they light. ``dual`` decodes by the dual basis with a ridge for the noise,
``nonnegative`` by non-negative harmonics of degree 4; the 14D partition probe is beside them.
Errors are relative RMS of the other object's shading, the median over the maps.
"""

import argparse
import math
import time
from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.inverse._harmonic import nonnegative_harmonics
from skylight.io._files import read_categories, read_environment_map
from skylight.probes._encoder import (
    ObjectEncoder,
    SurfaceTransfer,
    choose_points,
    surface_points,
    surface_transfer,
)
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions.relight._scene import read_scene
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._frame import DirectionGrid
from tools.measured import write_measured

OBJECTS = ("stanford_dragon.ply", "stanford_bunny.ply")
ROWS, DEGREE, NOISE, ALBEDO = 32, 4, 0.01, 0.8
CANDIDATES, LIT, DRAWS = 1500, 700, 4
COUNTS = (14, 25, 49)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="with folders hdr and meshes")
    parser.add_argument("--every", type=int, default=6, help="map of the collection")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/object-encoder.json"))
    arguments = parser.parse_args()
    begun = time.time()
    names = list(read_categories(arguments.data / "hdr"))[:: arguments.every]
    maps = torch.stack([_unit_map(arguments.data / "hdr" / name) for name in names])
    generator = torch.Generator().manual_seed(0)
    objects = {name: _transfer(arguments.data / "meshes" / name, generator) for name in OBJECTS}
    facts: dict[str, float] = {}
    for source, target in (OBJECTS, OBJECTS[::-1]):
        label = f"{_short(source)}_lights_{_short(target)}"
        found = measure(objects[source], objects[target], maps, generator)
        facts |= {f"{label}_{name}": value for name, value in found.items()}
    command = f"python -m tools.measure_object_encoder --data {arguments.data.name}"
    write_measured(
        arguments.out,
        name="object-encoder",
        what=f"relative RMS error of one object lit from points of another, median over "
        f"{len(names)} maps, {100 * NOISE:g} % noise",
        command=command + f" --every {arguments.every}",
        begun=begun,
        facts=facts,
    )


def measure(
    source: SurfaceTransfer,
    target: SurfaceTransfer,
    maps: Float[Tensor, "b d 3"],
    generator: torch.Generator,
) -> dict[str, float]:
    """Errors of all ways to choose points and to decode them."""
    target = target.at(torch.arange(LIT))
    truth = target.shading(maps)
    probe = PartitionProbe(Cells.of(named_design("14d")), ALBEDO)
    seen = _noisy(probe(maps, target.grid), generator)
    facts = {"partitions_14d": _error(target.shading(probe.decode(seen, target.grid)), truth)}
    for count in COUNTS:
        ways: dict[str, Sequence[Int[Tensor, " k"]]] = {
            "random": [
                torch.randperm(CANDIDATES, generator=generator)[:count] for _ in range(DRAWS)
            ],
            "conditioned": [choose_points(source, count, noise=NOISE)],
            "for_lighting": [choose_points(source, count, noise=NOISE, lit=source)],
        }
        for way, draws in ways.items():
            found = [_decoded(source.at(points), target, maps, generator) for points in draws]
            for decoder in ("dual", "nonnegative"):
                errors = [_error(shading[decoder], truth) for shading in found]
                facts[f"{count}_{way}_{decoder}"] = sum(errors) / len(errors)
    return facts


def _decoded(
    points: SurfaceTransfer,
    target: SurfaceTransfer,
    maps: Float[Tensor, "b d 3"],
    generator: torch.Generator,
) -> dict[str, Float[Tensor, "b m 3"]]:
    encoder = ObjectEncoder(points, noise=NOISE)
    shading = _noisy(encoder(maps), generator)
    basis = harmonics.evaluate(points.grid.directions, DEGREE)
    power = points.functions[..., 0].double() * points.grid.solid_angles
    operator = power @ basis
    lights = [basis @ nonnegative_harmonics(operator, each).coefficients for each in shading]
    return {
        "dual": target.shading(encoder.decode(shading)),
        "nonnegative": target.shading(torch.stack(lights)),
    }


def _transfer(path: Path, generator: torch.Generator) -> SurfaceTransfer:
    scene = read_scene(path, (ALBEDO, ALBEDO, ALBEDO))
    receivers = surface_points(scene, CANDIDATES, generator)
    return surface_transfer(scene, receivers, DirectionGrid.latlong(ROWS))


def _unit_map(path: Path) -> Float[Tensor, "d 3"]:
    """Of mean 1: all maps count alike."""
    light = read_environment_map(path).resize(ROWS).flat.double()
    return light / light.mean()


def _noisy(shading: Float[Tensor, "b k 3"], generator: torch.Generator) -> Float[Tensor, "b k 3"]:
    level = NOISE * shading.square().mean((1, 2), keepdim=True).sqrt()
    return shading + level * torch.randn(shading.shape, generator=generator).to(shading)


def _error(found: Float[Tensor, "b m 3"], truth: Float[Tensor, "b m 3"]) -> float:
    off = (found - truth).square().sum((1, 2)) / truth.square().sum((1, 2))
    return math.sqrt(float(off.median()))


def _short(name: str) -> str:
    return name.removeprefix("stanford_").removesuffix(".ply")


if __name__ == "__main__":
    main()
