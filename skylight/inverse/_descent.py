"""Descent from many starts, in stages, of several problems as one batch.

Starts are lights towards the sun's candidates, with exposures and albedos that fit. Gauss-Newton
steps take the faces' deviations and their derivatives with respect to each free parameter. Light
acts through matrices: only the derivatives of what it radiates are transported, all of a
start's as one product; what albedo, specular scale, exposure and turns do is for each pixel by
itself.

Derivatives of the radiance are in closed form where the model has that
(:meth:`~skylight.models._lobes.LampedLight.slopes`), else forward differences,
(f(x + h e) - f(x)) / h with h the square root of the floating-point precision; those of albedo,
specular scale, exposure, gains, edits and deviations are in closed form. Forward
differences are off by h / 2 of the second derivative (0.5 % for the azimuth of a sun 1.4 degrees
wide, the sharpest light), and in single precision by rounding: 1 % of a column in the median, 7 %
of those of the latents that matter least, 0.1 % of the largest column. Steps need no more.
Automatic differentiation in forward mode takes longer, and its first use imports torch's compiler,
2 s.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.imaging._edits import PixelSlopes, edited_slopes
from skylight.inverse._faces import FaceTerm, Level, Transported, Unpacked, of_problem
from skylight.inverse._gauss_newton import minimise_robust
from skylight.inverse._lbfgs import minimise
from skylight.inverse._objective import MOST_EDIT, TURN_STEP, LightObjective
from skylight.models._lobes import LampedLight

_MOST_CHANGES = 512  # of the light at a time: a decoder has 1 MB of activations for each


def deviations(
    objective: LightObjective, free: Float[Tensor, "b q"], problem: Int[Tensor, " b"] | None = None
) -> Float[Tensor, "b m"]:
    """Of all pixels and channels of all faces of each point's problem, as the objective's are.

    Then of the photographs' backgrounds.
    """
    of_faces, behind = deviations_apart(objective, free, problem)
    return torch.cat([of_faces, *behind.values()], 1)


def deviations_apart(
    objective: LightObjective, free: Float[Tensor, "b q"], problem: Int[Tensor, " b"] | None = None
) -> tuple[Float[Tensor, "b _"], dict[int, Float[Tensor, "b _"]]]:
    """Those of all faces, and of each photograph's background."""
    parts = objective.unpack(free)
    light = objective.radiance(parts)
    shadings = objective.shading(parts, problem, light)
    every = zip(objective.faces, shadings, strict=True)
    of_faces = [face.deviation(shading, problem).flatten(1) for face, shading in every]
    return torch.cat(of_faces, 1), objective.behind(parts, light)


@torch.no_grad()
def deviation_weights(
    objective: LightObjective, free: Float[Tensor, "b q"], problem: Int[Tensor, " b"] | None = None
) -> Float[Tensor, "b m"]:
    """What the Charbonnier of each of the :func:`deviations` counts, nats.

    Faces and backgrounds are trusted as far as they are at ``free``: minimised so again and again,
    the objective falls (majorisation).
    """
    off, behind = deviations_apart(objective, free, problem)
    of_faces = objective.deviation_weights(off, problem)
    return torch.cat([of_faces, objective.background_weights(behind)], 1) if behind else of_faces


