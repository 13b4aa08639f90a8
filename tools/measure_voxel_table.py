"""What the voxel probe's table depends on, one factor at a time. Makes voxel-table.json.

    OMP_NUM_THREADS=1 python -m tools.measure_voxel_table --data DIR

From the settings of ``skylight evaluate voxel-probe``, but the 3-probe, two maps (four of each
kind) and 64 paths for each pixel, one thing is changed at a time: the maps, how finely models are
voxelised, from where they are seen, the albedo, paths, bounces, and how sharp the light is. Errors
are means over maps, three models and two views, of the model's pixels:

``mae``        mean |p - t| over the truth's mean
``mae_white``  mean |p - t| over a white, the 98 % quantile of the luminance of the truth's model
``mae_shown``  mean |p - t| of sRGB values from 0 to 1 with that white
``ssim``       of the pictures as shown, background and all

``every slot`` has no slot to complete: each is path traced in the simplest geometry that has its
neighbours. What is left then is noise, and light that voxels farther away keep off or send. Other
weights than least squares complete the 3-probe's slots in the base and are told by their errors of
transfer: ``magnitudes`` and ``power 1.5`` fit the sum of errors to that power, ``non-negative`` and
``sum of one`` are least squares under that constraint.

``coarse models`` is a choice of factors under which errors are those of the thesis' Table 3.2: its
two views and eight maps, both probes, models of 12 voxels, more paths. Each row's errors are kept
in ``--rows``, so that a stopped run goes on.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from statistics import fmean, pstdev

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.optimize import nnls
from torch import Tensor

from skylight.evaluation._run import mesh_files, probes_folder
from skylight.evaluation._voxel_probe import (
    ALBEDO,
    MAPS,
    MODELS,
    PROBES,
    RESOLUTION,
    VIEWS_DEG,
    VoxelScene,
    baked,
)
from skylight.imaging._colour import linear_to_srgb
from skylight.imaging._metrics import mae, ssim
from skylight.io._files import read_categories, read_environment_map
from skylight.probes.voxel._analysis import transfer_error
from skylight.probes.voxel._interreflection import (
    GlobalReconstruction,
    slot_transfer,
    transfer_vectors,
)
from skylight.probes.voxel._lightmap import SIZE, Lightmap
from skylight.probes.voxel._model import (
    CONFIGURATIONS,
    FORWARD,
    NORMALS,
    ORIENTATIONS,
    RIGHT,
    VoxelFaces,
    VoxelModel,
    exposed_faces,
    star_probe,
    voxelise,
)
from skylight.probes.voxel._reconstruct import DirectReconstruction, SlotReconstruction
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.transport._path_tracer import DiffuseScene, Sampling, shade
from tools.measured import kept, write_measured

Views = tuple[tuple[float, float], ...]
Picture = Float[Tensor, "h w 3"]
Scores = dict[str, dict[str, list[float]]]  # method -> metric -> a value for each picture


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What is measured with what."""

    maps: str = "evaluated"
    count: int = 2
    resolution: int = RESOLUTION
    views_deg: Views = VIEWS_DEG
    albedo: float = ALBEDO
    traced: int = 64  # paths for each pixel of a true picture
    baked: int = 256  # paths for each texel of the probe
    bounces: int = 16
    light_rows: int = 128
    probes: tuple[int, ...] = (3,)
    every_slot: bool = False  # and the other weights


