"""Protocols of light models and priors.

All radiance here is *relative*: models are trained and fitted on skies scaled to a mean
luminance of 1 over the upper hemisphere (sun included). What a camera adds is one exposure
factor, which inverse lighting estimates beside the parameters.
"""

import copy
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Shaped
from torch import Tensor
from torch.distributions import Distribution

from skylight._modes import on_cpu
from skylight._module import Module
from skylight._names import SKY_LIGHTS, LightName
from skylight.errors import InputError, check_shape
from skylight.sphere._frame import DirectionGrid, angles_from_direction

_NEAREST, _FARTHEST = 1e-6, 40.0  # to a bound, and from the only one in its logarithm


@runtime_checkable
class LightModel(Protocol):
    """A module whose ``forward`` maps parameters ``(..., p)`` to radiance ``(..., n, 3)`` >= 0.

    Radiance is on the n directions of ``grid`` and differentiable in the parameters. ``grid`` is
    the upper hemisphere for models of the sky (the ground is added by
    :class:`skylight.models._ground.LambertianGround`), the whole sphere for others.
    ``bounds`` are two ``(p,)`` tensors on the model's device (infinite where there is none).
    ``to_free`` maps parameters within the bounds to all of R^p, ``from_free`` back; both are
    smooth, so that an unconstrained optimiser works on the free side and never leaves the bounds.
    ``azimuth_index`` is the parameter that turns the light about the vertical, or None; it has no
    bounds and is free as it is, and priors leave it out (see :func:`without_azimuth`), since no
    azimuth is likelier than another.
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


class ParametricLight(Module):
    """A base for light models: all of :class:`LightModel` but ``forward``.

    A model of one's own says how many parameters it has, and maps ``(..., p)`` of them to radiance
    ``(..., n, 3)``, 0 or more, in ``directions``::

        class Gradient(ParametricLight):  # log radiance below and above
            def __init__(self):
                super().__init__(6, sphere=True)

            def forward(self, params):
                below, above = params[..., None, :3], params[..., None, 3:]
                return torch.lerp(below, above, (1 + self.directions[:, 1:2]) / 2).exp()

    Parameters
    ----------
    parameter_count
        p.
    height
        Rows of ``grid``.
    sphere
        Whether it is the whole sphere, (h, 2h), or the sky alone, (h, 4h), to which solvers add the
        ground that it lights.
    low, high
        Bounds: a number for all parameters or one for each; infinite where there is none.
        ``from_free`` is ``low + (high - low) sigmoid(x)`` between two, ``low + e^x`` and
        ``high - e^x`` beside one, and x where there is none.
    azimuth_index
        The parameter that turns the light about the vertical: of the sun's azimuth, in radians,
        without bounds.

    ``name`` is what results call the model, by default its class. There is one start, where free
    parameters are 0; towards a direction it is turned there. A model with a sun tells
    :meth:`sun_direction`, and does well to override :meth:`starts_towards` with a few candidates
    whose sun has that height. :meth:`on_rows` is a copy with other ``directions``: a model that
    keeps more for each direction overrides it.
    """

    name: str = ""
    parameter_names: str = ""  # what errors of sizes say that parameters are
    directions: Tensor
    _low: Tensor
    _high: Tensor

    @on_cpu
    def __init__(
        self,
        parameter_count: int,
        height: int = 32,
        *,
        sphere: bool = False,
        low: float | Sequence[float] = -math.inf,
        high: float | Sequence[float] = math.inf,
        azimuth_index: int | None = None,
    ) -> None:
        super().__init__()
        self.name = self.name or type(self).__name__
        self.parameter_count = parameter_count
        self.azimuth_index = azimuth_index
        self.grid = DirectionGrid.latlong(height) if sphere else DirectionGrid.sky(height)
        directions = self.grid.directions.to(torch.get_default_dtype())
        self.register_buffer("directions", directions, persistent=False)
        for name, bound in (("_low", low), ("_high", high)):
            values = torch.tensor(bound, dtype=torch.float64)
            if values.shape not in ((), (parameter_count,)):
                raise InputError(
                    f"{self.name}: give one bound, or one for each of {parameter_count} "
                    f"parameters, not {tuple(values.shape)}"
                )
            self.register_buffer(name, values.expand(parameter_count).clone(), persistent=False)
        if not bool((self._low < self._high).all()):
            raise InputError(f"{self.name}: each bound in low must be below that in high")
        self._is_bounded = bool(self._low.isfinite().any() | self._high.isfinite().any())

    @property
    def bounds(self) -> tuple[Float[Tensor, " p"], Float[Tensor, " p"]]:
        return self._low, self._high

    def to_free(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        """Inverse of :meth:`from_free`; what is on a bound, or beyond, moves inside by 1e-6."""
        self.check_parameters(params)
        if not self._is_bounded:
            return params
        low, high, above, below = self._limits(params)
        span = torch.where(above & below, high - low, 1.0)
        between = torch.logit(((params - low) / span).clamp(_NEAREST, 1 - _NEAREST))
        beside = torch.where(above, params - low, high - params).clamp(min=_NEAREST).log()
        return torch.where(above & below, between, torch.where(above | below, beside, params))

    def from_free(self, free: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        """Parameters within the bounds, of any numbers."""
        self.check_parameters(free)
        if not self._is_bounded:
            return free
        low, high, above, below = self._limits(free)
        span = torch.where(above & below, high - low, 1.0)
        # a line search may try anything; e^40 is as wrong as infinity but finite
        away = free.clamp(max=_FARTHEST).exp()
        beside = torch.where(above, low + away, high - away)
        params = torch.where(above | below, beside, free)
        params = torch.where(above & below, low + span * torch.sigmoid(free), params)
        return torch.minimum(torch.maximum(params, low), high)

    def check_parameters(self, params: Float[Tensor, "*batch p"]) -> None:
        """:class:`InputError` for another number of them."""
        what = f"{type(self).__name__}'s parameters"
        check_shape(what, params.shape, self.parameter_count, names=self.parameter_names)

    def _limits(self, like: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The bounds, and where they are: parameters stay above some and below others."""
        low, high = self._low.to(like), self._high.to(like)
        return low, high, low.isfinite(), high.isfinite()

    def starts(self) -> Float[Tensor, "s p"]:
        return self.from_free(self.directions.new_zeros(1, self.parameter_count))

    def starts_towards(self, directions: Float[Tensor, "d 3"]) -> Float[Tensor, "d k p"]:
        """The :meth:`starts`, turned to each direction where there is an azimuth."""
        starts = self.starts().repeat(len(directions), 1, 1)
        if self.azimuth_index is not None:
            azimuth, _ = angles_from_direction(directions.to(starts))
            starts[:, :, self.azimuth_index] = azimuth[:, None]
        return starts

    def sun_direction(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch 3"] | None:
        """None: there is no sun."""
        return None

    def on_rows(self, height: int) -> "ParametricLight":
        """A copy on ``height`` rows."""
        light = copy.deepcopy(self)
        sphere = self.grid.is_sphere
        light.grid = DirectionGrid.latlong(height) if sphere else DirectionGrid.sky(height)
        light.directions = light.grid.directions.to(self.directions)
        return light


@runtime_checkable
class Prior(Protocol):
    """A normalised density over R^p.

    ``log_prob`` is its natural logarithm, differentiable in x; ``sample`` makes independent draws
    ``(*shape, p)``, n of them for ``shape=n`` and one for none, as :mod:`torch.distributions` do.
    """

    def log_prob(self, x: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch"]: ...

    def sample(
        self, shape: int | Sequence[int] = (), generator: torch.Generator | None = None
    ) -> Float[Tensor, "*shape p"]: ...


@runtime_checkable
class CurvedPrior(Prior, Protocol):
    """A prior that offers the slope of ``-log_prob``, and a Hessian without negative eigenvalues:
    its own, or that of a function above it that touches it at x."""

    def convex_shape(
        self, x: Float[Tensor, "b p"]
    ) -> tuple[Float[Tensor, "b p"], Float[Tensor, "b p p"]]: ...


def draws(shape: int | Sequence[int]) -> torch.Size:
    """The leading sizes of what a prior's ``sample`` is asked for."""
    return torch.Size((shape,) if isinstance(shape, int) else shape)


def without_azimuth(
    model: LightModel, free: Shaped[Tensor, "*batch p"]
) -> Shaped[Tensor, "*batch q"]:
    """The free parameters that a prior speaks of: all but the azimuth."""
    at = model.azimuth_index
    return free if at is None else torch.cat([free[..., :at], free[..., at + 1 :]], -1)


# Which light is looked for: by its name, or a model of the user's, with a density over its free
# parameters. Not checked at run time: what is missing is said in a line (`inverse._own_light`).
if TYPE_CHECKING:
    Light = LightName | LightModel
    LightPrior = Prior | Distribution
else:
    Light = LightName | LightModel | Any
    LightPrior = Prior | Distribution | Any


def name_of(light: Light) -> str:
    """What results call it."""
    return light if isinstance(light, str) else light.name


def is_sky(light: Light) -> bool:
    """Whether it is the upper hemisphere, above a ground that it lights ("auto" may choose one)."""
    return light in SKY_LIGHTS if isinstance(light, str) else not light.grid.is_sphere
