"""Light models of the user's own: what is asked of them, and how solvers take them.

:func:`own_light` refuses in one line what a solver cannot use; :class:`OwnLight` is the rest, in
single precision and on any rows.
"""

import copy
from collections.abc import Mapping
from typing import Any, TypeGuard

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.distributions import Distribution

from skylight._modes import Derived
from skylight._names import Place
from skylight.errors import InputError
from skylight.inverse._result import MAP_ROWS
from skylight.inverse._sky import require_light
from skylight.io._tensors import tensors_sha256
from skylight.models._base import (
    Light,
    LightModel,
    LightPrior,
    Prior,
    is_sky,
    without_azimuth,
)
from skylight.models._harmonic import HarmonicLight
from skylight.models._lamps import LampsLight
from skylight.sphere._envmap import averaged
from skylight.sphere._frame import DirectionGrid

# Of transport: what faces are seen on by default, and what the scan for a sun needs
MOST_ROWS, FEWEST_ROWS = 64, 32
MEMBERS = {
    "name": "what results call the model",
    "parameter_count": "how many parameters it has",
    "azimuth_index": "the parameter that turns the light about the vertical, or None",
    "grid": "the DirectionGrid of its radiance, latlong(h) or sky(h)",
    "bounds": "two tensors (p,), what parameters lie between",
    "to_free": "parameters within the bounds to all of R^p",
    "from_free": "all of R^p to parameters within the bounds",
    "starts": "parameters (s, p) to start from",
    "starts_towards": "directions (d, 3) to parameters (d, k, p) whose sun stands there",
    "sun_direction": "parameters (..., p) to where their sun stands (..., 3), or None",
    "on_rows": "the same model on a grid of another height",
}


class OwnLight:
    """A model of the user's as solvers take it, on ``rows``: a :class:`LightModel`.

    It is asked in the precision ``dtype`` of its own starts. Where its ``on_rows`` gives other
    rows, or none, its radiance is averaged over the pixels.
    """

    def __init__(self, model: LightModel, rows: int, dtype: torch.dtype) -> None:
        self.model, self.dtype = model, dtype
        self.name, self.parameter_count = model.name, model.parameter_count
        self.azimuth_index = model.azimuth_index
        sphere = model.grid.is_sphere
        self.grid = DirectionGrid.latlong(rows) if sphere else DirectionGrid.sky(rows)
        self.there = _on_rows(model, self.grid.layout)

    @property
    def bounds(self) -> tuple[Tensor, Tensor]:
        return self.model.bounds

    # what a model of the user's gives is checked by own_light, in words of its own
    def __call__(self, params: Float[Tensor, "*batch p"]) -> Tensor:
        layout = self.there.grid.layout
        assert layout is not None
        assert self.grid.layout is not None
        radiance = self.there(params.to(self.dtype)).to(params.dtype)
        if layout == self.grid.layout:
            return radiance
        return averaged(radiance.unflatten(-2, layout), self.grid.layout[0]).flatten(-3, -2)

    def to_free(self, params: Float[Tensor, "*batch p"]) -> Tensor:
        return self.model.to_free(params.to(self.dtype)).to(params.dtype)

    def from_free(self, free: Float[Tensor, "*batch p"]) -> Tensor:
        return self.model.from_free(free.to(self.dtype)).to(free.dtype)

    def starts(self) -> Tensor:
        return self.model.starts()

    def starts_towards(self, directions: Float[Tensor, "d 3"]) -> Tensor:
        return self.model.starts_towards(directions.to(self.dtype))

    def sun_direction(self, params: Float[Tensor, "*batch p"]) -> Tensor | None:
        sun = self.model.sun_direction(params.to(self.dtype))
        return None if sun is None else sun.to(params.dtype)

    def on_rows(self, height: int) -> "OwnLight":
        return OwnLight(self.model, height, self.dtype)