KINDS_OF_MAPS = {
    "evaluated": "",
    "rooms": "indoor",
    "cloudy": "outdoor-nosun",
    "sunny": "outdoor-sun",
}
BASE = Setting()
VARIATIONS: dict[str, Setting] = {
    "base": replace(BASE, every_slot=True),
    **{f"maps: {kind}": replace(BASE, maps=kind, count=4) for kind in ("rooms", "cloudy", "sunny")},
    **{f"resolution {n}": replace(BASE, resolution=n) for n in (8, 16)},
    "from the front and the right": replace(BASE, views_deg=((0.0, 25.0), (90.0, 25.0))),
    "from a height of 50 deg": replace(BASE, views_deg=((35.0, 50.0), (215.0, 50.0))),
    **{f"albedo {a}": replace(BASE, albedo=a) for a in (0.5, 0.9)},
    "pictures of 256 paths": replace(BASE, traced=256),
    "probe of 1024 paths": replace(BASE, baked=1024),
    "no bounce": replace(BASE, bounces=0),
    "one bounce": replace(BASE, bounces=1),
    "light of 16 rows": replace(BASE, light_rows=16),
}
COARSE = "coarse models"
THESIS = Setting(count=MAPS, resolution=12, traced=512, baked=512, probes=PROBES)
NOISE = 0.001  # of a transfer coefficient; those of free faces are 0.7 at most
MODEL_NAMES = [name.split(".")[0].removeprefix("stanford_") for name in MODELS]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="with folders hdr and meshes")
    parser.add_argument("--rows", type=Path, default=Path("runs/voxel-table"))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/voxel-table.json"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    begun = time.time()
    rows = {}
    for name, setting in {**VARIATIONS, COARSE: THESIS}.items():
        path = arguments.rows / f"{name.replace(' ', '_').replace(':', '')}.json"
        rows[name] = kept(path, partial(measured, arguments.data, setting))
        print(f"{name} {time.process_time():.0f} s", flush=True)
    means = {
        name: {method: {k: fmean(v) for k, v in of.items()} for method, of in scores.items()}
        for name, scores in rows.items()
    }

    def column(method: str, metric: str) -> dict[str, float]:
        return {name: means[name][method][metric] for name in VARIATIONS}

    write_measured(
        arguments.out,
        name="voxel-table",
        what="errors of voxel models drawn from the 3-probe's lightmap, one factor changed at a "
        "time from the base; of other weights; and of coarse models without noise",
        command="OMP_NUM_THREADS=1 python -m tools.measure_voxel_table --data data",
        begun=begun,
        facts={
            "mae 3-global": column("3-global", "mae"),
            "mae_white 3-global": column("3-global", "mae_white"),
            "ssim 3-global": column("3-global", "ssim"),
            "mae 3-direct": column("3-direct", "mae"),
            "base": {
                method: {metric: of[metric] for metric in ("mae", "ssim")}
                for method, of in means["base"].items()
            },
            "transfer_l1": transfer_errors(),
            f"transfer_l1 with noise of {NOISE}": with_noise(NOISE),
            COARSE: {
                method: {
                    f"{metric} {part}": value(of[metric])
                    for metric in ("mae", "ssim")
                    for part, value in (("mean", fmean), ("std", pstdev))
                }
                for method, of in rows[COARSE].items()
            },
            f"{COARSE}, by model": {
                method: {
                    f"{metric} {model}": fmean(of_model(of[metric], i))
                    for metric in ("mae", "ssim")
                    for i, model in enumerate(MODEL_NAMES)
                }
                for method, of in rows[COARSE].items()
            },
            "all": means,
        },
    )


