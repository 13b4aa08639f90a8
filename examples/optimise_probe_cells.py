"""Cells of a shading probe, moved by gradient so that it relights better under a day's skies.

Directions belong to the seeds of the cells by a softmax that grows sharper from step to step;
at the end each belongs to its closest seed.
"""

from datetime import date

import torch
from torch.nn.functional import normalize

from skylight.probes import partitions
from skylight.skies import Place
from skylight.transport import evaluation_scene

STEPS, START, END = 200, 8.0, 200.0


def optimise() -> tuple[partitions.ProbeDesign, float, float]:
    """(design, relighting error of even cells, that of the design)."""
    place = Place(latitude_deg=48.0, longitude_deg=11.0)
    lights = partitions.simulated_lights(place, date(2026, 6, 21), weathers=4).maps
    scene = evaluation_scene(20, 32).transport
    error = partitions.RelightingError(scene.matrix, lights.flatten(1, 2), scene.grid)
    even = partitions.named_design("14d")
    seeds = torch.nn.Parameter(even.seeds.clone())
    optimiser = torch.optim.Adam([seeds], lr=0.02)
    for step in range(STEPS):
        loss = error.relaxed(normalize(seeds), START * (END / START) ** (step / STEPS))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    design = partitions.ProbeDesign.of("by gradient", seeds.detach(), oriented=True)
    before, after = (error.of_cells(partitions.Cells.of(each)) for each in (even, design))
    return design, before, after


if __name__ == "__main__":
    _, before, after = optimise()
    print(f"relighting error of even cells {before:.1%}, of the optimised ones {after:.1%}")
