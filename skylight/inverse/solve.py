"""Observation -> light, by any of the light models."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.inverse.lbfgs import minimise
from skylight.inverse.objective import (
    ObjectiveWeights,
    SkyObjective,
    best_exposure,
    charbonnier,
    data_term,
)
from skylight.inverse.scan import scan_sun
from skylight.models.base import LightModel, Prior
from skylight.models.harmonic import HarmonicLight, solve_linear
from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.transport.observation import Observation

Status = Literal["converged", "iteration limit", "recovered from a non-finite step"]
START_GROUND = 0.2  # thesis, B.1


@dataclass(frozen=True, kw_only=True)
class SolverOptions:
    """Effort of the optimisation: starts kept, pyramid levels, iterations on each level."""

    scan_candidates: int = 3
    starts: int = 3
    levels: int = 4
    iterations: tuple[int, ...] = (20, 15, 10, 15)
    survivors: tuple[int, ...] = (2, 1, 1, 1)
    tolerance: float = 1e-4
    weights: ObjectiveWeights = ObjectiveWeights()


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """The light of a picture, in its camera's frame and its own radiance units.

    ``environment`` is a full 64 x 128 map; ``rendered`` (m,3) the observation's pixels under
    it; ``terms`` the parts of the objective (nats) at the end; ``params`` those of the light
    model. ``status`` is "converged" where the optimisation ended at a minimum, else how it ended
    (``stats["nonfinite"]`` counts steps taken back in either case), and ``advice`` says what to
    do where the result should not be trusted (empty where nothing is known against it).
    """

    light: str
    environment: EnvironmentMap
    params: Float[Tensor, " p"]
    exposure: float
    albedo: Float[Tensor, "3"]
    ground_albedo: Float[Tensor, "3"]
    sun_direction: Float[Tensor, "3"]
    rendered: Float[Tensor, "m 3"]
    terms: dict[str, float]
    status: Status
    advice: tuple[str, ...]
    stats: dict[str, float | int]


def solve_sky(
    observation: Observation,
    model: LightModel,
    light_prior: Prior,
    albedo_prior: Prior,
    albedo_modes: Float[Tensor, "k 3"],
    options: SolverOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> Estimate:
    """Minimise Eq. 5.8 from the best of many starts, coarse to fine.

    Starts: the directions of the linear scan, each with the model's candidates, and the
    mixture's centroids turned to the best of them; each with the albedo mode that explains the
    picture best. All are scored on the coarsest level, the best few optimised as one batch,
    fewer on every finer level; the best end point wins.
    """
    options = options or SolverOptions()
    scale = float(luminance(observation.pixels).mean())
    scaled = observation.scaled(1 / scale)
    pyramid = [scaled.coarser(level) for level in reversed(range(options.levels))]
    objectives = [
        SkyObjective(o, model, light_prior, albedo_prior, options.weights) for o in pyramid
    ]
    scan = scan_sun(scaled.coarser(1), candidates=options.scan_candidates)
    free, scores = _starts(objectives[0], scan.candidates, albedo_modes)
    free = free[scores.argsort()[: options.starts]]
    evaluations = nonfinite = 0
    result = None
    for level, objective in enumerate(objectives):
        result = minimise(
            objective, free, iterations=options.iterations[level], tolerance=options.tolerance
        )
        evaluations += result.evaluations
        nonfinite += result.nonfinite
        order = result.loss.argsort()
        free = result.x[order[: options.survivors[level]]]
        if progress is not None:
            progress((level + 1) / options.levels)
    assert result is not None
    best = int(result.loss.argmin())
    final = result.x[best : best + 1]
    objective = objectives[-1]
    with torch.no_grad():
        parts = objective.unpack(final)
        rendered = objective.shading(parts)[0] * scale
        sky = model.radiance(parts.light) * (parts.exposure * scale)[:, None, None]
        full = objective.ground.append(sky, parts.ground_albedo)[0]
        terms = {k: float(v) for k, v in objective.terms(final).items()}
    sky_layout = model.grid.layout
    assert sky_layout is not None
    environment = EnvironmentMap(radiance=full.reshape(2 * sky_layout[0], sky_layout[1], 3))
    status: Status = "converged" if bool(result.converged[best]) else "iteration limit"
    if nonfinite and status != "converged":
        status = "recovered from a non-finite step"
    return Estimate(
        light=model.name,
        environment=environment,
        params=parts.light[0],
        exposure=float(parts.exposure) * scale,
        albedo=parts.albedo[0],
        ground_albedo=parts.ground_albedo[0],
        sun_direction=environment.brightest_direction(),
        rendered=rendered,
        terms=terms,
        status=status,
        advice=_advice(observation, rendered),
        stats={
            "evaluations": evaluations,
            "nonfinite": nonfinite,
            "scan_residual": float(scan.residuals.min()),
            "sun_strength": float(scan.strengths[0]),
            "gloss": float(parts.gloss),
        },
    )


def solve_harmonic(
    observation: Observation,
    model: HarmonicLight,
    albedo_prior: Prior,
    albedo_modes: Float[Tensor, "k 3"],
) -> Estimate:
    """Robust fit of SH coefficients by eight reweighted linear least squares, cut off at zero.

    A pixel's weight is divided by its mean Charbonnier residual over the channels, which share
    it. Shading is linear in the coefficients, so there is no start to choose. Surface reflection
    is left out: highlights count as outliers. ``status`` is "converged" by construction. The
    fit knows only albedo times light; of the skin prior's modes the one is taken that leaves
    the light most neutral, plus its negative log-likelihood (the ambiguity of Eq. 5.9).
    """
    # float64: rounding in the reweighting does not reach the float32 of the result
    shading = observation.transport.project(model.basis).double()
    pixels = observation.pixels.double()
    scale = float(luminance(pixels).mean())
    weights = observation.weights.double()
    for _ in range(8):
        product = solve_linear(shading, pixels, weights)
        residual = charbonnier((shading @ product - pixels) / scale).mean(1)
        weights = observation.weights / residual
    mean = (shading @ product).mean(0).clamp(min=1e-6 * scale)
    chroma = torch.log(mean / albedo_modes)
    chroma = chroma - chroma.mean(1, keepdim=True)
    # daylight's colour varies by about 0.15 in the log of its channels' ratios
    cost = 0.5 * (chroma**2).sum(1) / 0.15**2 - albedo_prior.log_prob(albedo_modes.log())
    albedo = albedo_modes[cost.argmin()]
    coefficients = (product / albedo).to(observation.pixels)
    with torch.no_grad():
        radiance = model.radiance(coefficients.reshape(1, -1))[0]
    layout = model.grid.layout
    assert layout is not None
    environment = EnvironmentMap(radiance=radiance.reshape(*layout, 3).float())
    rendered = albedo * (observation.transport.matrix @ environment.flat)
    ground = environment.radiance[layout[0] // 2 :].reshape(-1, 3).mean(0)
    down = environment.upper().irradiance(torch.tensor([0.0, 1.0, 0.0])) / torch.pi
    residual = (shading @ product - pixels) / scale
    share = observation.weights[:, None] / observation.weights.sum() / 3
    defaults = ObjectiveWeights()
    return Estimate(
        light=model.name,
        environment=environment,
        params=coefficients.reshape(-1),
        exposure=1.0,
        albedo=albedo,
        ground_albedo=(ground / down.clamp(min=1e-12)).clamp(0, 1),
        sun_direction=environment.brightest_direction(),
        rendered=rendered,
        terms={"data": float(data_term(residual, share, defaults))},
        status="converged",
        advice=_advice(observation, rendered),
        stats={"evaluations": 8, "nonfinite": 0},
    )


@torch.no_grad()
def _starts(
    objective: SkyObjective,
    directions: Float[Tensor, "d 3"],
    albedo_modes: Float[Tensor, "k 3"],
) -> tuple[Float[Tensor, "s q"], Float[Tensor, " s"]]:
    """Packed starts and their scores, each with its best exposure and albedo mode.

    The score is data and albedo prior alone: how likely a sky is counts from the first step on.
    """
    model = objective.model
    towards = model.starts_towards(directions).flatten(0, 1).float()
    centroids = model.starts().float()
    if model.azimuth_index is not None:
        i = model.azimuth_index
        centroids = centroids.clone()
        centroids[:, i] = towards[0, i]
    light = torch.cat([towards, centroids])
    sky = model.radiance(light)
    ground_albedo = torch.full((len(light), 3), START_GROUND)
    ground = objective.ground.radiance(sky, ground_albedo)
    ones = torch.ones(len(light), 3)
    diffuse = objective.transport(sky, ground, ones)
    glossy = torch.zeros_like(diffuse)
    if objective.gloss is not None:
        glossy = objective.gloss(sky, ground, ones)
    best = torch.full((len(light),), torch.inf)
    packed = torch.zeros(len(light), objective.size)
    w = objective.weights
    for mode in albedo_modes:
        # the sky need not be rendered again: shading is linear in exposure and albedo
        shading = diffuse * mode + glossy
        exposure = best_exposure(shading, objective.target, objective.share)
        residual = shading * exposure[:, None, None] - objective.target
        loss = data_term(residual, objective.share, w)
        albedo = mode.expand(len(light), 3)
        loss = loss - w.albedo_prior * objective.albedo_prior.log_prob(albedo.log())
        free = objective.pack(light, exposure, ones[:, 0], albedo, ground_albedo)
        packed = torch.where((loss < best)[:, None], free, packed)
        best = torch.minimum(loss, best)
    return packed, best


def _advice(observation: Observation, rendered: Float[Tensor, "m 3"]) -> tuple[str, ...]:
    """What the residual tells about trust."""
    true = luminance(observation.pixels)
    error = (luminance(rendered) - true).abs().mean() / true.mean()
    if float(error) > 0.25:
        return (
            f"the re-rendered face is off by {100 * float(error):.0f} % on average: the light is "
            "unreliable; check the mesh overlay, or use a picture with less hair, glasses or gloss",
        )
    return ()
