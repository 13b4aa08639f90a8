"""Illumination of any kind from rendered faces: rooms, studios and nights beside skies."""

import math
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from jaxtyping import Complex, Float
from torch import Tensor

from skylight._modes import constant
from skylight._names import DEFAULT_LIGHT, LightName
from skylight.errors import InputError
from skylight.evaluation._known_faces import (
    FaceSource,
    KnownFaceEvaluation,
    coverage,
    face_score,
    lamps_chosen,
    pose_error_deg,
)
from skylight.evaluation._pictures import beside, strip
from skylight.evaluation._run import Check, Item, Rows
from skylight.evaluation._tables import LABELS
from skylight.faces._skin import SkinPrior
from skylight.inverse._posterior import SunPosterior
from skylight.inverse._result import Lamp
from skylight.inverse._scores import LEAST_SHARE, MapLamp, find_lamps, sphere_scores
from skylight.io._files import write_png
from skylight.models._lamps import LampsLight
from skylight.people._files import read_scene_facts
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid, angle_between
from skylight.transport._observation import Observation

OURS = DEFAULT_LIGHT  # what is to meet the goals, where it is among the methods
SMOOTH, SKIES, GREY = "sh25", "autoencoder", "grey"
ROWS = 64  # of the grey light
MAIN_SHARE = 0.4  # a lamp whose direction is asked for
LARGE_SHARE, NEAR_DEG = 0.2, 20.0  # lamps to be found, and how far away one counts
NO_LAMP_DEG = 90.0  # the mean over random directions
_ON_GRID_RAD = math.radians(3)  # half the diagonal of a cell of the posterior is 2 degrees
MEDIAN_DEG, MEAN_FOUND, SI_RMSE_RATIO, BETTER_SHARE = 12.0, 0.70, 0.6, 0.9
COVERED = 0.85, 0.95
COMPARED = ("mae", "rmse", "full_dw_mae")
# Medians, in log units.
LEVELS = {
    "whole_colour": 0.07,
    "lower_colour": 0.10,
    "whole_level": 0.25,
    "lower_level": 0.20,
    "log_radiance": 0.65,
}
DARK = 0.01  # of the picture's white: what is darker is black in 8 bits
BLUR_DEG = 3.0  # about a pixel
_LEAST = 1e-4  # mean radiance that a black half counts as