@torch.no_grad()
def jacobian(
    objective: LightObjective, free: Float[Tensor, "b q"], problem: Int[Tensor, " b"] | None = None
) -> Float[Tensor, "b m q"]:
    """Derivatives of the :func:`deviations`."""
    count, size = free.shape
    lit, photos, faces, below = objective.sizes
    per_face = faces // len(objective.faces)
    parts = objective.unpack(free)
    source = objective.radiance(parts)
    skies, grounds = _light_slopes(objective, free, source)

    def by_light(change: Float[Tensor, "b s _ 3"], into: Float[Tensor, "b q _ 3"]) -> None:
        into[:, :lit], into[:, size - below :] = change.split([lit, below], 1)

    def changes_of(radiance: Float[Tensor, "b _ 3"], photo: int) -> Float[Tensor, "b q _ 3"]:
        """Room for what all unknowns change of it, with what exposure and gains do."""
        shape = count, size, 3, radiance.shape[1]
        change = free.new_zeros(shape).mT  # channels apart, as products make them
        at = lit + 5 * photo
        change[:, at : at + 3] = _gain_changes(objective, radiance)
        return change

    def edits_of(photo: int) -> slice:
        return slice(lit + 5 * photo + 3, lit + 5 * photo + 5)

    blocks = []
    for k, face in enumerate(objective.faces):
        turns = objective.turns(parts, k)
        here = face.transported(*source, turns, problem)
        shaded = objective.shaded(parts, k, here, problem)
        change = changes_of(shaded, face.photo)
        at = lit + photos + per_face * k
        of_skin = change[:, at : at + per_face]
        albedo = objective.albedo(parts, k, problem)[:, None]
        along = _transported(face, skies, grounds, turns, problem)
        diffuse = along["diffuse"]
        if here.turned is not None:
            assert face.normals is not None
            vector = face.normals.light_vector(*source, problem)
            modes = of_problem(face.normals.modes, problem).expand(count, -1, -1, -1)
            per_mode = torch.einsum("bmdk,bmdc->bkmc", modes, vector)
            turn = TURN_STEP * objective.weights.normal_spread
            coloured = albedo * (here.diffuse + here.turned > 0)[:, None]
            diffuse = diffuse.mul_(coloured)
            of_skin[:, 4 : 4 + per_mode.shape[1]] = turn * per_mode * coloured
        else:
            diffuse = diffuse.mul_(albedo)
        if here.specular is not None:
            diffuse += along["specular"].mul_(parts.specular_scale[:, k, None, None, None])
        by_light(diffuse, change)
        _skin_changes(objective, parts, k, here, shaded, problem, into=of_skin)
        slopes, by_edits = _camera_slopes(objective, parts, face.photo, shaded)
        picture = objective.camera_response(parts, face.photo, shaded)
        block = face.deviation_slopes(picture, slopes, problem)(change)
        itself = face.deviation_slopes(picture, PixelSlopes.unit(picture), problem)
        block[:, edits_of(face.photo)] = itself(by_edits)
        blocks.append(block.flatten(2))
    for photo, term in objective.backgrounds.items():
        shown = term.seen(*source)
        change = changes_of(shown, photo)
        moved = term.seen(skies.flatten(0, 1), grounds.flatten(0, 1))
        by_light(moved.unflatten(0, (count, -1)), change)
        slopes, by_edits = _camera_slopes(objective, parts, photo, shown)
        picture = objective.camera_response(parts, photo, shown)
        block = term.deviation_changes(picture, slopes, change)
        itself = PixelSlopes.unit(picture)
        block[:, edits_of(photo)] = term.deviation_changes(picture, itself, by_edits)
        blocks.append(block)
    return torch.cat(blocks, 2).mT


def _camera_slopes(
    objective: LightObjective, parts: Unpacked, photo: int, radiance: Float[Tensor, "b m 3"]
) -> tuple[PixelSlopes, Float[Tensor, "b 2 m 3"]]:
    """Derivatives of the picture: by radiance that photograph ``photo`` shows, and by its edits."""
    gains = parts.exposure[:, photo, None] * objective.white_balance(parts)[:, photo]
    picture, w = gains[:, None] * radiance, objective.weights
    if w.saturation_spread == w.contrast_spread == 0:
        none = torch.zeros_like(picture)[:, None].expand(-1, 2, -1, -1)
        return PixelSlopes.unit(picture).of(gains), none
    saturation, contrast = objective.edits(parts)[:, photo].unbind(1)
    slopes, by_edits = edited_slopes(picture, saturation, contrast)
    free = (parts.edits[:, photo].abs() <= MOST_EDIT) * objective.edits_counted[photo]
    return slopes.of(gains), by_edits * free[..., None, None]


def _gain_changes(
    objective: LightObjective, radiance: Float[Tensor, "b m 3"]
) -> Float[Tensor, "b 3 m 3"]:
    """What the logarithms of exposure and of the red and the blue gain add to radiance."""
    hues = torch.eye(3).to(radiance)[[0, 2]] - 1 / 3
    if objective.weights.white_balance_spread == 0:
        hues = torch.zeros_like(hues)
    return radiance[:, None] * torch.cat([torch.ones_like(hues[:1]), hues])[:, None]


