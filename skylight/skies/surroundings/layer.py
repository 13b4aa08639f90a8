"""What is painted over a sky, the farthest first."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.skies.surroundings.light import Light
from skylight.skies.surroundings.view import View

EYE_M = 1.6  # above the ground
SNOW = 0.8  # albedo
NOWHERE = 9.0  # an elevation above all: what begins there is not seen
# The share of things before the sun that stay there: whoever takes a panorama for its light
# seldom stands in the shade.
SUN_HIDDEN = 0.2


@dataclass(frozen=True, kw_only=True)
class Site:
    """Where scenes are: their light, air and season. ``open`` is how free the sky is to all."""

    view: View
    light: Light
    open: Float[Tensor, " b"]
    visibility_m: Float[Tensor, " b"]
    snow: Float[Tensor, " b"]  # 1 where snow lies

    def up_to(self, elevation: float) -> "Site":
        """The same site, of which only what is below an elevation (rad) is looked at."""
        return replace(self, view=self.view.up_to(elevation))

    def of(self, which: Int[Tensor, " k"]) -> "Site":
        return Site(
            view=self.view,
            light=self.light.of(which),
            open=self.open[which],
            visibility_m=self.visibility_m[which],
            snow=self.snow[which],
        )


@dataclass(frozen=True, kw_only=True)
class Layer:
    """``cover`` in [0, 1] and the ``radiance`` of what covers, ``distance_m`` away.

    Of the lowest ``h`` rows of a map; it covers nothing above them.
    """

    cover: Float[Tensor, "b h c"]
    radiance: Float[Tensor, "b h c 3"]
    distance_m: Float[Tensor, "b c"]


def in_air(layer: Layer, site: Site) -> Float[Tensor, "b h c 3"]:
    """Radiance after the air before it: L T + (1 - T) horizon, T = exp(-3.9 d / visibility).

    Koschmieder's law; at the visibility's distance a contrast of 2 % is left.
    """
    depth = 3.9 * layer.distance_m / site.visibility_m[:, None]
    passed = torch.exp(-depth)[:, None, :, None]
    return layer.radiance * passed + (1 - passed) * site.light.horizon[:, None]
