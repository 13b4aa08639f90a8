"""How exact a probe is that is stitched from a virtual camera's shots of a known map.

    python -m tools.measure_stitching --maps ../shared/data/hdr

A camera on a head of 12 azimuths and 5 elevations photographs each map with a bracket, photon and
read noise, as 8-bit sRGB and as 16-bit linear codes; the head's turns err by 2 degrees about each
axis. Stitched with the head's turns as hints, and without.

Maps are compared on 128 rows in the true world's frame, in which the found turns are put as a
whole: ``..._median_error`` and ``..._mean_error`` are |L - L'| over L, the mean of its channels, of
the median pixel and over all light, outside of 13 degrees from the sun where there is one;
``sun_irradiance_error`` is that of the light within four degrees of the sun on a surface that faces
it. ``rotation_error_deg`` is the median, of shots with matches; ``unmatched_share`` is the share of
shots without any, which stay where the head's turns put them. ``unhinted_...`` are without hints;
``unhinted_up_error_deg`` is how far the vertical that is found then is off. ``unmatched_share``,
``rms_px``, ``unseen_share`` and ``unhinted_...`` are of the shots of 16 bits alone.
"""

import argparse
import math
import time
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from skylight.io._files import read_environment_map
from skylight.probes._probe_map import ProbeMap, latlong_directions
from skylight.probes.cameras._exposures import merge
from skylight.probes.panorama._matches import Lens, Shot, shot_of
from skylight.probes.panorama._panorama import Panorama, aligned, panorama_of, stitch
from skylight.sphere._envmap import SUN_REGION_RAD, EnvironmentMap, luminance
from tools.measured import write_measured
from tools.virtual_camera import Head, Light, bracket, expose, light_of, picture

# With a sun in view, the first six; then without
MAPS = (
    "quarry_01", "crystal_falls", "noon_grass", "rooitou_park", "dry_cracked_lake", "garden_nook",
    "mossy_forest", "snowy_forest_path_01", "canary_wharf",
)  # fmt: skip
SUNNY = 6
ROWS = 128
HEAD = Head(12, (-70.0, -35.0, 0.0, 35.0, 70.0), error_deg=2.0)
LENS = Lens(width=320, height=240, focal_px=280.0, k1=-0.05)
SUN_RAD = math.radians(4.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--maps", type=Path, default=Path("../shared/data/hdr"))
    parser.add_argument("--names", nargs="+", default=list(MAPS))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/stitching.json"))
    arguments = parser.parse_args()
    begun = time.time()
    rows = {}
    for name in arguments.names:
        environment = read_environment_map(arguments.maps / f"{name}.exr")
        rows[name] = measure(environment, name in MAPS[:SUNNY])
        print(name, rows[name], flush=True)
    facts: dict[str, object] = {"maps": rows}
    for key in sorted({key for row in rows.values() for key in row}):
        values = [row[key] for row in rows.values() if key in row]
        facts[f"worst_{key}"], facts[f"median_{key}"] = max(values), float(np.median(values))
    write_measured(
        arguments.out,
        name="stitching",
        what=f"{len(rows)} captured maps of 256 rows photographed in 12 x 5 directions, "
        f"{LENS.width}x{LENS.height} pixels",
        command=f"python -m tools.measure_stitching --maps {arguments.maps.name} --names "
        + " ".join(arguments.names),
        begun=begun,
        facts=facts,
    )


def measure(environment: EnvironmentMap, sunny: bool) -> dict[str, float]:
    rng, light = np.random.default_rng(0), light_of(environment)
    turns = HEAD.true(rng)
    pictures = [picture(light, turn, LENS) for turn in turns]
    usual = 2 * float(luminance(environment.flat).median())
    times = bracket(max(float(seen.max()) for seen in pictures), usual)
    true = world(light, times[-1])
    facts = {"exposures": float(len(times))}
    for bits in (8, 16):
        shots = [
            shot_of(f"{k}", merge([expose(p, t, rng, bits, f"{t}") for t in times], "srgb"))
            for k, p in enumerate(pictures)
        ]
        hints = dict(enumerate(HEAD.told()))
        begun = time.process_time()
        found = panorama_of(shots, ROWS, focal_px=1.1 * LENS.focal_px, hints=hints)
        if bits == 8:
            facts["stitching_s"] = time.process_time() - begun
        probe, off_deg = in_true_world(found, shots, turns)
        scores = compared(probe, true, sunny)
        facts |= {f"{name}_{bits}_bit": value for name, value in scores.items()}
        facts[f"rotation_error_deg_{bits}_bit"] = off_deg
    alone = panorama_of(shots, ROWS)
    _, off_deg = in_true_world(alone, shots, turns)
    rotations = alone.bundle.rotations
    frame = [rotations[k] @ turns[k].T for k in rotations]
    up = Rotation.from_matrix(frame).mean().as_matrix()[:, 1]
    return facts | {
        "unmatched_share": len(found.by_hint) / len(shots),
        "rms_px": found.bundle.rms_px,
        "unseen_share": found.probe.unseen_share,
        "unhinted_unseen_share": alone.probe.unseen_share,
        "unhinted_rotation_error_deg": off_deg,
        "unhinted_up_error_deg": math.degrees(math.acos(min(1.0, up[1]))),
        "unhinted_focal_length_error": abs(alone.bundle.lens.focal_px / LENS.focal_px - 1),
    }


def world(light: Light, gain: float) -> EnvironmentMap:
    """What the camera photographs, averaged over the pixels of the map that is compared."""
    fine = 8 * ROWS
    directions = latlong_directions(fine).numpy().reshape(-1, 3)
    radiance = gain * light(directions).reshape(fine, 2 * fine, 3)
    return EnvironmentMap(radiance=torch.from_numpy(radiance)).resize(ROWS)


def in_true_world(
    found: Panorama, shots: list[Shot], turns: list[Float[np.ndarray, "3 3"]]
) -> tuple[ProbeMap, float]:
    """(the probe stitched anew in the true frame, median error of turns that matches tell)."""
    bundle = found.bundle
    told = {k: turn for k, turn in enumerate(turns) if k not in found.by_hint}
    rotations = aligned(bundle.rotations, told)
    off = [
        Rotation.from_matrix(rotations[k].T @ told[k]).magnitude() for k in rotations if k in told
    ]
    return stitch(shots, rotations, bundle.lens, ROWS), math.degrees(float(np.median(off)))


def compared(probe: ProbeMap, true: EnvironmentMap, sunny: bool) -> dict[str, float]:
    grid = true.grid
    weight = grid.solid_angles.numpy() * probe.seen.flatten().numpy()
    got, want = probe.environment.flat.double().numpy(), true.flat.double().numpy()
    facts = {}
    if sunny:
        cosine = (grid.directions @ true.brightest_direction()).numpy()
        lit = grid.solid_angles.numpy() * cosine * (cosine > math.cos(SUN_RAD))
        facts["sun_irradiance_error"] = float(np.abs(lit @ got / (lit @ want) - 1).max())
        weight = weight * (cosine < math.cos(SUN_REGION_RAD))
    off = np.abs(got - want).mean(1)
    relative = off / want.mean(1)
    order = relative.argsort()
    half = np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)
    return facts | {
        "median_error": float(relative[order][half]),
        "mean_error": float(weight @ off / (weight @ want.mean(1))),
    }


if __name__ == "__main__":
    main()
