"""Cells of a shading probe, moved by gradient so that it relights better under a day's skies.

    python examples/optimise_probe_cells.py

Directions belong to the seeds of the cells by a softmax that grows sharper from step to step;
at the end each belongs to its closest seed. ``skylight probe partition-design`` searches without
gradients, for cells that can be printed.
"""

from datetime import date

import torch

from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import RelightingError, symmetric_design
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.probes.partitions._sun_path import simulated_lights
from skylight.skies._sun import Place
from skylight.transport._scene import evaluation_scene

STEPS, START, END = 200, 8.0, 200.0


def optimise(cells: int = 14) -> tuple[ProbeDesign, float, float]:
    """(design, relighting error of even cells, that of the design)."""
    lights = simulated_lights(
        Place(latitude_deg=48.0, longitude_deg=11.0), date(2026, 6, 21), weathers=4
    )
    scene = evaluation_scene(20, 32).transport
    error = RelightingError(scene.matrix, lights.maps.flatten(1, 2), scene.grid)
    even = symmetric_design(cells)
    seeds = torch.nn.Parameter(even.seeds.clone())
    optimiser = torch.optim.Adam([seeds], lr=0.02)
    for step in range(STEPS):
        unit = seeds / seeds.norm(dim=1, keepdim=True)
        loss = error.relaxed(unit, START * (END / START) ** (step / STEPS))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    design = ProbeDesign.of("by gradient", seeds.detach(), oriented=True)
    return design, error.of_cells(Cells.of(even)), error.of_cells(Cells.of(design))


if __name__ == "__main__":
    _, before, after = optimise()
    print(f"relighting error of even cells {before:.1%}, of the optimised ones {after:.1%}")