def _skin_changes(
    objective: LightObjective,
    parts: Unpacked,
    k: int,
    light: Transported,
    shaded: Float[Tensor, "b m 3"],
    problem: Int[Tensor, " b"] | None,
    into: Float[Tensor, "b s m 3"],
) -> None:
    """What face ``k``'s log specular scale, logits of albedo and pigments add to its shading."""
    scattered = shaded
    if light.specular is not None:
        shine = parts.specular_scale[:, k, None, None] * light.specular
        scattered, into[:, 0] = shaded - shine, shine
    left = (1 - parts.albedo[:, k])[:, None]  # d log a = (1 - a) d logit
    into[:, 1:4].diagonal(dim1=1, dim2=3).copy_(scattered * left)
    modes = objective.faces[k].modes
    if modes is None or objective.mode_count == 0:
        return
    modes = of_problem(modes, problem).mT[:, None, :, :, None]  # (b, 1, k, m, 1)
    pigments = -objective.pigment_colours[:, None, None] * modes * scattered[:, None, None]
    into[:, 4 + objective.turn_count :] = pigments.flatten(1, 2)


def _moved(free: Float[Tensor, "b q"], axes: Float[Tensor, "s q"]) -> Float[Tensor, "bs q"]:
    """Each point moved along each axis."""
    return (free[:, None] + axes).flatten(0, 1)