def _on_rows(model: LightModel, layout: tuple[int, int] | None) -> LightModel:
    """The model on that grid, or itself: some know their own rows only."""
    if layout is None or model.grid.layout == layout:
        return model
    try:
        other = model.on_rows(layout[0])
    except (NotImplementedError, ValueError, InputError):
        return model
    return other if other.grid.layout == layout else model


def own_light(
    given: LightModel, prior: LightPrior | None, where: torch.device
) -> tuple[OwnLight, Prior | None]:
    """Copies of a model and of its prior on that device, as solvers take them.

    On the model's own rows where transport has 32 or 64 with the ground's, else on those that 64
    need.

    Raises
    ------
    InputError
        A member is missing, or is not what :class:`LightModel` or :class:`Prior` says; radiance
        that is not finite, is negative, of another shape or without a gradient.
    """
    model = check_light(given)
    height = model.grid.layout[0] if model.grid.layout else 0
    model = _moved(model, where, called(model))
    whole = height if model.grid.is_sphere else 2 * height
    rows = whole if FEWEST_ROWS <= whole <= MOST_ROWS and not MOST_ROWS % whole else MOST_ROWS
    starts = _tensor(model.starts(), f"{called(model)}.starts()", "s", model.parameter_count)
    if len(starts) == 0 or not (starts.is_floating_point() and bool(starts.isfinite().all())):
        raise InputError(
            f"{called(model)}.starts() must be one or more, finite and in floating point: {starts}"
        )
    light = OwnLight(model, rows if model.grid.is_sphere else rows // 2, starts.dtype)
    starts = starts[:4].to(where, torch.float32)
    free = _check_bounds(light, starts)
    shown = light.on_rows(MAP_ROWS if model.grid.is_sphere else MAP_ROWS // 2)
    for each in dict.fromkeys((light.grid.layout, model.grid.layout, shown.grid.layout)):
        assert each is not None
        _check_radiance(light.on_rows(each[0]), starts)
    _check_gradient(light, free)
    _check_sun(light, starts)
    if prior is None:
        return light, None
    moved = _moved(prior, where, f"the prior {type(prior).__name__}")
    _check_prior(moved, light, without_azimuth(light, free))
    return light, moved


def called(model: LightModel) -> str:
    """How errors name a model: by its class, and by its own name."""
    return f"{type(model).__name__} ({model.name!r})"


def check_light(light: object) -> LightModel:
    """``light`` where it has all of :data:`MEMBERS`, and those that say what it is are right."""
    kind = type(light).__name__
    if isinstance(light, type):
        raise InputError(f"light is the class {light.__name__}: give a model, {light.__name__}()")
    for name, meaning in {"__call__": "parameters (..., p) to radiance", **MEMBERS}.items():
        if not hasattr(light, name):
            raise InputError(
                f"{kind} is no light model: it lacks {name} ({meaning}); "
                "skylight.models.ParametricLight has usual ones"
            )
    model: Any = light
    if not isinstance(model.name, str) or not model.name.strip():
        raise InputError(f"{kind}.name must be a text that results call it, not {model.name!r}")
    count, azimuth = model.parameter_count, model.azimuth_index
    if not isinstance(count, int) or count < 1:
        raise InputError(f"{called(model)}.parameter_count must be 1 or more, not {count!r}")
    if azimuth is not None and not (isinstance(azimuth, int) and 0 <= azimuth < count):
        raise InputError(
            f"{called(model)}.azimuth_index must be one of 0 to {count - 1}, or None, not {azimuth}"
        )
    layout = getattr(model.grid, "layout", None)
    if layout is None or layout[1] not in (2 * layout[0], 4 * layout[0]):
        raise InputError(
            f"{called(model)}.grid must be DirectionGrid.latlong(h) or DirectionGrid.sky(h)"
        )
    return model


def _moved(given: Any, where: torch.device, what: str) -> Any:
    """A copy in evaluation mode on that device, so that the user's own stays as it is."""
    try:
        moved = copy.deepcopy(given)
    except (RuntimeError, TypeError) as error:
        raise InputError(
            f"{what} cannot be copied ({str(error).splitlines()[0]}): keep nothing in it "
            "but modules, detached tensors and plain values"
        ) from error
    if isinstance(moved, nn.Module):
        return moved.eval().requires_grad_(False).to(where)
    _move(moved, where)
    return moved


def _move(thing: object, where: torch.device) -> None:
    """The tensors of what is no module: a distribution's, or of a class of the user's."""
    for name, part in vars(thing).items() if hasattr(thing, "__dict__") else ():
        if isinstance(part, Tensor | nn.Module):
            vars(thing)[name] = part.to(where)
        elif isinstance(part, Distribution):
            _move(part, where)


def _tensor(value: object, what: str, *shape: str | int) -> Tensor:
    """``value`` where it is a tensor of that shape, in which texts stand for any numbers."""
    wanted = f"({', '.join(map(str, shape))})"
    if not isinstance(value, Tensor):
        raise InputError(f"{what} must be a tensor {wanted}, not a {type(value).__name__}")
    fits = len(value.shape) == len(shape) and all(
        isinstance(size, str) or size == found
        for size, found in zip(shape, value.shape, strict=True)
    )
    if not fits:
        raise InputError(f"{what} must have the shape {wanted}, not {tuple(value.shape)}")
    return value


def _check_bounds(light: OwnLight, starts: Float[Tensor, "s p"]) -> Float[Tensor, "s p"]:
    """The starts' free parameters; whatever free ones are, parameters stay within the bounds."""
    count, name = light.parameter_count, called(light.model)
    bounds: object = light.model.bounds
    if not isinstance(bounds, tuple | list) or len(bounds) != 2:
        raise InputError(f"{name}.bounds must be {MEMBERS['bounds']}, not {bounds}")
    low, high = (_tensor(bound, f"{name}.bounds", count).to(starts) for bound in bounds)
    free = _tensor(light.to_free(starts), f"{name}.to_free", len(starts), count)
    if not bool(free.isfinite().all()):
        raise InputError(f"{name}.to_free is not finite at its own starts")
    far = torch.cat([free, free + 30, free - 30])
    params = _tensor(light.from_free(far), f"{name}.from_free", len(far), count)
    if not bool(((params >= low) & (params <= high)).all()):
        raise InputError(f"{name}.from_free leaves its bounds: map all of R^p between them")
    azimuth = light.azimuth_index
    if azimuth is not None and not torch.allclose(params[:, azimuth], far[:, azimuth]):
        raise InputError(
            f"{name}: parameter {azimuth} is the azimuth, which turns all round: leave it as it is "
            "in from_free and to_free, without bounds"
        )
    return free


def _check_radiance(light: OwnLight, params: Float[Tensor, "s p"]) -> None:
    """Of the shape of its grid, finite and nowhere below 0."""
    count, grid = len(params), light.there.grid
    try:
        with torch.no_grad():
            radiance = light.there(params.to(light.dtype))
    except (IndexError, RuntimeError) as error:
        if grid.layout == light.model.grid.layout:
            raise  # what the model does on its own rows is told best by where it fails
        raise InputError(
            f"{called(light.model)} fails on the rows {grid.layout} of its on_rows "
            f"({str(error).splitlines()[0]}): override that where the model keeps more than "
            "directions"
        ) from error
    _tensor(radiance, f"{called(light.model)}: radiance", count, len(grid), 3)
    require_light(radiance, called(light.model), "its starts")


def _check_gradient(light: OwnLight, free: Float[Tensor, "s p"]) -> None:
    with torch.enable_grad():
        radiance = light(light.from_free(free.detach().requires_grad_(True)))
    if not radiance.requires_grad:
        raise InputError(
            f"{called(light.model)}: radiance has no gradient in its parameters: leave out "
            "detach, no_grad and numpy"
        )


def _check_sun(light: OwnLight, starts: Float[Tensor, "s p"]) -> None:
    """Unit vectors for any leading sizes, at starts that have a sun."""
    count, name = light.parameter_count, called(light.model)
    ahead = starts.new_tensor([[0.0, 0.6, -0.8], [0.8, 0.6, 0.0]])
    towards = _tensor(light.starts_towards(ahead), f"{name}.starts_towards", 2, "k", count)
    if towards.shape[1] == 0 or not bool(towards.isfinite().all()):
        raise InputError(f"{name}.starts_towards must give one or more, and finite ones")
    sun = light.sun_direction(towards.to(starts))
    if sun is None:
        return
    lengths = _tensor(sun, f"{name}.sun_direction", *towards.shape[:2], 3).norm(dim=-1)
    if not torch.allclose(lengths, torch.ones_like(lengths), atol=1e-3):
        raise InputError(
            f"{name}.sun_direction must give unit vectors, not of length {lengths.tolist()}"
        )


def _check_prior(prior: Any, light: OwnLight, free: Float[Tensor, "s q"]) -> None:
    """A number for each row of free parameters."""
    kind, name = type(prior).__name__, called(light.model)
    azimuth = "" if light.azimuth_index is None else ", all but the azimuth"
    asked = f"of the free parameters {tuple(free.shape)} of {name}{azimuth}"
    if not hasattr(prior, "log_prob"):
        raise InputError(f"{kind} is no prior: it lacks log_prob, one number for each row {asked}")
    try:
        found = prior.log_prob(free)
    except (InputError, RuntimeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{kind} is no prior {asked}: {reason}") from error
    found = _tensor(found, f"{kind}.log_prob {asked}", len(free))
    if bool(found.isnan().any()):
        raise InputError(f"{kind}.log_prob {asked} is NaN")


def is_linear(light: Light, prior: LightPrior | None) -> TypeGuard[HarmonicLight]:
    """Harmonics without a prior are a linear problem, as they are by their names."""
    return type(light) is HarmonicLight and prior is None


def solved_together(light: Light, prior: LightPrior | None) -> bool:
    """Whether a batch of its problems is solved as one."""
    if isinstance(light, str):
        return is_sky(light)
    return type(light) is not LampsLight and not is_linear(light, prior)


def follows_clock(light: Light, prior: LightPrior | None, place: Place = "auto") -> bool:
    """Whether what time and place tell of the sun is of use to it, in a ``place`` of that kind."""
    if isinstance(light, str):
        return light != "lamps" and place not in ("indoors", "flash")
    return is_sky(light) or is_linear(light, prior)


def told(thing: object) -> dict[str, str]:
    """A model or a prior in the notes of results: the same for equal numbers, on any device."""
    tensors: dict[str, Tensor] = {}
    texts: dict[str, str] = {}
    _collect(thing, "", tensors, texts, set())
    kind = f"{type(thing).__module__}.{type(thing).__qualname__}"
    return {"class": kind, "sha256": tensors_sha256(tensors, texts)}


_PLAIN = str | bytes | int | float | complex | None | torch.dtype
_OF_MODULES = frozenset(vars(nn.Module()))


def _collect(
    thing: object, path: str, tensors: dict[str, Tensor], texts: dict[str, str], seen: set[int]
) -> None:
    """The numbers and texts that an object and its parts consist of, but what modules keep of
    what they computed, and whether they are in training."""
    if isinstance(thing, Tensor):
        tensors[path] = thing.detach().cpu().contiguous()
    elif isinstance(thing, _PLAIN):
        texts[path] = repr(thing)
    elif isinstance(thing, np.ndarray | np.generic):
        texts[path] = repr((thing.dtype, thing.tolist()))
    elif id(thing) not in seen and not isinstance(thing, Derived):
        seen.add(id(thing))
        parts = thing if isinstance(thing, Mapping) else getattr(thing, "__dict__", {})
        if isinstance(thing, nn.Module):
            own = {name: part for name, part in parts.items() if name not in _OF_MODULES}
            parts = {**own, **thing._parameters, **thing._buffers, **thing._modules}
        elif isinstance(thing, list | tuple):
            parts = dict(enumerate(thing))
        for name, part in parts.items():
            _collect(part, f"{path}.{name}", tensors, texts, seen)
