"""A sky model fitted, by gradient through the probe, to what a shading probe's faces show.

    python examples/fit_light_through_probe.py

The sun is found much more finely than the probe's cells are wide: it lights each face by its
cosine.
"""

import torch

import skylight
from skylight.models._ground import LambertianGround
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.sphere._frame import angle_between, direction_from_angles

SKY, GROUND = skylight.SunSky(32), LambertianGround(32)
GRID = skylight.DirectionGrid.latlong(64)
ALBEDO = torch.tensor([[0.1, 0.1, 0.08]])  # of the ground
# sky colour, sun colour, azimuth and zenith angle of the sun, turbidity, sharpness of the sun
TRUE = torch.tensor([[0.3, 0.4, 0.6, 3.0, 2.7, 2.4, 0.7, 0.9, 3.0, 60.0]])
START = torch.tensor([[0.5, 0.5, 0.5, 1.0, 1.0, 1.0, 0.0, 0.5, 5.0, 30.0]])


def fit(steps: int = 300) -> tuple[torch.Tensor, torch.Tensor]:
    """Angles in degrees between the sun and the start's, and the fitted one's."""
    probe = skylight.PartitionProbe(Cells.of(named_design("38d"))).requires_grad_(False)
    shown = probe(GROUND.append(SKY(TRUE), ALBEDO), GRID)
    free = torch.nn.Parameter(SKY.to_free(START))
    optimiser = torch.optim.Adam([free], lr=0.03)
    for _ in range(steps):
        radiance = GROUND.append(SKY(SKY.from_free(free)), ALBEDO)
        loss = ((probe(radiance, GRID) + 0.01).log() - (shown + 0.01).log()).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    suns = (direction_from_angles(p[:, 6], p[:, 7]) for p in (TRUE, START, SKY.from_free(free)))
    true, start, found = (sun.detach() for sun in suns)
    return angle_between(true, start).rad2deg(), angle_between(true, found).rad2deg()


if __name__ == "__main__":
    before, after = fit()
    print(f"the sun is {float(before):.1f} degrees off at the start, {float(after):.2f} fitted")