def of_model(values: list[float], number: int) -> list[float]:
    """Of pictures map by map, model by model, view by view: those of one model."""
    views, models = len(VIEWS_DEG), len(MODEL_NAMES)
    return [v for i, v in enumerate(values) if i // views % models == number]


def transfer_errors() -> dict[str, dict[str, float]]:
    """Mean and spread of the L1 error of transfer (Fig. 3.9), by probe and weights."""
    found = {}
    for size in PROBES:
        for kind, made in {**reconstructions(size, ALBEDO), **other_weights(size, ALBEDO)}.items():
            error = transfer_error(made, ALBEDO)
            found[f"{size}-{kind}"] = {"mean": error.mean, "std": error.std}
    return found


def with_noise(deviation: float) -> dict[str, dict[str, float]]:
    """:func:`transfer_errors` where each coefficient of each texel has Gaussian noise.

    As of transfer that was path traced; weights are those without it.
    """
    exact = transfer_vectors(ALBEDO).flatten(2)
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(exact.shape, generator=generator, dtype=exact.dtype)
    traced = exact + deviation * noise
    found = {}
    for size in PROBES:
        for kind, made in reconstructions(size, ALBEDO).items():
            error = (made.weights @ traced - traced)[:, : CONFIGURATIONS - 1].abs()
            found[f"{size}-{kind}"] = {"mean": float(error.mean()), "std": float(error.std())}
    return found


def measured(data: Path, setting: Setting) -> Scores:
    """Of every method, each picture's errors."""
    scores: Scores = {}
    for name in map_names(data, setting.maps, setting.count):
        light = read_environment_map(probes_folder(data) / name).resize(setting.light_rows)
        lightmaps = completed(light, setting)
        sampling = Sampling(samples=setting.traced, bounces=setting.bounces)
        for mesh in mesh_files(data, MODELS):
            scene = scene_of(mesh, setting.resolution, setting.albedo, setting.views_deg)
            truths, masks, _ = scene.traced(light, sampling, 1)
            for method, lightmap in lightmaps.items():
                of = scores.setdefault(method, {})
                for p, t, mask in zip(scene.drawn(lightmap), truths, masks, strict=True):
                    for metric, value in compared(p, t, mask).items():
                        of.setdefault(metric, []).append(value)
    return scores


def map_names(data: Path, kind: str, count: int) -> list[str]:
    """So many maps of a kind, evenly through the collection."""
    index = read_categories(probes_folder(data))
    chosen = [name for name, category in index.items() if category.startswith(KINDS_OF_MAPS[kind])]
    return chosen[:: max(1, len(chosen) // count)][:count]


def completed(light: EnvironmentMap, setting: Setting) -> dict[str, Lightmap]:
    """The lightmaps to draw with, by method."""
    sampling = Sampling(samples=setting.baked, bounces=setting.bounces)
    found = {}
    for size in setting.probes:
        captured = baked(size, light, sampling, 0, albedo=setting.albedo)
        for kind, made in reconstructions(size, setting.albedo).items():
            found[f"{size}-{kind}"] = made.complete(captured)
    if setting.every_slot:
        captured = baked(3, light, sampling, 0, albedo=setting.albedo)
        for kind, made in other_weights(3, setting.albedo).items():
            found[f"3-{kind}"] = made.complete(captured)
        found["every slot"] = every_slot(light, replace(sampling, samples=64), setting.albedo)
    return found


@cache
def scene_of(mesh: Path, resolution: int, albedo: float, views_deg: Views) -> VoxelScene:
    return VoxelScene.of(voxelise(mesh, resolution), albedo=albedo, views_deg=views_deg)


@cache
def reconstructions(size: int, albedo: float) -> dict[str, SlotReconstruction]:
    known = exposed_faces(star_probe(size)).counts() > 0
    return {
        "direct": DirectReconstruction(known),
        "global": GlobalReconstruction(known, albedo=albedo),
    }


def compared(pred: Picture, true: Picture, mask: Bool[Tensor, "h w"]) -> dict[str, float]:
    """The errors of one picture, as named at the top."""
    level = luminance(true.double())[mask].sort().values
    white = level[round(0.98 * (len(level) - 1))].clamp(min=1e-30)
    p, t = pred.double()[mask] / white, true.double()[mask] / white
    shown = [linear_to_srgb(x.clamp(0, 1)) for x in (p, t)]
    return {
        "mae": mae(p, t),
        "mae_white": float((p - t).abs().mean()),
        "mae_shown": float((shown[0] - shown[1]).abs().mean()),
        "ssim": ssim(pred, true),
    }


def every_slot(light: EnvironmentMap, sampling: Sampling, albedo: float) -> Lightmap:
    """Every slot path traced in the simplest geometry of its configuration."""
    radiance = torch.zeros(len(ORIENTATIONS), CONFIGURATIONS, SIZE, SIZE, 3)
    for o in range(len(ORIENTATIONS)):
        for c in range(CONFIGURATIONS - 1):  # the last is dark
            faces, number = lone_face(o, c)
            found = shade(
                faces.points(SIZE)[number].reshape(-1, 3),
                torch.from_numpy(NORMALS[o]).double().expand(SIZE * SIZE, 3),
                DiffuseScene.uniform(*faces.triangles(), albedo),
                light,
                albedo=albedo,
                sampling=sampling,
                generator=torch.Generator().manual_seed(0),
            )
            radiance[o, c] = found.mean.float().reshape(SIZE, SIZE, 3)
    known = torch.ones(radiance.shape[:2])
    return Lightmap(radiance=radiance, coverage=known, confidence=known)


def lone_face(orientation: int, configuration: int) -> tuple[VoxelFaces, int]:
    """(faces, the one in question) of a voxel and the neighbours that occlude its face."""
    normal, right, forward = (torch.from_numpy(a[orientation]) for a in (NORMALS, RIGHT, FORWARD))
    solid = np.zeros((3, 3, 3), bool)
    front = torch.ones(3, dtype=torch.int64)
    solid[tuple(front - normal)] = True
    for i, step in enumerate((-right, right, forward, -forward, normal)):
        if configuration >> i & 1:
            solid[tuple(front + step)] = True
    faces = exposed_faces(VoxelModel(occupied=solid))
    here = (faces.orientation == orientation) & (faces.cells == front - normal).all(1)
    return faces, int(torch.nonzero(here))


@cache
def other_weights(size: int, albedo: float) -> dict[str, SlotReconstruction]:
    """An N-probe's reconstructions by other fits of transfer vectors than least squares."""
    known = exposed_faces(star_probe(size)).counts() > 0
    assert bool((known == known[0]).all())  # so one orientation says it for all
    rows = slot_transfer(albedo).flatten(1)
    have, want = torch.nonzero(known[0])[:, 0], torch.nonzero(~known[0])[:, 0]
    fits: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
        "magnitudes": lambda a, b: least_power(a, b, 1.0),
        "power 1.5": lambda a, b: least_power(a, b, 1.5),
        "non-negative": lambda a, b: torch.from_numpy(nnls(a.T.numpy(), b.numpy())[0]),
        "sum of one": with_sum_of_one,
    }
    found = {}
    for name, fit in fits.items():
        weights = torch.diag(known[0].double())
        for u in want.tolist():
            weights[u, have] = fit(rows[have], rows[u])
        found[name] = SlotReconstruction(weights.expand(len(known), -1, -1), known)
    return found


def least_power(
    rows: Float[Tensor, "m d"], wanted: Float[Tensor, " d"], power: float
) -> Float[Tensor, " m"]:
    """argmin_x sum |wanted - rows^T x|^power by iteratively reweighted least squares."""
    x = torch.linalg.solve(rows @ rows.T, rows @ wanted)
    for _ in range(200):
        weighted = rows * (wanted - rows.T @ x).abs().clamp(min=1e-6) ** (power - 2)
        x = torch.linalg.solve(weighted @ rows.T, weighted @ wanted)
    return x


def with_sum_of_one(rows: Float[Tensor, "m d"], wanted: Float[Tensor, " d"]) -> Float[Tensor, " m"]:
    """argmin_x |wanted - rows^T x|^2 where sum x = 1, by its Lagrangian."""
    count = len(rows)
    system = torch.zeros(count + 1, count + 1, dtype=torch.float64)
    system[:count, :count] = rows @ rows.T
    system[count, :count] = system[:count, count] = 1
    right = torch.cat([rows @ wanted, wanted.new_ones(1)])
    return torch.linalg.solve(system, right)[:count]


if __name__ == "__main__":
    main()