@dataclass(frozen=True, kw_only=True)
class AnyLight(KnownFaceEvaluation):
    """Faces of ``skylight faces render --maps`` in the folder ``data``, the first ``count`` of it.

    Every light model of ``methods`` has a row, and ``grey`` is what one has without inverse
    lighting (:func:`grey_light`). Beside the scores of :func:`face_score`:

    * ``main_lamp_deg``, where the truth's main lamp holds more than 40 % of the light
      (:func:`find_lamps`): the angle between it and the estimate's (:func:`lamps_of`), however
      small that one's share is; an estimate without any (constant light) counts 90 degrees.
    * ``lamps_found``, where the truth has lamps of more than 20 %: the part of these with a lamp
      of more than 5 % of the estimate within 20 degrees.
    * ``in_region`` and ``region_sr``, as ``main_lamp_deg`` where the posterior's directions
      include the truth's main lamp.
    * ``whole_level``, ``lower_level``, ``whole_colour``, ``lower_colour`` and ``log_radiance``: the
      errors of :func:`level_scores`.
    * ``mirror_si_rmse`` and others of three spheres: :func:`sphere_scores`, in the picture's
      white balance, which is that of the truth.

    Faces that have one are grouped by what is behind them (``background``).
    """

    title = "any-light"
    needs = "faces under given maps, made by 'skylight faces render --maps DIR'"
    data_folder = "indoor"
    quick = MappingProxyType({"count": 12})

    data: Path
    count: int | None = None
    methods: tuple[LightName, ...] = (OURS, "sh25", "autoencoder", "lamps", "auto")

    def __post_init__(self) -> None:
        for name in self.items():
            if read_scene_facts(self.data / name)[0] is None:
                raise InputError(
                    f"{self.data / name}: lit by a simulated sky; any-light needs faces made by "
                    "'skylight faces render --maps DIR'"
                )

    @property
    def source(self) -> FaceSource:
        return FaceSource(data=self.data, count=self.count)

    def measure(self, item: str, picture: Path) -> Item:
        face, (turned, behind) = self.source.read(item), read_scene_facts(self.data / item)
        assert turned is not None  # checked beforehand
        lamps = find_lamps(face.environment)
        facts: dict[str, object] = {
            "map": turned.file,
            "turn_deg": turned.turn_deg,
            "skin tone": face.tone,
            "lamps": [lamp.share for lamp in lamps],
        }
        if turned.category is not None:
            facts["category"] = turned.category
        if behind is not None:
            facts["background"] = behind.kind
        found = self.lit(face, self.methods)
        environments = {name: one.environment for name, one in found.estimates.items()}
        environments[GREY] = grey_light(found.view.observation)
        metrics = found.metrics | {GREY: face_score(environments[GREY], face)}
        metrics[GREY] |= lamp_scores([], lamps)
        for name, environment in environments.items():
            estimate = found.estimates.get(name)
            gains = torch.ones(3) if estimate is None else estimate.white_balance
            seen = in_picture(environment, gains)
            metrics[name] |= level_scores(seen, face.environment)
            metrics[name] |= sphere_scores(seen, face.environment)
        for name, estimate in found.estimates.items():
            own = lamps_of(estimate.light, estimate.lamps, estimate.environment)
            metrics[name] |= lamp_scores(own, lamps)
            metrics[name] |= main_lamp_coverage(estimate.posterior, lamps)
        shown = f"{item} {Path(turned.file).stem}"
        write_png(picture, beside(face.encoded, strip(face.environment, environments), shown))
        facts |= {
            "verdicts": {name: one.verdict.summary for name, one in found.estimates.items()},
            "residuals": {name: one.faces[0].residual for name, one in found.estimates.items()},
            "pose_deg": pose_error_deg(found.fit, face.truth),
            "pixels": len(found.view.blocks),
            **found.facts,
        }
        return Item(name=item, metrics=metrics, facts=facts)

    def checks(self, rows: Rows, items: list[Item]) -> dict[str, Check]:
        """Goals of :data:`OURS`; none where it was not measured."""
        ours = rows.get(OURS)
        if ours is None:
            return {}
        checks: dict[str, Check] = {}
        if "main_lamp_deg" in ours:
            angle = ours["main_lamp_deg"]["median"]
            checks["median angle to the main lamp"] = Check.at_most(angle, MEDIAN_DEG)
        if "lamps_found" in ours:
            part = ours["lamps_found"]["mean"]
            checks["mean part of the lamps found"] = Check.at_least(part, MEAN_FOUND)
        for other in (SMOOTH, SKIES):
            if other in rows:
                ratio = ours["si_rmse"]["mean"] / rows[other]["si_rmse"]["mean"]
                checks[f"mean si_rmse over that of {other}"] = Check.at_most(ratio, SI_RMSE_RATIO)
        others = [name for name in (SMOOTH, GREY) if name in rows]
        for metrics in (*((metric,) for metric in COMPARED), COMPARED):
            share = share_of_maps_better(items, others, metrics)
            name = f"maps whose {', '.join(metrics)} is below that of {' and '.join(others)}"
            checks[name] = Check.at_least(share, BETTER_SHARE)
        checks |= lamps_chosen(items)
        for name, most in LEVELS.items():
            if name in ours:
                checks[f"median {LABELS[name]}"] = Check.at_most(ours[name]["median"], most)
        if "in_region" in ours:
            share = ours["in_region"]["mean"]
            checks["main lamp in the 90 % region"] = Check.within(share, *COVERED)
        return checks


def grey_light(observation: Observation) -> EnvironmentMap:
    """Constant grey light that explains a face's mean luminance by the skin prior's mean albedo.

    Its radiance is ``mean_p Y(pixel_p) / (Y(a) mean_p sum_w T_pw)``, with the observation's
    weights, Y luminance and a the prior's mean.
    """
    weights = observation.weights.double() / observation.weights.double().sum()
    seen = weights @ luminance(observation.pixels).double()
    shading = weights @ observation.transport.matrix.double().sum(1)
    level = seen / (luminance(SkinPrior.load().mean) * shading)
    return EnvironmentMap(radiance=level.float().expand(ROWS, 2 * ROWS, 3).contiguous())


def lamps_of(light: str, lamps: tuple[Lamp, ...], environment: EnvironmentMap) -> list[MapLamp]:
    """An estimate's own lamps, the strongest first; of a model without, those of its map."""
    if light != "lamps":
        return find_lamps(environment, least_share=0.0)
    total = float(luminance(environment.flat).double() @ environment.grid.solid_angles)
    shares = [
        float(luminance(lamp.irradiance) / LampsLight.facing(torch.tensor(lamp.spread_rad))) / total
        for lamp in lamps
    ]
    return [
        MapLamp(direction=lamp.direction, share=share)
        for lamp, share in zip(lamps, shares, strict=True)
    ]


def lamp_scores(found: list[MapLamp], truth: list[MapLamp]) -> dict[str, float]:
    """``main_lamp_deg`` and ``lamps_found``, each where the truth has lamps to ask for.

    ``found`` are an estimate's, the main one first.
    """
    scores: dict[str, float] = {}
    main = main_lamp(truth)
    if main is not None:
        scores["main_lamp_deg"] = _degrees(found[0].direction, main) if found else NO_LAMP_DEG
    large = [lamp.direction for lamp in truth if lamp.share > LARGE_SHARE]
    if large:
        seen = [lamp.direction for lamp in found if lamp.share > LEAST_SHARE]
        near = [any(_degrees(one, lamp) <= NEAR_DEG for one in seen) for lamp in large]
        scores["lamps_found"] = float(np.mean(near))
    return scores


