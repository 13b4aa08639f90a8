"""Light models fitted to skies directly: what each can represent (thesis, 5.5.2, Table 5.1)."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.evaluation.pictures import strip
from skylight.evaluation.run import Check, Item
from skylight.evaluation.scores import score
from skylight.imaging.files import write_png
from skylight.inverse.lbfgs import minimise
from skylight.inverse.objective import GROUND_ALBEDOS, charbonnier
from skylight.models.autoencoder import HEIGHT, AutoencoderLight
from skylight.models.base import LightModel
from skylight.models.ground import LambertianGround
from skylight.models.harmonic import HarmonicLight, solve_linear
from skylight.models.shipped import autoencoder_light, sunsky_light
from skylight.models.sunsky import fit_sunsky
from skylight.skies.dataset import (
    SkyRecord,
    centre_column_azimuth,
    load_skies,
    normalise,
    read_index,
    simulated_skies,
)
from skylight.sphere.envmap import EnvironmentMap

VISIBLE = 0.5  # transmittance above which the sun counts as visible
ITERATIONS = 100
_SEEDS_APART = 1000


@dataclass(frozen=True, kw_only=True)
class SkyModels:
    """``count`` test skies: simulated ones, or those of the test days of a folder of maps.

    All skies have a mean luminance of 1 and their sun in the centre column, where the encoder
    wants it; the fitted models still have to find its azimuth to a fraction of a column.
    """

    count: int
    data: Path | None = None
    seed: int = 30_000_000
    name: str = "sky-models"

    def __post_init__(self) -> None:
        if self.data is not None:
            read_index(self.data)

    def config(self) -> dict[str, object]:
        data = str(self.data.resolve()) if self.data else None
        return {"seed": self.seed, "data": data}

    def items(self) -> list[str]:
        if self.data is not None:
            return [Path(r.file).stem for r in _test_records(self.data)[: self.count]]
        return [f"sky{i:04d}" for i in range(self.count)]

    def measure(self, item: str, picture: Path) -> Item:
        number = self.items().index(item)
        record, sky = self._sky(number)
        albedo = GROUND_ALBEDOS[np.random.default_rng(number).integers(len(GROUND_ALBEDOS))]
        ground = torch.tensor(albedo)
        truth = _over_ground(sky, ground)
        visible = record.sun_transmittance >= VISIBLE
        metrics, environments = {}, {}
        for method, fit in FITS.items():
            start, cpu_start = time.perf_counter(), time.process_time()
            environment = fit(sky, ground)
            seconds, cpu = time.perf_counter() - start, time.process_time() - cpu_start
            scores = score(environment, truth, sun_visible=visible)
            metrics[method] = scores | {"seconds": seconds, "cpu_seconds": cpu}
            environments[method] = environment
        write_png(picture, strip(truth, environments))
        facts: dict[str, object] = {
            "day": record.day,
            "regime": record.regime,
            "sun_zenith_deg": record.sun_zenith_deg,
            "sun_visible": visible,
        }
        return Item(name=item, metrics=metrics, facts=facts)

    def _sky(self, number: int) -> tuple[SkyRecord, Float[Tensor, "h w 3"]]:
        if self.data is not None:
            record = _test_records(self.data)[number]
            return record, load_skies(self.data, [record])[0]
        seed = self.seed + _SEEDS_APART * number
        ((record, sky),) = simulated_skies("test", 1, first_seed=seed)
        return record, normalise(sky.radiance[None])[0]

    def checks(
        self, rows: dict[str, dict[str, dict[str, float]]], items: list[Item]
    ) -> dict[str, Check]:
        return {
            f"autoencoder {metric} below sh25": Check.below(
                rows["autoencoder"][metric]["mean"], rows["sh25"][metric]["mean"], "sh25"
            )
            for metric in ("si_rmse", "sun_dw_mae")
            if metric in rows.get("autoencoder", {})
        }


def fit_harmonic(
    sky: Float[Tensor, "h w 3"], ground: Float[Tensor, "3"], *, degree: int
) -> EnvironmentMap:
    """Least squares over the whole sphere, ground included, weighted by solid angle; cut at 0."""
    truth = _over_ground(sky, ground)
    model = HarmonicLight(degree, truth.layout[0])
    weights = truth.grid.solid_angles
    coefficients = solve_linear(model.basis.double(), truth.flat.double(), weights)
    radiance = model.radiance(coefficients.reshape(1, -1))[0]
    return EnvironmentMap(radiance=radiance.float().reshape(*truth.layout, 3))


def fit_sun_and_sky(sky: Float[Tensor, "h w 3"], ground: Float[Tensor, "3"]) -> EnvironmentMap:
    """The closed-form fit, then descent under :class:`SkyLoss`."""
    model = sunsky_light()
    start = fit_sunsky(sky.reshape(1, -1, 3), model).float()
    return _refined(model, start, sky, ground)


def feed_forward(sky: Float[Tensor, "h w 3"], ground: Float[Tensor, "3"]) -> EnvironmentMap:
    """Encoded and decoded, nothing fitted."""
    model = autoencoder_light()
    with torch.no_grad():
        radiance = model.radiance(_encoded(model, sky))[0]
    return _over_ground(radiance.reshape(sky.shape), ground)


def fit_autoencoder(sky: Float[Tensor, "h w 3"], ground: Float[Tensor, "3"]) -> EnvironmentMap:
    """From the encoder's latents down under :class:`SkyLoss`."""
    model = autoencoder_light()
    with torch.no_grad():
        start = _encoded(model, sky)
    return _refined(model, start, sky, ground)


