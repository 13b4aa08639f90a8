"""The voxel probe on synthetic data: transfer vectors and renderings (thesis, 3.4.5 to 3.6.1).

One item a light map: the 3- and the 5-probe are captured perfectly (their faces' shading is path
traced), their lightmaps completed in both ways, and voxelised meshes drawn from two sides and
compared with path tracing. ``mae`` is relative to the model's mean; ``ssim`` is that of the whole
picture, dark background and all, which is what the thesis' values agree with, ``ssim_model`` that
of the model's pixels alone. The item "transfer" has the errors of the transfer vectors themselves
and which sets of configurations tell how much.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from pathlib import Path
from types import MappingProxyType

import torch
from jaxtyping import Bool, Float
from matplotlib.figure import Figure
from torch import Tensor

from skylight.errors import InputError
from skylight.evaluation._pictures import Picture, captioned_rows, save_figure
from skylight.evaluation._run import (
    Check,
    Item,
    Metrics,
    ProbeEvaluation,
    Rows,
    mesh_files,
)
from skylight.imaging._colour import tone_map
from skylight.imaging._metrics import shading_metrics, ssim
from skylight.io._files import INDEX_NAME, read_categories, read_environment_map, write_png
from skylight.probes.cameras._drawing import camera_rays, looking_at
from skylight.probes.voxel._analysis import (
    LIT,
    best_sets,
    residuals,
    residuals_by_occluders,
    transfer_error,
)
from skylight.probes.voxel._interreflection import GlobalReconstruction
from skylight.probes.voxel._lightmap import SIZE, Lightmap
from skylight.probes.voxel._model import (
    NORMALS,
    VoxelFaces,
    VoxelModel,
    exposed_faces,
    star_probe,
    voxelise,
)
from skylight.probes.voxel._reconstruct import DirectReconstruction, SlotReconstruction
from skylight.probes.voxel._relight import VoxelRenderer
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._rotation import RigidTransform
from skylight.transport._cameras import Camera
from skylight.transport._path_tracer import DiffuseScene, Sampling, shade

ALBEDO = 0.8
PIXELS = 160
MODELS = ("stanford_bunny.ply", "stanford_dragon.ply", "stanford_buddha.ply")
RESOLUTION = 24  # voxels along the longest side
VIEWS_DEG = ((35.0, 25.0), (215.0, 25.0))  # azimuth and elevation


@dataclass(frozen=True, kw_only=True)
class View:
    """One picture of a model: which pixels show it, and which points of it they show."""

    mask: Bool[Tensor, "h w"]
    points: Float[Tensor, "m 3"]
    normals: Float[Tensor, "m 3"]


@dataclass(frozen=True, kw_only=True)
class VoxelScene:
    """A model of one albedo, and how it is looked at."""

    model: VoxelModel
    albedo: float
    renderer: VoxelRenderer
    scene: DiffuseScene
    poses: tuple[RigidTransform, ...]
    camera: Camera

    @staticmethod
    def of(
        model: VoxelModel,
        *,
        albedo: float = ALBEDO,
        views_deg: Sequence[tuple[float, float]] = VIEWS_DEG,
    ) -> "VoxelScene":
        """From azimuths and elevations, filling the picture."""
        renderer = VoxelRenderer(model)
        vertices, triangles = exposed_faces(model).triangles()
        size = torch.tensor(model.occupied.shape, dtype=torch.float64)
        middle, distance = size / 2, 2.0 * float(size.norm())
        focal = 0.95 * PIXELS * distance / float(size.norm())
        poses = []
        for azimuth, elevation in torch.tensor(views_deg, dtype=torch.float64).deg2rad():
            flat = elevation.cos()
            offset = torch.stack([flat * azimuth.sin(), elevation.sin(), flat * azimuth.cos()])
            poses.append(looking_at(middle + distance * offset, middle))
        return VoxelScene(
            model=model,
            albedo=albedo,
            renderer=renderer,
            scene=DiffuseScene.uniform(vertices, triangles, albedo),
            poses=tuple(poses),
            camera=Camera(
                focal_px=focal, width=PIXELS, height=PIXELS, center_px=(PIXELS / 2, PIXELS / 2)
            ),
        )

    def drawn(self, lightmap: Lightmap) -> list[Float[Tensor, "h w 3"]]:
        """By texture mapping, one ray through each pixel's centre."""
        rays = camera_rays(self.camera)
        return [self.renderer.draw(lightmap, rays, pose).radiance for pose in self.poses]

    def traced(
        self, environment: EnvironmentMap, sampling: Sampling, seed: int
    ) -> tuple[list[Float[Tensor, "h w 3"]], list[Bool[Tensor, "h w"]], float]:
        """(path-traced pictures, where the model is, standard error relative to the mean)."""
        views = [self._view(pose) for pose in self.poses]
        found = shade(
            torch.cat([view.points for view in views]),
            torch.cat([view.normals for view in views]),
            self.scene,
            environment,
            albedo=self.albedo,
            sampling=sampling,
            generator=torch.Generator().manual_seed(seed),
        )
        noise = float(found.standard_error.mean() / found.mean.mean())
        pictures = []
        for view, shades in zip(
            views, found.mean.split([len(view.points) for view in views]), strict=True
        ):
            picture = torch.zeros(*view.mask.shape, 3)
            picture[view.mask] = shades.float()
            pictures.append(picture)
        return pictures, [view.mask for view in views], noise

    def _view(self, pose: RigidTransform) -> View:
        back = pose.inverse()
        eye, rays = back.translation, back.directions(camera_rays(self.camera).reshape(-1, 3))
        hits = self.scene.raycaster.intersect(eye.expand(len(rays), 3), rays)
        seen = hits.face >= 0
        return View(
            mask=seen.reshape(PIXELS, PIXELS),
            points=eye + hits.distance[seen, None] * rays[seen],
            normals=self.scene.normals[hits.face[seen]].double(),
        )


