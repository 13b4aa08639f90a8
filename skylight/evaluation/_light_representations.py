"""Compact representations of the light of any place: RENI++'s protocol on the whole sphere.

Prediction and truth are each divided by their own 98 % quantile, clamped and sRGB-encoded, and
PSNR and SSIM are of these pictures of 64 x 128 pixels, every pixel alike
(:mod:`skylight.evaluation._sky_representations`). Gardner et al. measure 21 outdoor maps of their
own, so the rows of categories that begin with "outdoor" are what theirs may be held against.

All representations are fitted under one loss, the mean square of the difference in
log(1 + radiance) where that quantile is 10, every pixel alike: a curve much as that of the score,
which lamps and suns above white still count in.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.evaluation._pictures import TILE, captioned_rows
from skylight.evaluation._run import PROBES, Item, ProbeEvaluation
from skylight.evaluation._sky_fits import HELD, RELEASED, SkyLoss, fitted_parameters
from skylight.evaluation._sky_representations import (
    PICTURE,
    QUANTILE,
    Sky,
    harmonics_and_gaussians,
    tone_mapped,
    tone_mapped_scores,
)
from skylight.inverse._scores import find_lamps
from skylight.io._files import read_categories, read_environment_map, write_png
from skylight.models._sphere import SphereLight
from skylight.sphere._envmap import EnvironmentMap, luminance

ROWS = 64
WHITE = 10.0  # what the quantile is when representations are fitted
DEGREES = (2, 5, 6, 9)  # of harmonics
LAMPS = (0, 3, 4)
LEAST_LAMP = 0.003  # of all light


@dataclass(frozen=True, kw_only=True)
class LightRepresentations(ProbeEvaluation):
    """What each representation makes of a light probe that it is fitted to; of the first ``count``
    where that is given."""

    title = "light-representations"
    needs = PROBES
    quick = MappingProxyType({"count": 3})
    selects = ("data", "count")

    count: int | None = None

    def items(self) -> list[str]:
        return list(read_categories(self.probes))[: self.count]

    def measure(self, item: str, picture: Path) -> Item:
        light = read_environment_map(self.probes / item).resize(ROWS).radiance
        light = WHITE * light / torch.quantile(light, QUANTILE).clamp(min=1e-12)
        metrics, shown = {}, {"truth": tone_mapped(light)}
        for name, (floats, fit) in representations().items():
            start = time.perf_counter()
            fitted = fit(light)
            seconds = time.perf_counter() - start
            shown[name] = tone_mapped(fitted)
            scores = tone_mapped_scores(fitted, light)
            metrics[name] = scores | {"floats": floats, "seconds": seconds}
        codes = {name: (255 * p).round().to(torch.uint8).numpy() for name, p in shown.items()}
        write_png(picture, captioned_rows(codes, columns=4, height=TILE))
        category = read_categories(self.probes)[item]
        return Item(name=item, metrics=metrics, facts={"category": category})


def representations() -> dict[str, tuple[int, Callable[[Sky], Sky]]]:
    """Name -> (floats, fit)."""
    found = harmonics_and_gaussians(DEGREES)
    for lamps in LAMPS:
        count = 1 + SphereLight(lamps).parameter_count
        found[f"sphere_{count}"] = (count, partial(fit_sphere, lamps=lamps))
    return found


class _Scaled:
    """A light of any brightness: log of a factor, then the parameters of a light model."""

    def __init__(self, light: SphereLight) -> None:
        self.light, self.grid = light, light.grid
        assert light.azimuth_index is not None
        self.azimuth_index: int | None = 1 + light.azimuth_index

    def __call__(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b n 3"]:
        return params[:, :1, None].exp() * self.light(params[:, 1:])

    def to_free(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b p"]:
        return torch.cat([params[:, :1], self.light.to_free(params[:, 1:])], 1)

    def from_free(self, free: Float[Tensor, "b p"]) -> Float[Tensor, "b p"]:
        return torch.cat([free[:, :1], self.light.from_free(free[:, 1:])], 1)


def fit_sphere(light: Sky, *, lamps: int) -> Sky:
    """Descent from the best start with its lamps where the map's largest are."""
    model = _Scaled(SphereLight(lamps, ROWS))
    loss = SkyLoss(model, light, PICTURE)
    found = find_lamps(EnvironmentMap(radiance=light), most=max(lamps, 1), least_share=LEAST_LAMP)
    if lamps:
        up = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
        missing = lamps - len(found)
        directions = torch.stack([*(lamp.direction for lamp in found), *[up] * missing])
        shares = torch.tensor([*(lamp.share for lamp in found), *[LEAST_LAMP] * missing])
        energies = shares / (1 - shares.sum()).clamp(min=0.1)
        starts = model.light.starts_at(directions.float()[None], energies[None])[0]
    else:
        starts = model.light.starts()
    share = (model.grid.solid_angles / model.grid.solid_angles.sum()).float()
    with torch.no_grad():
        level = luminance(light.reshape(-1, 3)) @ share
        levels = torch.stack([luminance(each) @ share for each in model.light(starts)])
        starts = torch.cat([(level / levels).log()[:, None], starts], 1)
        best = starts[loss.of_radiance(model(starts)).argmin()][None]
        params = fitted_parameters(loss, best, held=2 * HELD, released=2 * RELEASED)
        return model(params)[0].reshape(light.shape)
