"""A map with lamps as an estimate makes it, and the list of its lamps, without a photograph."""

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.inverse._lamps import MAP_ROWS, in_pictures_units
from skylight.inverse._result import Lamp
from skylight.models._lamps import AMBIENT_PARAMETERS, LampsLight
from skylight.models._lobes import LAMP_PARAMETERS
from skylight.sphere._envmap import EnvironmentMap

DIRECTIONS = ((0.5, 0.6, 0.62), (-0.8, 0.3, -0.5))
# z of log energy, log width, red and blue: 7 and 15 degrees wide, one reddish, one bluish
REST = ((0.8, -0.2, 1.0, -1.5), (0.2, 0.9, -1.0, 0.8))
EXPOSURE = 0.7


def lamp_params(
    directions: tuple[tuple[float, float, float], ...] = DIRECTIONS,
    rest: tuple[tuple[float, float, float, float], ...] = REST,
) -> Float[Tensor, " p"]:
    """Parameters of :class:`LampsLight` in float32, as an estimate has them."""
    ambient = torch.randn(AMBIENT_PARAMETERS, generator=torch.Generator().manual_seed(4))
    each = torch.cat([torch.tensor(directions), torch.tensor(rest)], 1)
    return torch.cat([ambient, each.flatten()])


def lamp_lit(params: Float[Tensor, " p"]) -> tuple[EnvironmentMap, tuple[Lamp, ...]]:
    count = (len(params) - AMBIENT_PARAMETERS) // LAMP_PARAMETERS
    return in_pictures_units(LampsLight(count), params, EXPOSURE)


def ambient_of(params: Float[Tensor, " p"]) -> EnvironmentMap:
    """The same without its lamps, in float64."""
    radiance = LampsLight(0, MAP_ROWS).ambient(params.double()) * EXPOSURE
    return EnvironmentMap(radiance=radiance.reshape(MAP_ROWS, 2 * MAP_ROWS, 3))