Fit = Callable[[Float[Tensor, "h w 3"], Float[Tensor, "3"]], EnvironmentMap]
FITS: dict[str, Fit] = {
    "sh9": lambda sky, ground: fit_harmonic(sky, ground, degree=2),
    "sh25": lambda sky, ground: fit_harmonic(sky, ground, degree=4),
    "sunsky": fit_sun_and_sky,
    "autoencoder_feedforward": feed_forward,
    "autoencoder": fit_autoencoder,
}


class SkyLoss:
    """L1 of radiance plus L1 of log(1 + radiance), means over the hemisphere and channels.

    The first knows the sun's energy, which the second hardly sees; the second knows the sky.
    """

    def __init__(self, model: LightModel, sky: Float[Tensor, "h w 3"]) -> None:
        self.model = model
        self.target = sky.reshape(-1, 3)
        self.coded = torch.log1p(self.target)
        self.weight = (model.grid.solid_angles / (3 * 2 * math.pi)).float()[:, None]

    def __call__(self, free: Float[Tensor, "b q"], index: Tensor) -> Float[Tensor, " b"]:
        radiance = self.model.radiance(self.model.from_free(free))
        error = charbonnier(radiance - self.target)
        error = error + charbonnier(torch.log1p(radiance) - self.coded)
        return (error * self.weight).sum((1, 2))


def _refined(
    model: LightModel,
    start: Float[Tensor, "1 p"],
    sky: Float[Tensor, "h w 3"],
    ground: Float[Tensor, "3"],
) -> EnvironmentMap:
    best = minimise(SkyLoss(model, sky), model.to_free(start), iterations=ITERATIONS)
    with torch.no_grad():
        radiance = model.radiance(model.from_free(best.x))[0]
    return _over_ground(radiance.reshape(sky.shape), ground)


def _encoded(model: AutoencoderLight, sky: Float[Tensor, "h w 3"]) -> Float[Tensor, "1 p"]:
    azimuth = torch.tensor([[centre_column_azimuth(HEIGHT)]])
    return torch.cat([model.network.encode(sky[None]), azimuth], 1)


def _over_ground(sky: Float[Tensor, "h w 3"], albedo: Float[Tensor, "3"]) -> EnvironmentMap:
    ground = LambertianGround(len(sky)).radiance(sky.reshape(1, -1, 3), albedo[None])[0]
    return EnvironmentMap(radiance=sky).with_ground(ground)


@cache
def _test_records(data: Path) -> list[SkyRecord]:
    """The test days' skies; all of them where the split left none (a small folder)."""
    records = read_index(data)
    return [r for r in records if r.split == "test"] or records