def _light_slopes(
    objective: LightObjective, free: Float[Tensor, "b q"], here: tuple[Tensor, Tensor]
) -> tuple[Float[Tensor, "b s n 3"], Float[Tensor, "b s 3"]]:
    """Derivatives of the radiance ``here``, of sky and ground, along the light's unknowns."""
    model, sizes = objective.model, objective.sizes
    if isinstance(model, LampedLight):
        skies = model.slopes(objective.unpack(free).light)
        return skies, skies.new_zeros(*skies.shape[:2], 3)
    step = torch.finfo(free.dtype).eps ** 0.5
    unknown = torch.arange(sum(sizes)).split(sizes)
    axes = step * torch.eye(sum(sizes))[torch.cat([unknown[0], unknown[3]])].to(free)
    changes = []
    for some in axes.split(max(1, _MOST_CHANGES // len(free))):
        there = objective.radiance(objective.unpack(_moved(free, some)))
        shape = len(free), len(some)
        pairs = zip(there, here, strict=True)
        changes.append([(a.unflatten(0, shape) - b[:, None]) / step for a, b in pairs])
    skies, grounds = (torch.cat(part, 1) for part in zip(*changes, strict=True))
    return skies, grounds


def _transported(
    face: FaceTerm,
    skies: Float[Tensor, "b s n 3"],
    grounds: Float[Tensor, "b s 3"],
    turns: Float[Tensor, "b k"] | None,
    problem: Int[Tensor, " b"] | None,
) -> dict[str, Float[Tensor, "b s m 3"]]:
    """What s changes of each of b lights do to a face, whose normals are turned by so much.

    Where light on the whole sphere is no finer than what the turned normals see, T and what turns
    add to it are one matrix.
    """
    shape = skies.shape[:2]
    each = None if problem is None else problem.repeat_interleave(shape[1])
    flat = skies.flatten(0, 1), grounds.flatten(0, 1), each
    fields = {}
    if face.specular is not None:
        fields["specular"] = face.specular.white(*flat).unflatten(0, shape)
    if face.normals is None or turns is None:
        fields["diffuse"] = face.transport.white(*flat).unflatten(0, shape)
    elif face.transport.sphere and face.normals.visible.shape == face.transport.folded.shape:
        matrix = of_problem(face.transport.folded, problem) + face.normals.of_turns(turns, problem)
        fields["diffuse"] = (skies.mT.flatten(1, 2) @ matrix.mT).unflatten(1, (-1, 3)).mT
    else:
        fields["diffuse"] = face.transport.white(*flat).unflatten(0, shape)
        fields["diffuse"] += face.normals.turned(skies, grounds, turns, problem)
    return fields


@dataclass(frozen=True, kw_only=True)
class Stage:
    """So many of the best ``starts``, minimised on a ``level`` of the pyramid.

    With ``even_skin`` each face has one albedo, whatever the weights say. ``steps`` of Gauss and
    Newton take as many derivatives of the light as that has parameters, those with Broyden's
    updates about as many in all, which serves near a minimum; those of L-BFGS cost little, for
    many starts.
    """

    level: Level
    starts: int
    iterations: int
    even_skin: bool = False
    steps: Literal["l-bfgs", "gauss-newton", "broyden"] = "l-bfgs"


@dataclass(frozen=True, kw_only=True)
class Iterates:
    """Iterates of one problem, where stages start and end, and what led there."""

    free: Float[Tensor, "s q"]
    scores: Float[Tensor, " s"]
    converged: Bool[Tensor, " s"]
    evaluations: int = 0
    nonfinite: int = 0

    @staticmethod
    def starting(free: Float[Tensor, "s q"], scores: Float[Tensor, " s"]) -> "Iterates":
        """Where nothing has been minimised yet."""
        return Iterates(free=free, scores=scores, converged=torch.zeros_like(scores) > 0)


def descend(
    objective: LightObjective, points: Sequence[Iterates], stage: Stage, tolerance: float
) -> list[Iterates]:
    """The best of each problem's points, minimised as one batch.

    Of one problem's objective, ``points`` are groups that each have their own best.
    """
    several = len(objective.faces[0].level) > 1
    best = [one.free[one.scores.argsort()[: stage.starts]] for one in points]
    starts = [objective.uneven(free) for free in best]
    sizes = [len(start) for start in starts]
    number = [torch.full((n,), p if several else 0) for p, n in enumerate(sizes)]
    problem = torch.cat(number).to(starts[0].device)
    if stage.steps != "l-bfgs":
        result = minimise_robust(
            lambda x, rows: deviations(objective, x, problem[rows]),
            lambda x, rows: jacobian(objective, x, problem[rows]),
            deviation_weights(objective, torch.cat(starts), problem),
            lambda x, rows: objective.prior(x, problem[rows]),
            torch.cat(starts),
            iterations=stage.iterations,
            tolerance=tolerance,
            broyden=stage.steps == "broyden",
            shape=lambda x, rows: objective.prior_shape(x, problem[rows]),
        )
    else:
        result = minimise(
            lambda x, rows: objective(x, problem[rows]),
            torch.cat(starts),
            iterations=stage.iterations,
            tolerance=tolerance,
        )
    # in the tone to answer with, so that hue and light settle to it
    free = objective.at_bayes_scale(result.x)
    with torch.no_grad():
        scores = objective(free, problem)
    ends = zip(
        points,
        free.split(sizes),
        scores.split(sizes),
        result.converged.split(sizes),
        result.evaluations.split(sizes),
        result.nonfinite.split(sizes),
        strict=True,
    )
    return [
        Iterates(
            free=free,
            scores=scores,
            converged=converged,
            evaluations=before.evaluations + int(evaluations.sum()),
            nonfinite=before.nonfinite + int(nonfinite.sum()),
        )
        for before, free, scores, converged, evaluations, nonfinite in ends
    ]


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
            specular = torch.zeros_like(diffuse)
            if face.specular is not None:
                specular = face.specular(sky, ground, ones)
            shaded.append(_Shaded(face=face, diffuse=diffuse, specular=specular))
        start = _photo_start(objective, shaded, albedo_modes)
        exposures[:, photo], albedos[:, mine] = start.exposure, start.albedo
        losses = losses + start.loss
    specular_scale = light.new_ones(len(light), len(objective.faces))
    packed = objective.pack(light, exposures, specular_scale, albedos, ground_albedo)
    # one sky for each direction: many starts are to look in many directions
    each = losses[: len(towards)].unflatten(0, (count, -1)).min(1)
    every = torch.arange(len(light), device=light.device)
    first = every[:count] * (len(towards) // count)
    kept = torch.cat([first + each.indices, every[len(towards) :]])
    return packed[kept], losses[kept]


@dataclass(frozen=True, kw_only=True)
class _Shaded:
    """A face in the lights of all starts, apart: diffuse and specular shading."""

    face: FaceTerm
    diffuse: Float[Tensor, "s m 3"]
    specular: Float[Tensor, "s m 3"]


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
        shading = first.diffuse * mode + first.specular
        exposure = best_exposure(
            first.face.seen(shading), first.face.target, first.face.exact_share
        )
        scale = exposure[:, None, None]
        loss = first.face.data_term(shading * scale, w) + nll[number]
        albedo = [mode.expand(count, 3)]
        for one in others:
            fits = [
                one.face.data_term((one.diffuse * m + one.specular) * scale, w)
                for m in albedo_modes
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