@cache
def voxel_scene(mesh: Path) -> VoxelScene:
    """A mesh in :data:`RESOLUTION` voxels along its longest side; once per process."""
    return VoxelScene.of(voxelise(mesh, RESOLUTION))


def baked(
    size: int,
    environment: EnvironmentMap,
    sampling: Sampling,
    seed: int,
    *,
    albedo: float = ALBEDO,
) -> Lightmap:
    """The lightmap of a perfect capture of the N-probe: path-traced shading of its faces.

    Where several faces have one configuration, their mean.
    """
    faces: VoxelFaces = exposed_faces(star_probe(size))
    points = faces.points(SIZE)
    normals = torch.from_numpy(NORMALS).double()[faces.orientation]
    found = shade(
        points.reshape(-1, 3),
        normals.repeat_interleave(SIZE * SIZE, 0),
        DiffuseScene.uniform(*faces.triangles(), albedo),
        environment,
        albedo=albedo,
        sampling=sampling,
        generator=torch.Generator().manual_seed(seed),
    ).mean.reshape(len(faces), SIZE, SIZE, 3)
    total = torch.zeros(192, SIZE, SIZE, 3, dtype=found.dtype)
    total.index_add_(0, faces.slot, found)
    count = faces.counts()
    radiance = total / count.clamp(min=1).reshape(-1, 1, 1, 1)
    known = (count > 0).float()
    return Lightmap(
        radiance=radiance.reshape(6, 32, SIZE, SIZE, 3).float(), coverage=known, confidence=known
    )


PROBES = (3, 5)
KINDS = ("direct", "global")
MAPS = 8
LIGHT_HEIGHT = 128
TRANSFER = "transfer"
THESIS_L1 = {
    "probe3_direct": 0.0115,
    "probe3_global": 0.0113,
    "probe5_direct": 0.0113,
    "probe5_global": 0.0094,
}
ORDER = (
    ("probe3_global", "probe3_direct"),
    ("probe5_global", "probe5_direct"),
    ("probe5_direct", "probe3_direct"),
    ("probe5_global", "probe3_global"),
)


