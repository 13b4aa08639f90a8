"""Sky representations of equal size: the protocol of RENI++ on the upper hemisphere.

Prediction and truth are each divided by their own 98 % quantile (over pixels and channels),
clamped to [0, 1] and sRGB-encoded; PSNR and SSIM are of these pictures of 32 x 128 pixels, every
pixel alike. Gardner et al. measure the full sphere at the resolution of their own maps, so their
figures say what to expect and rank none of ours. As the quantile cuts the sun off, this says how
a sky looks and nothing of what it lights: see :mod:`skylight.evaluation._sky_models` for that.

All representations are fitted under one loss, the L1 of log(1 + radiance).
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from jaxtyping import Float
from kornia.metrics import ssim as ssim_map
from torch import Tensor

from skylight.evaluation._pictures import TILE, captioned_rows
from skylight.evaluation._run import Item, trained_light
from skylight.evaluation._sky_fits import (
    HELD,
    RELEASED,
    Decoder,
    LossWeights,
    SkyLoss,
    autoencoder_start,
    descend,
    sun_and_sky_start,
)
from skylight.evaluation._sky_models import HEIGHT, SkyEvaluation
from skylight.imaging._colour import linear_to_srgb
from skylight.imaging._metrics import SSIM_WINDOW
from skylight.io._files import write_png
from skylight.models._gaussians import CONSTANT_PARAMETERS, LOBE_PARAMETERS, GaussianLobes
from skylight.models._harmonic import HarmonicLight, solve_linear
from skylight.models.autoencoder import AutoencoderLight
from skylight.models.sunsky import SunSky
from skylight.sphere._frame import DirectionGrid

Sky = Float[Tensor, "h w 3"]
LOG_ONLY = LossWeights(radiance=0.0, log=1.0, shading=0.0)
PICTURE = replace(LOG_ONLY, picture=True)
DEGREES = (2, 3, 4, 5, 6, 9)
QUANTILE = 0.98


@dataclass(frozen=True, kw_only=True)
class SkyRepresentations(SkyEvaluation):
    """What each representation makes of a sky that it is fitted to."""

    title = "sky-representations"
    quick = MappingProxyType({"count": 12})

    count: int = 45

    def measure(self, item: str, picture: Path) -> Item:
        known = self.skies.sky(self.items().index(item))
        metrics, shown = {}, {"truth": tone_mapped(known.radiance)}
        for name, (floats, fit) in representations(trained_light(self.model)).items():
            start = time.perf_counter()
            fitted = fit(known.radiance)
            seconds = time.perf_counter() - start
            shown[name] = tone_mapped(fitted)
            scores = tone_mapped_scores(fitted, known.radiance)
            metrics[name] = scores | {"floats": floats, "seconds": seconds}
        codes = {name: (255 * p).round().to(torch.uint8).numpy() for name, p in shown.items()}
        write_png(picture, captioned_rows(codes, columns=4, height=TILE))
        return Item(name=item, metrics=metrics, facts=known.facts)


def tone_mapped(radiance: Sky) -> Sky:
    """``srgb(min(1, L / q))`` with q the 98 % quantile of all values of the map itself."""
    level = torch.quantile(radiance.double(), QUANTILE).clamp(min=1e-12)
    return linear_to_srgb((radiance.double() / level).clamp(0, 1))


def tone_mapped_scores(predicted: Sky, true: Sky) -> dict[str, float]:
    """``psnr`` = -10 log10 of the mean squared difference, and SSIM, of :func:`tone_mapped`.

    SSIM with a Gaussian window of 11 pixels, sigma 1.5 (Wang et al. 2004). PSNR is cut off at
    100 dB, which equal pictures have.
    """
    p, t = tone_mapped(predicted), tone_mapped(true)
    squared = float((p - t).square().mean())
    planes = [x.movedim(-1, 0)[None] for x in (p, t)]
    similar = ssim_map(planes[0], planes[1], window_size=SSIM_WINDOW, max_val=1.0)
    return {
        "psnr": float(-10 * np.log10(max(squared, 1e-10))),
        "tone_mapped_ssim": float(similar.mean()),
    }


class _SkyHarmonics(HarmonicLight):
    """Spherical harmonics on the upper half of their grid, which is all that is fitted."""

    def __init__(self, degree: int) -> None:
        super().__init__(degree, 2 * HEIGHT)
        self.grid = DirectionGrid.sky(HEIGHT)
        self.basis = self.basis[: len(self.grid)]


def fit_harmonics(sky: Sky, degree: int) -> Sky:
    """Descent from the least-squares fit to the sky, or sphere, cut off at its 98 % quantile."""
    model = HarmonicLight(degree, len(sky)) if _is_sphere(sky) else _SkyHarmonics(degree)
    shown = sky.reshape(-1, 3).clamp(max=float(torch.quantile(sky, QUANTILE)))
    start = solve_linear(model.basis.double(), shown.double(), model.grid.solid_angles).float()
    return descended(model, start.reshape(1, -1), sky)


def fit_gaussians(sky: Sky, lobes: int) -> Sky:
    """Descent from :meth:`~skylight.models._gaussians.GaussianLobes.matching_start`."""
    model = GaussianLobes(lobes, len(sky), sphere=_is_sphere(sky))
    start = model.matching_start(sky.reshape(1, -1, 3))
    return descended(model, start, sky)


def fit_sun_and_sky(sky: Sky) -> Sky:
    return descended(SunSky(), sun_and_sky_start(sky), sky)


def fit_autoencoder(light: AutoencoderLight, sky: Sky) -> Sky:
    return descended(light, autoencoder_start(light, sky), sky)


def _is_sphere(sky: Sky) -> bool:
    return sky.shape[1] == 2 * sky.shape[0]


def descended(model: Decoder, start: Float[Tensor, "1 p"], sky: Sky) -> Sky:
    loss = SkyLoss(model, sky, PICTURE if _is_sphere(sky) else LOG_ONLY)
    # twice the usual: hundreds of parameters are slow to settle
    return descend(loss, start, held=2 * HELD, released=2 * RELEASED).reshape(sky.shape)


def representations(light: AutoencoderLight) -> dict[str, tuple[int, Callable[[Sky], Sky]]]:
    """Name -> (floats, fit)."""
    found = harmonics_and_gaussians(DEGREES)
    found["sunsky_10"] = (SunSky.parameter_count, fit_sun_and_sky)
    count = light.parameter_count
    found[f"autoencoder_{count}"] = (count, partial(fit_autoencoder, light))
    return found


def harmonics_and_gaussians(
    degrees: Sequence[int],
) -> dict[str, tuple[int, Callable[[Sky], Sky]]]:
    """Harmonics up to each degree, and as many Gaussian lobes as their floats allow."""
    found: dict[str, tuple[int, Callable[[Sky], Sky]]] = {}
    all_floats = [3 * (degree + 1) ** 2 for degree in degrees]  # 27, 48, 75, 108, 147, ...
    for degree, floats in zip(degrees, all_floats, strict=True):
        found[f"sh_{floats}"] = (floats, partial(fit_harmonics, degree=degree))
    for floats in all_floats:
        lobes = (floats - CONSTANT_PARAMETERS) // LOBE_PARAMETERS
        count = LOBE_PARAMETERS * lobes + CONSTANT_PARAMETERS
        found[f"gaussians_{count}"] = (count, partial(fit_gaussians, lobes=lobes))
    return found
