"""Observation -> light, by any of the light models."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.inverse.lbfgs import minimise
from skylight.inverse.objective import (
    GROUND_ALBEDOS,
    ObjectiveWeights,
    SkyObjective,
    best_exposure,
    charbonnier,
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

    scan_candidates: int = 4
    starts: int = 4
    levels: int = 4
    iterations: tuple[int, ...] = (30, 20, 15, 15)
    survivors: tuple[int, ...] = (4, 2, 1, 1)
    weights: ObjectiveWeights = ObjectiveWeights()


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """The light of a picture, in its camera's frame and its own radiance units.

    ``environment`` is a full 64 x 128 map; ``rendered`` (m,3) the observation's pixels under
    it; ``terms`` the parts of the objective (nats) at the end; ``params`` those of the light
    model. ``status`` says whether the optimisation ended at a minimum, and ``advice`` what to
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
    stats: dict[str, float]


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
    scaled = Observation(
        pixels=observation.pixels / scale,
        weights=observation.weights,
        places=observation.places,
        transport=observation.transport,
    )
    pyramid = [scaled.coarser(level) for level in reversed(range(options.levels))]
    objectives = [
        SkyObjective(o, model, light_prior, albedo_prior, options.weights) for o in pyramid
    ]
    scan = scan_sun(scaled.coarser(1), candidates=options.scan_candidates)
    free, scores = _starts(objectives[1 if options.levels > 1 else 0], scan.candidates, albedo_modes)
    free = _best_apart(free, scores, options.starts)
    evaluations = nonfinite = 0
    result = None
    for level, objective in enumerate(objectives):
        result = minimise(objective, free, iterations=options.iterations[level])
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
    layout = (2 * model.grid.layout[0], model.grid.layout[1])  # type: ignore[index]
    environment = EnvironmentMap(radiance=full.reshape(*layout, 3))
    status: Status = "converged" if bool(result.converged[best]) else "iteration limit"
    if nonfinite:
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
        },
    )


def solve_harmonic(
    observation: Observation,
    model: HarmonicLight,
    albedo_prior: Prior,
    albedo_modes: Float[Tensor, "k 3"],
) -> Estimate:
    """Charbonnier fit of SH coefficients by reweighted linear least squares, cut off at zero.

    Shading is linear in the coefficients, so there is one minimum and no start to choose. The
    fit knows only albedo times light; of the skin prior's modes the one is taken that leaves
    the light most neutral, plus its negative log-likelihood (the ambiguity of Eq. 5.9).
    """
    shading = observation.transport.project(model.basis)
    pixels = observation.pixels
    scale = float(luminance(pixels).mean())
    weights = observation.weights
    for _ in range(8):
        product = solve_linear(shading, pixels, weights)
        residual = charbonnier((shading @ product - pixels) / scale).mean(1)
        weights = observation.weights / residual
    mean = (shading @ product).mean(0).clamp(min=1e-6 * scale)
    chroma = torch.log(mean / albedo_modes)
    chroma = chroma - chroma.mean(1, keepdim=True)
    # daylight's colour varies by about 0.15 in the log of its channels' ratios
    cost = 0.5 * (chroma**2).sum(1) / 0.15**2 - albedo_prior.log_prob(albedo_modes)
    albedo = albedo_modes[cost.argmin()]
    coefficients = product / albedo
    with torch.no_grad():
        radiance = model.radiance(coefficients.reshape(1, -1))[0]
    environment = EnvironmentMap(radiance=radiance.reshape(*model.grid.layout, 3).float())
    rendered = albedo * (observation.transport.matrix @ environment.flat)
    ground = environment.radiance[model.grid.layout[0] // 2 :].reshape(-1, 3).mean(0)
    down = environment.upper().irradiance(torch.tensor([0.0, 1.0, 0.0])) / torch.pi
    residual = charbonnier((shading @ product - pixels) / scale)
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
        terms={"data": float(defaults.independent / defaults.noise * (residual * share).sum())},
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
    """Packed starts and their objective, each with its best exposure and albedo mode."""
    model = objective.model
    towards = model.starts_towards(directions).flatten(0, 1).float()
    centroids = model.starts().float()
    if model.azimuth_index is not None:
        i = model.azimuth_index
        centroids = centroids.clone()
        centroids[:, i] = towards[0, i]
    light = torch.cat([towards, centroids])
    sky = model.radiance(light)
    ground = torch.full((len(light), 3), START_GROUND)
    ones = torch.ones(len(light), 3)
    bare = objective.transport(sky, objective.ground.radiance(sky, ground), ones)
    best = torch.full((len(light),), torch.inf)
    packed = torch.zeros(len(light), objective.size)
    for mode in albedo_modes:
        albedo = mode.expand(len(light), 3)
        exposure = best_exposure(bare * mode, objective.target, objective.share)
        free = objective.pack(light, exposure, albedo, ground)
        # the sky need not be rendered again: shading is linear in exposure and albedo
        shading = bare * mode * exposure[:, None, None]
        residual = charbonnier(shading - objective.target)
        w = objective.weights
        loss = w.independent / w.noise * (residual * objective.share).sum((1, 2))
        loss = loss - w.albedo_prior * objective.albedo_prior.log_prob(albedo)
        better = loss < best
        best = torch.where(better, loss, best)
        packed = torch.where(better[:, None], free, packed)
    return packed, best


def _best_apart(
    free: Float[Tensor, "s q"], scores: Float[Tensor, " s"], count: int
) -> Float[Tensor, "t q"]:
    """The best starts."""
    return free[scores.argsort()[:count]]


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


