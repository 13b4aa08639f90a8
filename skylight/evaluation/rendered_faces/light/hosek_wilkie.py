"""Clear skies of a model other than the simulator that skylight's light models are fitted to.

Hosek & Wilkie 2012, "An Analytic Model for Full Spectral Sky-Dome Radiance", and 2013, "Adding a
Solar-Radiance Function to the Hosek-Wilkie Skylight Model", as Mitsuba's emitter ``sunsky`` has
them, fitted to path-traced atmospheres of spherical shells.
"""

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.evaluation.rendered_faces.independent_render import mitsuba_variant
from skylight.evaluation.rendered_faces.light.distant_light import SunDisc
from skylight.evaluation.rendered_faces.mitsuba_rays import emitted
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.grid import DirectionGrid

TURBIDITIES = 2.0, 8.0  # clear mountain air to haze
SUN_ELEVATIONS_DEG = 5.0, 75.0
_FINER = 4  # directions across a pixel, over which the sky is averaged
_APERTURE_DEG = 0.5358  # the sun's diameter by the model


def hosek_wilkie_sky(
    turbidity: float, ground_albedo: Float[Tensor, "3"], sun: Float[Tensor, "3"], height: int
) -> tuple[EnvironmentMap, SunDisc]:
    """The sky without its sun, (``height``, 4 ``height``), and the sun, both in Mitsuba's units.

    Each pixel is the mean of the radiance over its solid angle, by the midpoint rule. The sun
    gives what the model's disc gives, at the diameter that it has here.
    """
    grid = DirectionGrid.sky(_FINER * height)
    up_is_z = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # Mitsuba's zenith is +Z
    towards = up_is_z @ sun.double().numpy()
    fine = emitted(
        _emitter(turbidity, ground_albedo, towards, sky=True),
        grid.directions.numpy() @ up_is_z.T,
    )
    radiance = torch.from_numpy(fine).float().reshape(_FINER * height, -1, 3)
    disc = emitted(_emitter(turbidity, ground_albedo, towards, sky=False), towards[None])[0]
    irradiance = math.pi * math.sin(math.radians(_APERTURE_DEG / 2)) ** 2 * disc
    return (
        EnvironmentMap(radiance=radiance).resize(height),
        SunDisc(direction=sun, irradiance=torch.from_numpy(irradiance)),
    )


def _emitter(turbidity: float, ground_albedo: Float[Tensor, "3"], sun, *, sky: bool):
    """The sky alone or the sun alone, which in RGB is even across its disc."""
    return mitsuba_variant().load_dict(
        {
            "type": "sunsky",
            "turbidity": turbidity,
            "albedo": {"type": "rgb", "value": ground_albedo.tolist()},
            "sun_direction": sun.tolist(),
            "sun_aperture": _APERTURE_DEG,
            "sky_scale": float(sky),
            "sun_scale": float(not sky),
        }
    )
