"""A light model of one's own, fitted to a photograph of a face: a sky that fades, and a sun.

python examples/own_light.py portrait.jpg
"""

import math
import sys

import torch

import skylight
from skylight.models import ParametricLight
from skylight.sphere import angles_from_direction, direction_from_angles


class FadingSky(ParametricLight):
    """From the horizon's colour to the zenith's, and a sun three degrees wide."""

    def __init__(self) -> None:  # three colours, then the sun's azimuth and zenith angle
        low, high = [0.0] * 9 + [-math.inf, 0.0], [math.inf] * 10 + [math.pi / 2]
        super().__init__(11, low=low, high=high, azimuth_index=9)

    def sun_direction(self, params: torch.Tensor) -> torch.Tensor:
        return direction_from_angles(params[..., 9], params[..., 10])

    def forward(self, params: torch.Tensor) -> torch.Tensor:
        horizon, zenith, sun = params[..., None, :9].split(3, -1)
        off = (self.directions - self.sun_direction(params)[..., None, :]).square().sum(-1, True)
        return horizon.lerp(zenith, self.directions[:, 1:2]) + 60 * torch.exp(-180 * off) * sun

    def starts_towards(self, directions: torch.Tensor) -> torch.Tensor:
        azimuth, zenith = angles_from_direction(directions)
        sun = torch.stack([azimuth, zenith.clamp(0.05, 1.5)], 1)
        return torch.cat([torch.ones(len(sun), 9).to(sun), sun], 1)[:, None]


if __name__ == "__main__":
    found = skylight.estimate(sys.argv[1], light=FadingSky())
    azimuth, zenith = (math.degrees(angle) for angle in angles_from_direction(found.sun_direction))
    print(f"sun {azimuth:+.0f} degrees right of the view, {zenith:.0f} from the zenith")
