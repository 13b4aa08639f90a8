"""Scores of a predicted environment map against the true one.

:func:`score` has the metrics of the thesis' tables, :func:`score_maps` all metrics, with the scale
of the prediction as it is and aligned to the truth. Some are of three spheres under either light:
mirror, matte silver, matte diffuse (:func:`render_spheres`), the protocol by which papers on
lighting estimation compare (LeGendre et al. 2019, "DeepLight"; Wang et al. 2022, "StyleLight";
Phongthawee et al. 2024, "DiffusionLight"). They differ in renderer, sizes and materials and do not
state all of them, so that figures compare only within one set of constants. Ours, in this place
only:

* camera: orthographic, looks along -Z; each sphere fills a square of 64 x 64 pixels; the picture is
  the pixels whose centres lie inside (3,228 of them); nothing else is in the scene;
* light: the map resized to 64 rows, energy kept; no shadows, no light between spheres;
* mirror: reflectance 1 at every angle;
* silver: a GGX metal of alpha 0.25 (roughness 0.5), reflectance 1 at every angle, single
  scattering with height-correlated Smith masking;
* diffuse: Lambertian, albedo 0.5.

Reflectances scale a picture and its truth alike: no metric here depends on them.

:func:`find_lamps` tells where over the sphere the light of a map is concentrated. Lamps are peeled
off one after the other: with luminance L, its median m over solid angle and the excess
``e(w) = max(L(w) - m, 0)``, the next lamp is the cap of 15 degrees with the most excess that is
left; it is centred on the centroid of what is in it (mean shift), which is the lamp's direction,
and removed. Its share is ::

    int_cap e dw / int_sphere L dw.

Lamps less than 30 degrees apart may count as one, and a wide window as several.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, takewhile
from typing import Literal, get_args

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight._modes import constant
from skylight.errors import InputError
from skylight.imaging._metrics import (
    lighting_metrics,
    mae,
    rmse,
    shading_metrics,
    si_rmse,
    sun_angle_deg,
)
from skylight.skies._sun import find_sun
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid, cosines
from skylight.sphere._projections import from_latlong
from skylight.sphere._row_kernels import RowKernels
from skylight.transport._matrix import TransportMatrix
from skylight.transport._reflection import specular_transport
from skylight.transport._render import Specular
from skylight.transport._scene import EvaluationScene, evaluation_scene

SphereMaterial = Literal["mirror", "silver", "diffuse"]
PIXELS = 64
LIGHT_ROWS = 64
SILVER = Specular(f0=1.0, roughness=0.5)
DIFFUSE_ALBEDO = 0.5


@dataclass(frozen=True, kw_only=True)
class SphereTransport:
    """``inside`` (64,64) is the picture; ``diffuse`` and ``silver`` (m,n) are its transport."""

    inside: Bool[Tensor, "h w"]
    diffuse: TransportMatrix
    silver: TransportMatrix


def render_spheres(environment: EnvironmentMap) -> dict[SphereMaterial, Float[Tensor, "m 3"]]:
    """Radiance at the m pixels of each sphere, in rows from the top.

    diffuse: albedo / pi sum_w L(w) <n,w>+ dw; silver: sum_w f_s(n,w,v) L(w) <n,w>+ dw with v = +Z;
    mirror: the mean of L over the directions that the pixel reflects.

    Raises
    ------
    InputError
        A sky alone, which has no lower half.
    """
    if environment.is_sky:
        raise InputError("spheres need light from all round: give a full lat-long map")
    if environment.layout[0] != LIGHT_ROWS:
        environment = environment.resize(LIGHT_ROWS)
    spheres = sphere_transport()
    light = environment.flat.float()
    mirror = from_latlong(environment, "mirrorball", PIXELS)
    return {
        "mirror": mirror[spheres.inside],
        "silver": spheres.silver.matrix @ light,
        "diffuse": DIFFUSE_ALBEDO * (spheres.diffuse.matrix @ light),
    }


@constant()
def sphere_transport() -> SphereTransport:
    """Built once: 2 matrices of 3,228 x 8,192 float32, 210 MB."""
    edge = (torch.arange(PIXELS, dtype=torch.float64) + 0.5) / PIXELS * 2 - 1
    y, x = torch.meshgrid(-edge, edge, indexing="ij")
    height = (1 - x**2 - y**2).clamp(min=0).sqrt()
    inside = x**2 + y**2 < 1
    normals = torch.stack([x, y, height], -1)[inside]
    grid = DirectionGrid.latlong(LIGHT_ROWS)
    cosine = cosines(normals.float(), grid.directions.float()).clamp(min=0)
    diffuse = TransportMatrix(matrix=cosine * (grid.solid_angles / math.pi).float(), grid=grid)
    towards_camera = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand_as(normals)
    silver = specular_transport(diffuse, normals, towards_camera, SILVER)
    return SphereTransport(inside=inside, diffuse=diffuse, silver=silver)


def angular_error_deg(pred: Float[Tensor, "m 3"], true: Float[Tensor, "m 3"]) -> float:
    """Mean over pixels of the angle between predicted and true RGB as vectors, in degrees.

    Pixels whose truth is black have no colour and are left out; a prediction that is black where
    the truth is not counts 90 degrees.

    Raises
    ------
    InputError
        The truth is black everywhere.
    """
    p, t = pred.double(), true.double()
    lit = t.norm(dim=1) > 0
    if not lit.any():
        raise InputError("the true render is black: its colours mean nothing")
    p, t = p[lit], t[lit]
    # atan2: acos of a cosine near 1 would lose half the digits
    cross = torch.linalg.cross(p, t).norm(dim=1)
    angle = torch.atan2(cross, (p * t).sum(1))
    angle = torch.where(p.norm(dim=1) > 0, angle, math.pi / 2)
    return math.degrees(float(angle.mean()))


Alignment = Literal["unaligned", "mean", "least_squares"]
SCALE_FREE = "scale_free"
# metric -> alignment (or SCALE_FREE) -> value
Scores = dict[str, dict[str, float]]


def scale_factor(
    pred: Float[Tensor, "n 3"],
    true: Float[Tensor, "n 3"],
    alignment: Alignment,
    weights: Float[Tensor, " n"] | None = None,
) -> float:
    """The factor on a prediction: 1; sum w t / sum w p; or sum w p t / sum w p^2.

    Over all channels together, so colours are never corrected; 1 for a black prediction.
    """
    if alignment == "unaligned":
        return 1.0
    p, t = pred.double(), true.double()
    w = torch.ones(len(p), 1).double() if weights is None else weights.double()[:, None]
    above, below = (w * t, w * p) if alignment == "mean" else (w * p * t, w * p * p)
    total = float(below.sum())
    return float(above.sum()) / total if total > 0 else 1.0


def score_maps(predicted: EnvironmentMap, truth: EnvironmentMap) -> tuple[Scores, bool]:
    """All metrics, and whether the truth shows a sun; docs/scores.md has the formulas.

    Both are full maps of one size. Pictures of the evaluation scene (``scene_...``), the maps
    themselves (``full_dw_mae`` and its kind) and each sphere are aligned each by its own factor;
    ``brightness`` is the factor by which the prediction is too bright, by the scene's mean. What
    speaks of the sun is left out where the truth shows none (thesis, 5.5.1).

    Raises
    ------
    InputError
        Maps of two sizes, a sky alone, or a black truth.
    """
    if predicted.is_sky or truth.is_sky:
        raise InputError("scores need full maps: give a sky a lower half first")
    if predicted.layout != truth.layout:
        raise InputError(
            f"maps of {predicted.layout} and {truth.layout} pixels: resize one of them"
        )
    if not truth.radiance.sum() > 0:
        raise InputError("the true light is black: there is nothing to compare with")
    scores: Scores = {}
    _score_scene(scores, predicted, truth)
    sun_visible = truth.upper().radiance.sum() > 0 and find_sun(truth.upper()).visible
    _score_light(scores, predicted, truth, sun_visible=bool(sun_visible))
    _score_spheres(scores, predicted, truth)
    return scores, bool(sun_visible)


def _score_scene(scores: Scores, predicted: EnvironmentMap, truth: EnvironmentMap) -> None:
    scene = evaluation_scene()
    shaded, true = scene.shade(predicted), scene.shade(truth)
    shown, covered = scene.diffuse.image(true), _covered(scene)
    for alignment in get_args(Alignment):
        picture = scene.diffuse.image(shaded * scale_factor(shaded, true, alignment))
        values = shading_metrics(picture, shown, covered)
        for name in ("mae", "rmse", "ssim"):
            scores.setdefault(f"scene_{name}", {})[alignment] = values[name]
    scores["scene_si_rmse"] = {SCALE_FREE: si_rmse(shaded, true)}
    scores["brightness"] = {SCALE_FREE: float(shaded.double().mean() / true.double().mean())}


def _score_light(
    scores: Scores, predicted: EnvironmentMap, truth: EnvironmentMap, *, sun_visible: bool
) -> None:
    factor = scale_factor(predicted.flat, truth.flat, "least_squares", truth.grid.solid_angles)
    fitted = EnvironmentMap(radiance=predicted.radiance * factor)
    values = {
        "unaligned": lighting_metrics(predicted, truth, align_scale=False),
        "mean": lighting_metrics(predicted, truth, align_scale=True),
        "least_squares": lighting_metrics(fitted, truth, align_scale=False),
    }
    for name in values["mean"]:
        if name == "sun_angle_deg" or (name.startswith("sun_") and not sun_visible):
            continue
        scores[name] = {alignment: metrics[name] for alignment, metrics in values.items()}
    if sun_visible:
        scores["sun_angle_deg"] = {SCALE_FREE: sun_angle_deg(predicted, truth)}


def _score_spheres(scores: Scores, predicted: EnvironmentMap, truth: EnvironmentMap) -> None:
    shown, true = render_spheres(predicted), render_spheres(truth)
    for material, picture in shown.items():
        for alignment in get_args(Alignment):
            aligned = picture * scale_factor(picture, true[material], alignment)
            for name, metric in (("rmse", rmse), ("mae", mae)):
                values = scores.setdefault(f"{material}_{name}", {})
                values[alignment] = metric(aligned, true[material])
        for name, value in _scale_free(material, picture, true[material]).items():
            scores[name] = {SCALE_FREE: value}


def sphere_scores(estimate: EnvironmentMap, truth: EnvironmentMap) -> dict[str, float]:
    """Of each of the three spheres (:func:`render_spheres`), whatever the scale of the estimate.

    ``{material}_si_rmse`` is the RMSE at the factor of least squares over the truth's mean,
    ``{material}_angle_deg`` the :func:`angular_error_deg`.
    """
    shown, true = render_spheres(estimate), render_spheres(truth)
    scores: dict[str, float] = {}
    for material, picture in shown.items():
        scores |= _scale_free(material, picture, true[material])
    return scores


def _scale_free(
    material: SphereMaterial, picture: Float[Tensor, "m 3"], true: Float[Tensor, "m 3"]
) -> dict[str, float]:
    return {
        f"{material}_si_rmse": si_rmse(picture, true),
        f"{material}_angle_deg": angular_error_deg(picture, true),
    }


CAP_RAD = math.radians(15)
MOST = 6
LEAST_SHARE = 0.05
ROWS = 64  # of the map that is looked at
_SHIFTS = 10


@dataclass(frozen=True, kw_only=True)
class MapLamp:
    """``direction`` is a unit vector (float64), ``share`` the part of all light beyond the rest's.

    All light is the integral of luminance over the sphere.
    """

    direction: Float[Tensor, "3"]
    share: float


def find_lamps(
    environment: EnvironmentMap,
    *,
    most: int = MOST,
    least_share: float = LEAST_SHARE,
    rows: int = ROWS,
) -> list[MapLamp]:
    """At most so many lamps of a full map, of more than ``least_share`` each, largest first.

    None for constant light and for a black map. They are looked for on so many ``rows``.
    """
    light = environment if environment.layout[0] == rows else environment.resize(rows)
    grid = light.grid
    level = luminance(light.flat).double()
    total = float(level @ grid.solid_angles)
    if total <= 0:
        return []
    excess = (level - _median(level, grid.solid_angles)).clamp(min=0) * grid.solid_angles
    lamps = islice(_peeled(excess / total, grid), most)
    chosen = takewhile(lambda lamp: lamp.share > least_share, lamps)
    return sorted(chosen, key=lambda lamp: -lamp.share)


def _peeled(excess: Float[Tensor, " n"], grid: DirectionGrid) -> Iterator[MapLamp]:
    """One lamp after the other, until there is no excess."""
    while bool(excess.any()):
        rows = grid.layout[0]  # type: ignore[index]
        centre = _centres(rows).directions[_caps(rows).gathered(excess).argmax()]
        for _ in range(_SHIFTS):
            cap = (grid.directions @ centre) > math.cos(CAP_RAD)
            centroid = (excess * cap) @ grid.directions
            centre = centroid / centroid.norm()
        cap = (grid.directions @ centre) > math.cos(CAP_RAD)
        yield MapLamp(direction=centre, share=float(excess[cap].sum()))
        excess = excess.where(~cap, 0.0)


def _median(level: Float[Tensor, " n"], weights: Float[Tensor, " n"]) -> Float[Tensor, ""]:
    order = level.argsort()
    below = weights[order].cumsum(0)
    return level[order[int((below < below[-1] / 2).sum())]]


def _centres(rows: int) -> DirectionGrid:
    """Of the caps that are tried, before they are centred: 5.6 degrees apart on 64 rows."""
    return DirectionGrid.latlong(rows // 2)


@constant(2)
def _caps(rows: int) -> RowKernels:
    """1 where a pixel lies within the cap about a centre."""

    def within(grid: DirectionGrid, centres: Float[Tensor, "r 3"]) -> Float[Tensor, "n r"]:
        return (cosines(grid.directions, centres) > math.cos(CAP_RAD)).double()

    return RowKernels.of(within, DirectionGrid.latlong(rows), _centres(rows))


def score(
    estimate: EnvironmentMap, truth: EnvironmentMap, *, sun_visible: bool
) -> dict[str, float]:
    """Shading metrics on the evaluation scene and lighting metrics on the probes.

    A picture tells albedo times light, so how bright the light is rests on the skin prior:
    ``brightness`` is the shading's mean over the truth's, and ``mae_aligned`` and
    ``rmse_aligned`` are what is left once it is made 1, the other reading of the thesis'
    "mapping the average image intensity to 1".

    What speaks of the sun (``sun_...``) is left out where none is visible (thesis, 5.5.1).
    """
    scene = evaluation_scene()
    height = truth.layout[0]
    if estimate.layout != truth.layout:
        estimate = estimate.resize(height)
    shaded, true = scene.shade(estimate), scene.shade(truth)
    shading = shading_metrics(
        scene.diffuse.image(shaded), scene.diffuse.image(true), _covered(scene)
    )
    brightness = float(shaded.double().mean() / true.double().mean())
    aligned = shaded / max(brightness, 1e-12)
    shading |= {
        "mae_aligned": mae(aligned, true),
        "rmse_aligned": rmse(aligned, true),
        "brightness": brightness,
    }
    lighting = {
        name: value
        for name, value in lighting_metrics(estimate, truth).items()
        if sun_visible or not name.startswith("sun_")
    }
    return shading | lighting


def _covered(scene: EvaluationScene) -> Bool[Tensor, "h w"]:
    return scene.diffuse.image(torch.ones(len(scene.diffuse), 1))[..., 0] > 0
