"""Deviations of faces and how they change with each free parameter, for Gauss-Newton steps.

Light acts through matrices: only the derivatives of what it radiates are transported, all of a
start's as one product; what albedo, gloss, exposure and turns do is for each pixel by itself.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.func import jvp, vmap

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
    axes = torch.eye(size).to(free)
    light, _, skin, ground = torch.arange(size).split(objective.sizes)
    lit = torch.cat([light, ground])
    skin = skin.unflatten(0, (len(objective.faces), -1))

    def radiance(x: Tensor) -> tuple[Tensor, Tensor]:
        return objective.radiance(objective.unpack(x))

    source = radiance(free)

    def radiance_along(axis: Tensor) -> tuple[Tensor, Tensor]:
        change: tuple[Tensor, Tensor] = jvp(radiance, (free,), (axis.expand(count, -1),))[1]
        return change

    mapped = vmap(radiance_along, chunk_size=max(1, _MOST_CHANGES // count))
    skies, grounds = (change.transpose(0, 1) for change in mapped(axes[lit]))
    parts = objective.unpack(free)
    blocks = []
    for k, face in enumerate(objective.faces):
        turns = objective.turns(parts, k)
        here = vars(face.transported(*source, turns, problem))
        here = {name: field for name, field in here.items() if field is not None}
        along = {name: field.new_zeros(size, *field.shape) for name, field in here.items()}
        for name, change in _transported(face, skies, grounds, turns, problem).items():
            along[name][lit] = change.transpose(0, 1)
        if face.normals is not None and turns is not None:
            vector = face.normals.light_vector(*source, problem)
            modes = of_problem(face.normals.modes, problem).expand(count, -1, -1, -1)
            per_mode = torch.einsum("bmdk,bmdc->kbmc", modes, vector)
            scale = TURN_STEP * objective.weights.normal_spread
            along["turned"][skin[k, 4 : 4 + len(per_mode)]] = scale * per_mode

        def deviation(x: Tensor, light: dict[str, Tensor], k: int = k) -> Tensor:
            shading = objective.reflected(objective.unpack(x), k, Transported(**light), problem)
            return objective.faces[k].deviation(shading, problem).flatten(1)

        def deviation_along(
            axis: Tensor, change: dict[str, Tensor], here: dict[str, Tensor] = here
        ) -> Tensor:
            tangents = axis.expand(count, -1), change
            moved: Tensor = jvp(deviation, (free, here), tangents)[1]
            return moved

        blocks.append(vmap(deviation_along, out_dims=2)(axes, along))
    return torch.cat(blocks, 1)


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
