"""Deviations of faces and how they change with each free parameter, for Gauss-Newton steps.

Light acts through matrices: only the derivatives of what it radiates are transported, all of a
start's as one product; what albedo, gloss, exposure and turns do is for each pixel by itself.

Derivatives of the radiance are forward differences, (f(x + h e) - f(x)) / h with h the square
root of the floating-point precision; those of what is reflected, which is cheap, are central ones
with h its cube root. Forward differences are off by h / 2 of the second derivative (0.5 % for the
azimuth of a sun 1.4 degrees wide, the sharpest light), and in single precision by rounding: 1 % of
a column in the median, 7 % of those of the latents that matter least, 0.1 % of the largest column.
Steps need no more. Automatic differentiation in forward mode takes longer, and its first use
imports torch's compiler, 2 s.
"""

from collections.abc import Callable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.inverse.objective.face_term import FaceTerm, Transported, of_problem
from skylight.inverse.objective.light_objective import TURN_STEP, LightObjective

_MOST_CHANGES = 512  # of the light at a time: a decoder has 1 MB of activations for each


def deviations(
    objective: LightObjective, free: Float[Tensor, "b q"], problem: Int[Tensor, " b"] | None = None
) -> Float[Tensor, "b m"]:
    """Of all pixels and channels of all faces of each point's problem, as the objective's are."""
    shadings = objective.shading(objective.unpack(free), problem)
    every = zip(objective.faces, shadings, strict=True)
    return torch.cat([face.deviation(shading, problem).flatten(1) for face, shading in every], 1)


@torch.no_grad()
def jacobian(
    objective: LightObjective, free: Float[Tensor, "b q"], problem: Int[Tensor, " b"] | None = None
) -> Float[Tensor, "b m q"]:
    """Derivatives of the :func:`deviations`."""
    count, size = free.shape
    precision = torch.finfo(free.dtype).eps
    step, axes = precision ** (1 / 3), torch.eye(size).to(free)
    light, _, skin, ground = torch.arange(size).split(objective.sizes)
    lit = torch.cat([light, ground])
    skin = skin.unflatten(0, (len(objective.faces), -1))

    def radiance(x: Tensor) -> tuple[Tensor, Tensor]:
        return objective.radiance(objective.unpack(x))

    source = radiance(free)
    most = max(1, _MOST_CHANGES // count)
    parts_of_axes = (precision**0.5 * axes[lit]).split(most)
    changes = [_differences(radiance, source, free, some) for some in parts_of_axes]
    scale = step / precision**0.5
    skies, grounds = (scale * torch.cat(part, 1) for part in zip(*changes, strict=True))
    parts = objective.unpack(free)
    blocks = []
    for k, face in enumerate(objective.faces):
        turns = objective.turns(parts, k)
        here = vars(face.transported(*source, turns, problem))
        here = {name: field for name, field in here.items() if field is not None}
        along = {
            name: field.new_zeros(count, size, *field.shape[1:]) for name, field in here.items()
        }
        for name, change in _transported(face, skies, grounds, turns, problem).items():
            along[name][:, lit] = change
        if face.normals is not None and turns is not None:
            vector = face.normals.light_vector(*source, problem)
            modes = of_problem(face.normals.modes, problem).expand(count, -1, -1, -1)
            per_mode = torch.einsum("bmdk,bmdc->bkmc", modes, vector)
            turn = step * TURN_STEP * objective.weights.normal_spread
            along["turned"][:, skin[k, 4 : 4 + per_mode.shape[1]]] = turn * per_mode
        each = None if problem is None else problem.repeat_interleave(size)

        def deviation(x: Tensor, light: dict[str, Tensor], k: int = k, each=each) -> Tensor:
            shading = objective.reflected(objective.unpack(x), k, Transported(**light), each)
            return objective.faces[k].deviation(shading, each).flatten(1)

        ahead, behind = (
            deviation(
                _moved(free, sign * step * axes),
                {name: (here[name][:, None] + sign * along[name]).flatten(0, 1) for name in here},
            )
            for sign in (1, -1)
        )
        blocks.append(((ahead - behind) / (2 * step)).unflatten(0, (count, size)).transpose(1, 2))
    return torch.cat(blocks, 1)


def _moved(free: Float[Tensor, "b q"], axes: Float[Tensor, "s q"]) -> Float[Tensor, "bs q"]:
    """Each point moved along each axis."""
    return (free[:, None] + axes).flatten(0, 1)


def _differences(
    radiance: Callable[[Tensor], tuple[Tensor, ...]],
    here: tuple[Tensor, ...],
    free: Float[Tensor, "b q"],
    axes: Float[Tensor, "s q"],
) -> tuple[Tensor, ...]:
    """By what the radiance ``here`` changes along each axis, (b, s, ...)."""
    shape = len(free), len(axes)
    there = radiance(_moved(free, axes))
    return tuple(a.unflatten(0, shape) - b[:, None] for a, b in zip(there, here, strict=True))


def _transported(
    face: FaceTerm,
    skies: Float[Tensor, "b s n 3"],
    grounds: Float[Tensor, "b s 3"],
    turns: Float[Tensor, "b k"] | None,
    problem: Int[Tensor, " b"] | None,
) -> dict[str, Float[Tensor, "b s m 3"]]:
    """What s changes of each of b lights do to a face, whose normals are turned by so much."""
    shape = skies.shape[:2]
    each = None if problem is None else problem.repeat_interleave(shape[1])
    flat = skies.flatten(0, 1), grounds.flatten(0, 1), each
    fields = {"diffuse": face.transport.white(*flat).unflatten(0, shape)}
    if face.gloss is not None:
        fields["glossy"] = face.gloss.white(*flat).unflatten(0, shape)
    if face.normals is not None and turns is not None:
        fields["turned"] = face.normals.turned(skies, grounds, turns, problem)
    return fields
