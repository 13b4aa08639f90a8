"""How far light of turning objects is off between the angles at which transfer was traced.

    python -m tools.measure_turning --data DIR

A cow of 50 mm on its ground is traced at 96 angles (256 rays, two bounces). Of those, K are knots,
and the angles half way between two are compared, by the 14D or another probe's cells in eight
captured maps: root mean square over the mean of the cow's radiance, and over that of bare ground.
Part of it is noise of the rays.
"""

import argparse
import math
import time
from dataclasses import replace
from pathlib import Path

import torch

from skylight.io._files import read_environment_map
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions._relight_files import ScenePlacement, VirtualScene
from skylight.probes.partitions.relight._composite import TurningRelighting
from skylight.probes.partitions.relight._scene import Scene
from skylight.probes.partitions.relight._transfer import (
    TransferSampling,
    Turn,
    turning_coefficients,
)
from tools.measured import write_measured

_TRACED = 96
_KNOTS = (6, 8, 12, 16, 24, 48)
_MAPS = (
    "abandoned_games_room_02", "industrial_sunset_puresky", "kloofendal_43d_clear_puresky",
    "forest_slope", "brown_photostudio_02", "dikhololo_night", "canary_wharf", "autoshop_01",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="with folders hdr and meshes")
    parser.add_argument("--design", default="14d")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    begun = time.time()
    torch.set_num_threads(1)
    name = f"turning-{arguments.design}"
    write_measured(
        arguments.out or Path(f"benchmarks/results/{name}.json"),
        name=name,
        what=f"light by {arguments.design} of a turning cow and its ground between K angles",
        command=f"python -m tools.measure_turning --data {arguments.data.name} "
        f"--design {arguments.design}",
        begun=begun,
        facts=measured(arguments.data, Cells.of(named_design(arguments.design))),
    )


def measured(data: Path, cells: Cells) -> dict[str, object]:
    """Of each K, mean and worst over the maps, of the cow and of its ground."""
    scene, ground = VirtualScene(
        mesh=data / "meshes" / "spot.ply",
        placement=ScenePlacement(x_mm=0.0, z_mm=0.0, height_mm=50.0),
        cache=Path("none"),
    ).placed
    traced = turning_coefficients(
        Scene.joined([scene, ground.scene()]),
        cells,
        Turn(angles=_TRACED),
        sampling=TransferSampling(rays=256, bounces=2),
    )
    probe = PartitionProbe(cells, 0.8).requires_grad_(False)
    maps = [read_environment_map(data / "hdr" / f"{name}.exr").resize(128) for name in _MAPS]
    lights = torch.stack([probe.light(probe.encode_map(each)).float() for each in maps])
    up = torch.tensor([[0.0, 1.0, 0.0]], dtype=torch.float64)
    bare = ground.albedo / math.pi * (cells.clamped_cosine(up)[0].float() @ lights)
    count = len(scene.vertices)
    facts: dict[str, object] = {"maps": len(maps), "vertices": count}
    for knots in _KNOTS:
        step = _TRACED // knots
        turning = TurningRelighting(replace(traced, values=traced.values[::step]))
        squares = torch.zeros(2, len(maps))
        for at in range(step // 2, _TRACED, step):
            true = torch.einsum("mnc,lnc->lmc", traced.values[at], lights)
            off = (turning(lights, 2 * math.pi * at / _TRACED) - true).mean(2)
            cow = off[:, :count] / true[:, :count].mean((1, 2))[:, None]
            below = off[:, count:] / bare.mean(1)[:, None]
            squares += torch.stack([cow.pow(2).mean(1), below.pow(2).mean(1)]) / knots
        error = squares.sqrt()
        for part, each in zip(("cow", "ground"), error, strict=True):
            facts[f"{part}_{knots}_rms"] = float(each.pow(2).mean().sqrt())
            facts[f"{part}_{knots}_worst_map"] = float(each.max())
    return facts


if __name__ == "__main__":
    main()