@dataclass(frozen=True, kw_only=True)
class VoxelProbe(ProbeEvaluation):
    """``data`` holds the folders hdr (maps and an index.csv) and meshes: the first ``models``."""

    title = "voxel-probe"
    # one map, one mesh, noisy references, and some of the sets
    quick = MappingProxyType({"maps": 1, "models": 1, "samples": 32, "best": 6, "every_set": 20})

    maps: int = MAPS
    models: int = len(MODELS)
    samples: int = 256
    best: int = 12
    every_set: int = 1

    def __post_init__(self) -> None:
        if self.maps < 1 or not 1 <= self.best < LIT:
            raise InputError(
                f"one map or more and sets of 1 to {LIT - 1} are needed, got {self.maps} and "
                f"{self.best}"
            )
        _ = self.meshes
        if len(self.items()) < 2:
            raise InputError(f"{self.probes / INDEX_NAME}: no map in it")

    @property
    def meshes(self) -> dict[str, Path]:
        """The models by name: of the Stanford ones without the university's."""
        files = mesh_files(self.data, MODELS[: self.models])
        return {path.stem.removeprefix("stanford_"): path for path in files}

    def config(self) -> dict[str, object]:
        return super().config() | {"meshes": list(self.meshes)}

    def items(self) -> list[str]:
        files = list(read_categories(self.probes))
        return [*files[:: max(1, len(files) // self.maps)][: self.maps], TRANSFER]

    def measure(self, item: str, picture: Path) -> Item:
        if item == TRANSFER:
            return self._transfer(picture)
        light = read_environment_map(self.probes / item).resize(LIGHT_HEIGHT)
        sampling = Sampling(samples=self.samples)
        scores: dict[str, dict[str, list[float]]] = {}
        shown: dict[str, Picture] = {}
        noise = {}
        completed = self._completed(light, sampling)
        for model, mesh in self.meshes.items():
            scene = voxel_scene(mesh)
            truths, masks, noise[model] = scene.traced(light, sampling, self.seed + 1)
            white = 2 * float(truths[0][masks[0]].mean())
            shown[model] = _side_by_side(truths, white)
            for method, lightmap in completed.items():
                drawings = scene.drawn(lightmap)
                shown[f"{model}, {method}"] = _side_by_side(drawings, white)
                for drawing, truth, mask in zip(drawings, truths, masks, strict=True):
                    found = shading_metrics(drawing, truth, mask)
                    found["ssim_model"] = found.pop("ssim")
                    found["ssim"] = ssim(drawing, truth)
                    for metric, value in found.items():
                        for name in (metric, f"{metric}_{model}"):
                            scores.setdefault(method, {}).setdefault(name, []).append(value)
        write_png(picture, captioned_rows(shown, columns=1 + len(completed)))
        metrics: Metrics = {
            method: {name: sum(v) / len(v) for name, v in of.items()}
            for method, of in scores.items()
        }
        return Item(name=item, metrics=metrics, facts={"noise": noise})

    def _completed(self, light: EnvironmentMap, sampling: Sampling) -> dict[str, Lightmap]:
        found = {}
        for size in PROBES:
            captured = baked(size, light, sampling, self.seed)
            for kind in KINDS:
                found[f"probe{size}_{kind}"] = reconstruction(size, kind).complete(captured)
        return found

    def _transfer(self, picture: Path) -> Item:
        """Figs. 3.6, 3.7 and 3.9."""
        metrics: Metrics = {}
        for size in PROBES:
            for kind in KINDS:
                error = transfer_error(reconstruction(size, kind), ALBEDO)
                metrics[f"probe{size}_{kind}"] = {
                    "transfer_l1": error.mean,
                    "transfer_l1_std": error.std,
                }
        occluders = {n: float(r.mean()) for n, r in residuals_by_occluders(albedo=ALBEDO).items()}
        best = best_sets(self.best, albedo=ALBEDO, exhaustive=min(self.best, 7))
        plot_residuals(picture, occluders, [one.residual for one in best])
        facts = {
            "by_occluders": {str(most): left for most, left in occluders.items()},
            "best_sets": [
                {"configurations": list(one.configurations), "residual": one.residual}
                for one in best
            ],
            **self._sets_of_five(),
        }
        return Item(name=TRANSFER, metrics=metrics, facts=facts)

    def _sets_of_five(self) -> dict[str, object]:
        """Mean squared residual of other lit slots: over all sets of five, and the 3-probe's."""
        lit = range(LIT)
        every = torch.tensor(list(combinations(lit, 5)))[:: self.every_set]
        total = 0.0
        for some in every.split(20_000):
            total += float(residuals(some, albedo=ALBEDO)[:, :LIT].sum())
        mean = total / len(every) / (LIT - 5)
        probe = residuals(torch.tensor([[0, 1, 2, 4, 8]]), albedo=ALBEDO)[0, :LIT]
        return {"sets_of_five": mean, "probe3_set": float(probe.sum()) / (LIT - 5)}

    def checks(self, rows: Rows, items: list[Item]) -> dict[str, Check]:
        """The thesis' numbers and orderings."""
        found: dict[str, Check] = {}
        facts = next((item.facts for item in items if item.name == TRANSFER), None)
        if facts is not None:
            ratio = float(facts["probe3_set"]) / float(facts["sets_of_five"])  # type: ignore[arg-type]
            found["3-probe / mean of sets of five, from below"] = Check.at_least(ratio, 0.86)
            found["3-probe / mean of sets of five, from above"] = Check.at_most(ratio, 0.90)
        for row, thesis in THESIS_L1.items():
            if "transfer_l1" not in rows[row]:
                continue
            off = abs(rows[row]["transfer_l1"]["mean"] / thesis - 1)
            found[f"transfer_l1 {row}, off the thesis' {thesis}"] = Check.at_most(off, 0.25)
        for metric in ("transfer_l1", "mae"):
            if metric not in rows["probe3_direct"]:
                continue
            value = {row: rows[row][metric]["mean"] for row in THESIS_L1}
            for better, worse in ORDER:
                found[f"{metric}: {better} <= {worse}"] = Check.at_most(value[better], value[worse])
        for row in THESIS_L1:
            if "mae" in rows[row]:
                found[f"mae {row}"] = Check.at_most(rows[row]["mae"]["mean"], 0.09)
                found[f"ssim {row}"] = Check.at_least(rows[row]["ssim"]["mean"], 0.95)
        return found


def plot_residuals(path: Path, occluders: dict[int, float], best: list[float]) -> None:
    """Figs. 3.6 and 3.7: mean squared residuals of what is left to complete."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.bar([f"≤ {most}" for most in occluders], list(occluders.values()))
    left.set(xlabel="all faces of so many occluders known", ylabel="mean squared residual")
    right.plot(range(1, len(best) + 1), best, marker="o")
    right.set(xlabel="configurations in the best set")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    save_figure(path, figure)


def _side_by_side(views: list[Float[Tensor, "h w 3"]], white: float) -> Picture:
    return tone_map(torch.cat(views, 1), white=white)


@cache
def reconstruction(size: int, kind: str) -> SlotReconstruction:
    """The weights of an N-probe that was captured whole."""
    known = exposed_faces(star_probe(size)).counts() > 0
    return DirectReconstruction(known) if kind == "direct" else GlobalReconstruction(known)
