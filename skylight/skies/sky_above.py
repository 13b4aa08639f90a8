"""Whether a whole lat-long map shows a sky above, judged by the map alone.

Collections of light probes mix skies with rooms, studios and nights. The thresholds lie in a
gap between published maps of known content: without a visible sun, the zenith of outdoor maps has
a blue of 0.99 of its red and more, that of rooms under lamps mostly 0.90 and less; its luminance is
at least that of the ground, but 0.3 of it and less under a dark ceiling.
A night under lamps or the moon differs from a day by its level alone, which relative maps lack: it
is told only where the lower half outshines the upper.
"""

import math

from jaxtyping import Float
from torch import Tensor

from skylight.sphere.envmap import EnvironmentMap, luminance

ZENITH_RAD = math.radians(30)  # of the cap that counts as the zenith
ROWS = 64  # of the map that is judged
LEAST_BLUE = 0.95  # of its red
LEAST_BRIGHT = 0.5  # of the lower half
LEAST_FROM_ABOVE = 0.7  # of the mean radiance of the lower half

NO_SKY = ("indoor", "night", "studio")  # how such categories of a collection begin


def why_no_sky(radiance: Float[Tensor, "h w 3"], *, sun_is_visible: bool) -> str | None:
    """Why a map of the whole sphere shows no sky, in words; None where it may show one.

    ::

        median B < 0.95 median R                        in the 30 degrees about the zenith
        median luminance there < 0.5 median below the horizon
        mean luminance of the upper half < 0.7 of the lower one's

    of the map at 64 rows. The first two count only without a visible sun.
    """
    light = EnvironmentMap(radiance=radiance.nan_to_num(0.0, 0.0, 0.0).clamp(min=0))
    if radiance.shape[0] > ROWS:  # leaves and gaps between them become one
        light = light.resize(ROWS)
    half = light.radiance.shape[0] // 2
    zenith = light.radiance[: max(1, round(half * ZENITH_RAD / (math.pi / 2)))].flatten(0, 1)
    below = luminance(light.radiance[half:])
    if not sun_is_visible:
        red, _, blue = zenith.median(0).values
        if blue < LEAST_BLUE * red:
            return "no sky above: the zenith is redder than a sky's"
        if luminance(zenith).median() < LEAST_BRIGHT * below.median():
            return "no sky above: the zenith is darker than what is below"
    weight = light.grid.solid_angles.to(light.flat).reshape(light.radiance.shape[:2])
    energy = (luminance(light.radiance) * weight).double()
    if energy[:half].sum() < LEAST_FROM_ABOVE * energy[half:].sum():
        return "no sky above: most light comes from below the horizon"
    return None
