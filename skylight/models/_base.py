"""Protocols of light models and priors.

All radiance here is *relative*: models are trained and fitted on skies scaled to a mean
luminance of 1 over the upper hemisphere (sun included). What a camera adds is one exposure
factor, which inverse lighting estimates beside the parameters.
"""

import math
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from skylight.sphere._frame import DirectionGrid


@runtime_checkable
class LightModel(Protocol):
    """A module whose ``forward`` maps parameters ``(..., p)`` to radiance ``(..., n, 3)`` >= 0.

    Radiance is on the n directions of ``grid`` and differentiable in the parameters. ``grid`` is
    the upper hemisphere for models of the sky (the ground is added by
    :class:`skylight.models._ground.LambertianGround`), the whole sphere for others.
    ``bounds`` are two ``(p,)`` tensors on the model's device (infinite where there is none).
    ``to_free`` maps parameters within the bounds to all of R^p, ``from_free`` back; both are
    smooth, so that an unconstrained optimiser works on the free side and never leaves the bounds.
    ``azimuth_index`` is the parameter that turns the light about the vertical, or None; priors
    leave it out (see :func:`without_azimuth`), since no azimuth is likelier than another.
    ``starts`` gives parameters ``(s, p)`` to start an optimisation from, and
    ``starts_towards`` such whose sun stands in the given directions ``(d, 3)``,
    ``(d, k, p)``: k candidates per direction. ``sun_direction`` is where parameters say that the
    sun stands, differentiable, or None for a model without a sun of its own. ``on_rows`` is the
    same model on a grid of another height, so that a map may be finer than what it was fitted on.
    """

    name: str
    parameter_count: int
    azimuth_index: int | None

    @property
    def grid(self) -> DirectionGrid: ...

    @property
    def bounds(self) -> tuple[Float[Tensor, " p"], Float[Tensor, " p"]]: ...

    def __call__(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch n 3"]: ...

    def to_free(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]: ...

    def from_free(self, free: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]: ...

    def starts(self) -> Float[Tensor, "s p"]: ...

    def starts_towards(self, directions: Float[Tensor, "d 3"]) -> Float[Tensor, "d k p"]: ...

    def sun_direction(
        self, params: Float[Tensor, "*batch p"]
    ) -> Float[Tensor, "*batch 3"] | None: ...

    def on_rows(self, height: int) -> "LightModel": ...


class UnboundedLight(nn.Module):
    """The part of a :class:`LightModel` that is the same where any parameters are allowed.

    Free parameters are the parameters; there is neither an azimuth nor a sun.
    """

    azimuth_index: int | None = None
    parameter_count: int

    @property
    def bounds(self) -> tuple[Float[Tensor, " p"], Float[Tensor, " p"]]:
        like = next(self.buffers())
        high = like.new_full((self.parameter_count,), math.inf, dtype=torch.float64)
        return -high, high

    def to_free(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        return params

    def from_free(self, free: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        return free

    def sun_direction(self, params: Float[Tensor, "*batch p"]) -> None:
        return None


@runtime_checkable
class Prior(Protocol):
    """A normalised density over R^p."""

    def log_prob(self, x: Float[Tensor, "b p"]) -> Float[Tensor, " b"]: ...

    def sample(self, count: int, generator: torch.Generator) -> Float[Tensor, "n p"]: ...


def without_azimuth(model: LightModel, free: Float[Tensor, "b p"]) -> Float[Tensor, "b q"]:
    """The free parameters that a prior speaks of: all but the azimuth."""
    at = model.azimuth_index
    return free if at is None else torch.cat([free[:, :at], free[:, at + 1 :]], 1)
