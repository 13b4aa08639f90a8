"""The uncertainty of an estimate as numbers, text, an environment map and a contour."""

import math
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.app.figures.angles import named_angles
from skylight.inverse.posterior import SHARE, SunPosterior
from skylight.sphere.envmap import EnvironmentMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_UNRELIABLE = {
    "unreliable: the face is not explained": ", were the face explained",
    "unreliable: hardly a face": ", were it a face",
}
REGION = "#ffd23f"  # the line about the region


def describe_posterior(posterior: SunPosterior) -> dict[str, object]:
    """What estimate.json says of it; the density itself is in posterior.exr."""
    return {
        "verdict": posterior.verdict,
        "is_seen": posterior.is_seen,
        "share": SHARE,
        "region_sr": posterior.region_sr,
        "region_radius_deg": math.degrees(posterior.region_radius_rad),
        "region_edge_per_sr": edge_density(posterior),
        "region_parts": [
            {"share": part.share, **named_angles(part.peak)}
            for part in posterior.parts
            if part.share >= 0.01
        ],
        "sun_gain": posterior.sun_gain,
        "clock_wrong": posterior.clock_wrong,
        "exposure_interval": list(posterior.exposure_interval),
        "albedo_scale_interval": list(posterior.albedo_scale_interval),
    }


def edge_density(posterior: SunPosterior) -> float:
    """Density per sr along the line that pictures draw about the region.

    That is the region's least density moved by 2 %, since where much of the sky is that dense, its
    ripples of a thousandth would make edges all over; up or down, whichever encloses a share
    nearer to the region's. What is enclosed is then the region where the density falls off; 80 to
    90 % where a lobe in a flat sky holds a little less than 90 %; and all of a flat sky.
    """
    least = posterior.density[posterior.region].min()
    mass = posterior.density * posterior.grid.solid_angles

    def away(level: Float[Tensor, ""]) -> float:
        return abs(float(mass[posterior.density >= level].sum()) - SHARE)

    return float(min(0.98 * least, 1.02 * least, key=away))


def sure_of_the_sun(posterior: SunPosterior) -> str:
    """The 90 % region in words."""
    if not posterior.is_seen:
        sky = not posterior.grid.is_sphere
        return f"none seen: {'overcast' if sky else 'even light'}, or hidden behind the head"
    size = f"a circle of {math.degrees(posterior.region_radius_rad):.0f}° radius"
    parts = sum(part.share > 0.1 * SHARE for part in posterior.parts)
    place = size if parts < 2 else f"{parts} areas, together as large as {size}"
    line = f"{100 * SHARE:.0f} % sure within {place}"
    return line + _UNRELIABLE.get(posterior.verdict, "")


def probe_title(posterior: SunPosterior) -> str:
    """What stands over a picture of the light."""
    title = f"Light around the camera: {posterior.verdict}"
    if not posterior.is_seen:
        return title
    whose = "main lamp's" if posterior.grid.is_sphere else "sun's"
    return f"{title} (yellow: the {whose} {100 * SHARE:.0f} % region)"


def posterior_map(posterior: SunPosterior) -> EnvironmentMap:
    """The density per sr as a grey lat-long map of 64 rows; of a sun 0 below the horizon."""
    assert posterior.grid.layout is not None
    density = posterior.density.reshape(posterior.grid.layout).float()
    if posterior.grid.is_sphere:
        grey = density.repeat_interleave(2, 0).repeat_interleave(2, 1)
    else:
        grey = torch.cat([density, torch.zeros_like(density)])
    return EnvironmentMap(radiance=grey[..., None].repeat(1, 1, 3))


def draw_region(axes: "Axes", posterior: SunPosterior, height: int) -> None:
    """The region's contour on a full lat-long picture of ``height`` rows; none where no sun is
    seen."""
    if not posterior.is_seen:
        return
    density = posterior_map(posterior).radiance[..., 0].numpy()
    level = edge_density(posterior)
    # one column round the seam on either side, one row of nothing above the zenith's
    wrapped = np.pad(np.pad(density, ((0, 0), (1, 1)), mode="wrap"), ((1, 0), (0, 0)))
    rows, columns = (
        (np.arange(-1, end) + 0.5) * height / len(density) - 0.5
        for end in (len(density), density.shape[1] + 1)
    )
    limits = axes.axis()  # a contour would widen them
    for color, width in (("black", 3.4), (REGION, 1.8)):
        axes.contour(columns, rows, wrapped, levels=[level], colors=[color], linewidths=[width])
    axes.axis(limits)
