"""Where to start: lights towards the sun's candidates, with exposures and albedos that fit."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.inverse.objective.face_term import FaceTerm
from skylight.inverse.objective.light_objective import LightObjective

START_GROUND = 0.2  # thesis, B.1


@torch.no_grad()
def choose_starts(
    objective: LightObjective,
    towards: Float[Tensor, "d c p"],
    albedo_modes: Float[Tensor, "k 3"],
    *,
    centroids: bool = True,
) -> tuple[Float[Tensor, "s q"], Float[Tensor, " s"]]:
    """Packed starts and their scores, each with its best exposures and albedo modes.

    The best of the c candidates for each of d directions (what the model has ``starts_towards``
    those of a scan), and with ``centroids`` the model's own starts, turned to the first.
    The score is data and the priors of albedo and the sun's place alone: how likely a sky is counts
    from the first step on.
    """
    model = objective.model
    count, towards = len(towards), towards.flatten(0, 1).to(albedo_modes)
    light = towards
    if centroids:
        others = model.starts().to(albedo_modes).clone()
        if model.azimuth_index is not None:
            others[:, model.azimuth_index] = towards[0, model.azimuth_index]
        light = torch.cat([towards, others])
    sky = model(light)
    ground_albedo = light.new_full((len(light), 0 if model.grid.is_sphere else 3), START_GROUND)
    if objective.known_ground is not None and not model.grid.is_sphere:
        ground_albedo[:] = light.new_tensor(objective.known_ground.albedo)
    ground = objective.ground_radiance(sky, ground_albedo)
    ones = light.new_ones(len(light), 3)
    losses = objective.sun_nll(light)
    if losses is None:
        losses = light.new_zeros(len(light))
    exposures = light.new_ones(len(light), objective.photo_count)
    albedos = light.new_ones(len(light), len(objective.faces), 3)
    for photo in range(objective.photo_count):
        mine = objective.faces_of(photo)
        shaded: list[_Shaded] = []
        for k in mine:
            face = objective.faces[k]
            diffuse = face.transport(sky, ground, ones)
            glossy = torch.zeros_like(diffuse)
            if face.gloss is not None:
                glossy = face.gloss(sky, ground, ones)
            shaded.append(_Shaded(face=face, diffuse=diffuse, glossy=glossy))
        start = _photo_start(objective, shaded, albedo_modes)
        exposures[:, photo], albedos[:, mine] = start.exposure, start.albedo
        losses = losses + start.loss
    gloss = light.new_ones(len(light), len(objective.faces))
    packed = objective.pack(light, exposures, gloss, albedos, ground_albedo)
    # one sky for each direction: many starts are to look in many directions
    each = losses[: len(towards)].unflatten(0, (count, -1)).min(1)
    every = torch.arange(len(light), device=light.device)
    first = every[:count] * (len(towards) // count)
    kept = torch.cat([first + each.indices, every[len(towards) :]])
    return packed[kept], losses[kept]


@dataclass(frozen=True, kw_only=True)
class _Shaded:
    """A face in the lights of all starts, apart: what its albedo scales and what its gloss."""

    face: FaceTerm
    diffuse: Float[Tensor, "s m 3"]
    glossy: Float[Tensor, "s m 3"]


@dataclass(frozen=True, kw_only=True)
class _PhotoStart:
    loss: Float[Tensor, " s"]
    exposure: Float[Tensor, " s"]
    albedo: Float[Tensor, "s f 3"]


def _photo_start(
    objective: LightObjective, shaded: list[_Shaded], albedo_modes: Float[Tensor, "k 3"]
) -> _PhotoStart:
    """The best exposure and modes: any mode for the first face, which sets the exposure.

    In that exposure every other face has a best mode of its own.
    """
    w = objective.weights
    nll = -w.albedo_prior * objective.albedo_prior.log_prob(albedo_modes.log())
    first, *others = shaded
    count = len(first.diffuse)
    best = _PhotoStart(
        loss=first.diffuse.new_full((count,), torch.inf),
        exposure=first.diffuse.new_ones(count),
        albedo=first.diffuse.new_ones(count, len(shaded), 3),
    )
    for number, mode in enumerate(albedo_modes):
        # the sky need not be rendered again: shading is linear in exposure and albedo
        shading = first.diffuse * mode + first.glossy
        exposure = best_exposure(
            first.face.seen(shading), first.face.target, first.face.exact_share
        )
        scale = exposure[:, None, None]
        loss = first.face.data_term(shading * scale, w) + nll[number]
        albedo = [mode.expand(count, 3)]
        for one in others:
            fits = [
                one.face.data_term((one.diffuse * m + one.glossy) * scale, w) for m in albedo_modes
            ]
            least = (torch.stack(fits) + nll[:, None]).min(0)
            loss = loss + least.values
            albedo.append(albedo_modes[least.indices])
        better = loss < best.loss
        best = _PhotoStart(
            loss=torch.where(better, loss, best.loss),
            exposure=torch.where(better, exposure, best.exposure),
            albedo=torch.where(better[:, None, None], torch.stack(albedo, 1), best.albedo),
        )
    return best


def best_exposure(
    shading: Float[Tensor, "b m 3"], target: Float[Tensor, "1 m 3"], share: Float[Tensor, "1 m 1"]
) -> Float[Tensor, " b"]:
    """The exposure that makes the weighted mean of the shading that of the picture."""
    return ((target * share).sum() / (shading * share).sum((1, 2)).clamp(min=1e-12)).clamp(
        min=math.exp(-19), max=math.exp(19)
    )