def main_lamp(lamps: list[MapLamp]) -> Float[Tensor, "3"] | None:
    """The direction of the largest where it holds enough of the light to ask for it."""
    return lamps[0].direction if lamps and lamps[0].share > MAIN_SHARE else None


def main_lamp_coverage(posterior: SunPosterior, truth: list[MapLamp]) -> dict[str, float]:
    """:func:`coverage` of the main lamp, where there is one among the posterior's directions."""
    main = main_lamp(truth)
    if main is None:
        return {}
    directions = posterior.grid.directions
    nearest = directions[int((directions @ main).argmax())]
    if float(angle_between(nearest, main)) > _ON_GRID_RAD:
        return {}
    return coverage(posterior, main)


def in_picture(environment: EnvironmentMap, gains: Float[Tensor, "3"]) -> EnvironmentMap:
    """A map as a picture of that white balance would show it."""
    return EnvironmentMap(radiance=environment.radiance * gains)


def level_scores(estimate: EnvironmentMap, truth: EnvironmentMap) -> dict[str, float]:
    """Errors of colour and level in log units, in the picture's units; 0.1 is about a tenth.

    With e_c the log of the estimate's over the truth's mean radiance in channel c, over the solid
    angle of the ``whole`` map or its ``lower`` half, and m the mean of e over the channels: ::

        level = |m|,  colour = sqrt(mean_c (e_c - m)^2).

    ``log_radiance`` is the root of the mean over solid angle and channels of
    (log(L + 0.01) - log(L' + 0.01))^2 at 64 x 128, where 1 is the picture's white and both maps
    L and L' are blurred by a von Mises-Fisher lobe of 3 degrees.
    """
    if estimate.layout != truth.layout:
        estimate = estimate.resize(truth.layout[0])
    grid = truth.grid
    scores: dict[str, float] = {}
    for part, chosen in (("whole", torch.ones(len(grid))), ("lower", grid.directions[:, 1] < 0)):
        weights = grid.solid_angles * chosen
        means = (weights @ each.flat.double() / weights.sum() for each in (estimate, truth))
        ours, true = (mean.clamp(min=_LEAST).log() for mean in means)
        error = ours - true
        scores[f"{part}_colour"] = float(error.std(correction=0))
        scores[f"{part}_level"] = float(error.mean().abs())
    ours, true = (torch.log(blurred(each) + DARK) for each in (estimate, truth))
    weights = DirectionGrid.latlong(ROWS).solid_angles.reshape(ROWS, -1)
    mean = (weights[..., None] * (ours - true).square()).sum() / (3 * weights.sum())
    scores["log_radiance"] = math.sqrt(float(mean))
    return scores


def blurred(light: EnvironmentMap) -> Float[Tensor, "h w 3"]:
    """A map at 64 x 128, its means under lobes exp((cos a - 1) / s^2) of s = 3 degrees."""
    if light.layout[0] != ROWS:
        light = light.resize(ROWS)
    rows = torch.fft.rfft(light.radiance.double(), dim=1)
    return torch.fft.irfft(torch.einsum("ijf,jfc->ifc", _lobes(), rows), n=2 * ROWS, dim=1)


@constant()
def _lobes() -> Complex[Tensor, "h h f"]:
    """The lobes about row i over row j as Fourier coefficients of the angle between columns."""
    grid = DirectionGrid.latlong(ROWS)
    directions = grid.directions.reshape(ROWS, 2 * ROWS, 3)
    cosine = torch.einsum("ic,jwc->ijw", directions[:, 0], directions)
    lobes = ((cosine - 1) / math.radians(BLUR_DEG) ** 2).exp()
    lobes = lobes * grid.solid_angles.reshape(1, ROWS, -1)
    return torch.fft.rfft(lobes / lobes.sum((1, 2), keepdim=True), dim=2)


def share_of_maps_better(items: list[Item], others: list[str], metrics: tuple[str, ...]) -> float:
    """Of how many maps the mean over its faces of every metric is less for ours than for others."""
    faces: dict[object, list[Item]] = defaultdict(list)
    for item in items:
        if OURS in item.metrics:
            faces[item.facts["map"]].append(item)

    def mean(members: list[Item], method: str, metric: str) -> float:
        return float(np.mean([item.metrics[method][metric] for item in members]))

    better = [
        all(mean(one, OURS, m) < mean(one, other, m) for m in metrics for other in others)
        for one in faces.values()
    ]
    return float(np.mean(better))


def _degrees(a: Float[Tensor, "3"], b: Float[Tensor, "3"]) -> float:
    return math.degrees(float(angle_between(a, b)))
