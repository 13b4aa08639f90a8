"""Light to look at: one picture for every map that is written, and the files of a light probe."""

import math
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.imaging._colour import linear_to_srgb
from skylight.imaging._exposure import CameraExposure
from skylight.io._files import write_environment_map, write_png
from skylight.sphere._envmap import EnvironmentMap, luminance

KEY = 0.3  # what the mean of log luminance is exposed for, before the roll-off
WHITE = 16.0  # the exposed value that is white: nearly six stops above the mean
_DARK = 1e-3  # of the mean luminance: black corners do not set the exposure


def preview(
    radiance: Float[Tensor, "h w 3"], *, picture: Float[Tensor, "r c 3"] | None = None
) -> UInt8[np.ndarray, "r c 3"]:
    """sRGB codes of a lat-long map that shows sky and lamps as well as what they light.

    Or, at the same exposure, of another ``picture`` of its light.

    Exposed by the logarithmic mean of luminance over the sphere and rolled off channel by channel,
    so that what is too bright turns white::

        x = KEY L / exp(mean_w ln(Y(w) + 0.001 mean Y)),   shown = x (1 + x / WHITE^2) / (1 + x)

    (Reinhard et al. 2002, "Photographic tone reproduction for digital images", Eqs. 1 to 4.)
    """
    light = EnvironmentMap(radiance=radiance.detach().to("cpu", torch.float32))
    level, share = luminance(light.flat).double(), light.grid.solid_angles
    share = share / share.sum()
    dark = max(_DARK * float(level @ share), 1e-30)
    seen = light.radiance if picture is None else picture.detach().to(light.radiance)
    x = seen * (KEY / math.exp(float((level + dark).log() @ share)))
    shown = linear_to_srgb((x * (1 + x / WHITE**2) / (1 + x)).clamp(0, 1))
    return (255 * shown).round().to(torch.uint8).numpy()


def write_probe(
    folder: Path,
    environment: EnvironmentMap,
    *,
    lights: str = "",
    exposure: CameraExposure | None = None,
) -> None:
    """probe.exr, probe.hdr and a preview, probe.png, as all commands leave a light probe.

    Of estimates the .exr has in its header ``lights``, JSON of what shines in the map, and, by the
    photograph's ``exposure``, the luminance of its unit.
    """
    header: dict[str, object] = {"lights": lights} if lights else {}
    if exposure is not None:
        header |= exposure.attributes()
    write_environment_map(folder / "probe.exr", environment, header=header)
    write_environment_map(folder / "probe.hdr", environment)
    write_png(folder / "probe.png", preview(environment.radiance))
