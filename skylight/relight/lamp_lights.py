"""An estimate's lamps as lights of their own, and the map of the light without them."""

import math
from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.inverse.lamps.relighting import lamps_radiance
from skylight.inverse.result import Lamp
from skylight.sphere.envmap import EnvironmentMap

# Of the lamps' energy. An estimate's map is ambient light, which is positive, plus its lamps' lobes
# in float32: what is wrong without them is rounding, and below 2e-5 over 300 draws of the prior.
MOST_CLAMPED = 1e-3


def without_lamps(environment: EnvironmentMap, lamps: Sequence[Lamp]) -> EnvironmentMap:
    """The rest of an estimate's map when its lamps are lights of their own, 0 at least::

        rest(w) = max(L(w) - sum_k E_k / f(s_k) g(w; d_k, s_k), 0)

    E_k is the irradiance of a surface that faces lamp k, and g and f are those by which the map was
    made: see :mod:`skylight.inverse.lamps.relighting`.

    Raises
    ------
    InputError
        The maximum would add more than a thousandth of the lamps' energy: the map is another one.
    """
    if not lamps:
        return environment
    light = lamps_radiance(lamps, environment.layout[0])
    rest = environment.flat.double() - light
    solid_angles = environment.grid.solid_angles
    clamped = float(solid_angles @ rest.clamp(max=0).abs().sum(1))
    if clamped > MOST_CLAMPED * float(solid_angles @ light.sum(1)):
        raise InputError(
            "the map does not hold the light of the estimate's lamps: give the folder as "
            "skylight estimate wrote it, or its map alone"
        )
    kept = rest.clamp(min=0).to(environment.radiance)
    return EnvironmentMap(radiance=kept.reshape(environment.radiance.shape))


def disc_diameter_rad(spread_rad: float) -> float:
    """Angular diameter of the uniform disc that is as wide as a lamp's lobe.

    It has the same mean square chord to the lobe's middle, ``2 (1 - <cos>)``, so both send as much
    light forwards for their energy. With k = 1 / s^2, a von Mises-Fisher lobe's ``<cos>`` is
    coth k - 1 / k, and that of a disc of radius a is (1 + cos a) / 2::

        2 a = 4 asin sqrt(1 - coth k + 1 / k)

    For narrow lamps the chord is the angle: 2 s^2 = a^2 / 2, a diameter of 4 s. Of the irradiance
    of a surface that faces both, surfaces at any slant receive the same to 1.5 % for spreads of up
    to 20 degrees, to 8 % for 40.
    """
    sharpness = spread_rad**-2
    return 4 * math.asin(math.sqrt(1 - 1 / math.tanh(sharpness) + 1 / sharpness))


def colour_and_strength(irradiance: Float[Tensor, "3"]) -> tuple[list[float], float]:
    """A linear colour whose largest channel is 1, as programs take it, times a strength."""
    strength = float(irradiance.max())
    if strength == 0:
        return [1.0, 1.0, 1.0], 0.0
    return (irradiance.double() / strength).tolist(), strength


def quaternion_towards(direction: Float[Tensor, "3"]) -> list[float]:
    """(x, y, z, w) of the shortest turn that takes +Z to a unit vector.

    Lights of glTF and USD shine along their -Z: so turned, one shines from there.
    """
    x, y, z = direction.tolist()
    if 1 + z < 1e-12:  # -Z: half a turn, about +Y as well as about any other level axis
        return [0.0, 1.0, 0.0, 0.0]
    length = math.sqrt(2 * (1 + z))
    return [-y / length, x / length, 0.0, length / 2]
