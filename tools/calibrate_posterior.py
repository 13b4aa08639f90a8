"""Refit skylight.inverse._posterior.PosteriorConstants, and check them on other faces.

    python tools/calibrate_posterior.py --faces 60 --cache posterior

Rendered people under simulated skies with a visible sun, their heads fitted to landmarks; seeds lie
apart from the evaluation's. Each face takes some 25 s and is kept in --cache, so a second run
starts where the first one ended. The temperature, the kernel and the estimate's lobe are those that
make the true suns likeliest (the mean of log p over the faces). Two halves of the faces are fitted
each for the other: the first two lines printed tell of faces that their fit has not seen.
"""

import argparse
import itertools
import math
from dataclasses import replace
from pathlib import Path

import torch

from skylight.evaluation._known_faces import synthetic_face
from skylight.faces._fit import fit_face
from skylight.faces._landmarkers import choose_landmarker
from skylight.faces._model import HeadModel
from skylight.faces._observe import observe_face
from skylight.inverse._estimate import estimate_light
from skylight.inverse._posterior import (
    FITTED,
    ROWS,
    PosteriorConstants,
    SunEvidence,
    face_evidence,
    smallest_region,
    sun_density,
    sun_evidence,
)
from skylight.inverse._scan import SCAN_HEIGHT, scan_faces
from skylight.io._tensors import read_tensors, write_tensors
from skylight.sphere._frame import DirectionGrid

FIRST_SEED, APART, SIZE = 45_000_000, 1000, 256
GRID = DirectionGrid.sky(ROWS)
TEMPERATURES = (0.012, 0.017, 0.022, 0.027, 0.033, 0.04, 0.05)
KERNELS_DEG = (3.0, 4.5, 6.0, 7.5)
LOBES_DEG, HEIGHTS, WEIGHTS = (4.0, 8.0, 12.0), (3.0, 10.0, 30.0), (0.5, 0.75, 1.0, 1.25)
Case = tuple[SunEvidence, torch.Tensor, int]  # evidence, the estimate's sun, the true sun's cell


def case(seed: int) -> dict[str, torch.Tensor]:
    """What one face says; empty where the landmark detector finds none."""
    face = synthetic_face(seed, SIZE)
    found = choose_landmarker().detect(face.encoded)
    if not found:
        return {}
    model = HeadModel.load()
    fit = fit_face(model, found[0], SIZE, SIZE)
    observation = observe_face(face.picture, face.clipped, model, fit).observation
    coarse = observation.coarser(1).on_rows(SCAN_HEIGHT)
    evidence = sun_evidence(face_evidence([coarse], scan_faces([coarse])))
    return {
        "deviations": evidence.deviations,
        "gain": torch.tensor(evidence.gain, dtype=torch.float64),
        "estimate": estimate_light(observation, "autoencoder").sun_direction.double(),
        "sun": face.environment.brightest_direction().double(),
    }


def log_score(cases: list[Case], model: PosteriorConstants) -> float:
    """Mean log density of the true suns."""
    each = [sun_density(e, s, model)[cell].log() for e, s, cell in cases]
    return float(torch.stack(each).clamp(min=-14).mean())


def fitted(cases: list[Case]) -> PosteriorConstants:
    """The likeliest of the constants tried."""
    models = [
        replace(
            FITTED,
            temperature=t,
            kernel_rad=math.radians(kernel),
            estimate_rad=math.radians(lobe),
            estimate_height=h,
            estimate_weight=k,
        )
        for kernel, t, lobe, h, k in itertools.product(
            KERNELS_DEG, TEMPERATURES, LOBES_DEG, HEIGHTS, WEIGHTS
        )
    ]
    return max(models, key=lambda model: log_score(cases, model))


def report(name: str, model: PosteriorConstants, cases: list[Case]) -> None:
    inside, radii = [], []
    for evidence, estimate, cell in cases:
        region = smallest_region(sun_density(evidence, estimate, model), GRID.solid_angles)
        inside.append(bool(region[cell]))
        share = float(GRID.solid_angles[region].sum()) / (2 * math.pi)
        radii.append(math.degrees(math.acos(1 - share)))
    radii.sort()
    print(
        f"{name}: t {model.temperature}, kernel {math.degrees(model.kernel_rad):.1f} deg, "
        f"lobe {math.degrees(model.estimate_rad):.0f} deg, height {model.estimate_height:.0f}, "
        f"weight {model.estimate_weight}: {sum(inside)} of {len(inside)} "
        f"suns in the region, median radius {radii[len(radii) // 2]:.1f} deg"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="Refit the constants of the posterior.")
    parser.add_argument("--faces", type=int, default=60)
    parser.add_argument("--cache", type=Path, required=True)
    options = parser.parse_args()
    options.cache.mkdir(parents=True, exist_ok=True)
    cases: list[Case] = []
    for number in range(options.faces):
        path = options.cache / f"{number:04d}.safetensors"
        if not path.exists():
            write_tensors(path, case(FIRST_SEED + APART * number))
        kept, _ = read_tensors(path)
        if kept:
            evidence = SunEvidence(deviations=kept["deviations"], gain=float(kept["gain"]))
            cell = int((GRID.directions @ kept["sun"]).argmax())
            cases.append((evidence, kept["estimate"], cell))
        print(f"{number + 1} of {options.faces}", end="\r", flush=True)
    print()
    even, odd = cases[::2], cases[1::2]
    report("odd faces, fitted to the even", fitted(even), odd)
    report("even faces, fitted to the odd", fitted(odd), even)
    report("all, fitted to all", fitted(cases), cases)
    report("all, as shipped", FITTED, cases)


if __name__ == "__main__":
    main()
