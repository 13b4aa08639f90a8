"""Representation error of light models fitted to skies (thesis, 5.5.2, Table 5.1).

The fits are in :mod:`skylight.evaluation.skies.sky_fits`, the skies and the halves of the real
ones in :mod:`skylight.evaluation.skies.known_skies`.
"""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from skylight.evaluation.harness.pictures import panorama_rows
from skylight.evaluation.harness.run import Check, Item
from skylight.evaluation.harness.trained_model import trained_light
from skylight.evaluation.scores.relit_scene import score
from skylight.evaluation.skies.known_skies import SkyEvaluation
from skylight.evaluation.skies.sky_fits import fits, over_ground
from skylight.io.files import write_png
from skylight.models.ground import GROUND_ALBEDOS

Means = dict[str, dict[str, dict[str, float]]]

# On simulated skies: what the optimised autoencoder, and the one that is only fed, must reach.
SIMULATED_GOALS = {
    "mae": 0.25,
    "rmse": 0.22,
    "si_rmse": 0.12,
    "full_dw_mae": 0.25,
    "sky_dw_mae": 0.15,
    "sun_dw_mae": 0.05,
    "sun_angle_deg": 0.7,
}
FEED_FORWARD_MAE = 0.5
# On real ones: which columns the optimised autoencoder must beat in what.
_ALL = ("sh9", "sh25", "sunsky", "autoencoder_feedforward")
REAL_GOALS = {
    "mae": _ALL,
    "rmse": _ALL,
    "full_dw_mae": _ALL,
    "si_rmse": ("sh25", "sunsky"),
    "sky_dw_mae": ("sh25",),
    "sun_dw_mae": ("sh25",),
}
REAL_SUN_ANGLE_DEG = 3.0


@dataclass(frozen=True, kw_only=True)
class SkyModels(SkyEvaluation):
    """What each light model makes of a sky that it is fitted to.

    All skies have a mean luminance of 1 and their sun in the centre column, where the encoder
    wants it; the fitted models still have to find its azimuth to a fraction of a column.
    """

    title = "sky-models"

    def measure(self, item: str, picture: Path) -> Item:
        number = self.items().index(item)
        known = self.skies.sky(number)
        albedo = GROUND_ALBEDOS[np.random.default_rng(number).integers(len(GROUND_ALBEDOS))]
        ground = torch.tensor(albedo)
        truth = over_ground(known.radiance, ground)
        metrics, environments = {}, {}
        for method, fit in fits(trained_light(self.model)).items():
            start, cpu_start = time.perf_counter(), time.process_time()
            environment = fit(known.radiance, ground)
            seconds, cpu = time.perf_counter() - start, time.process_time() - cpu_start
            scores = score(environment, truth, sun_visible=known.sun_visible)
            metrics[method] = scores | {"seconds": seconds, "cpu_seconds": cpu}
            environments[method] = environment
        write_png(picture, panorama_rows(truth, environments))
        return Item(name=item, metrics=metrics, facts=known.facts)

    def checks(self, rows: Means, items: list[Item]) -> dict[str, Check]:
        if "autoencoder" not in rows:
            return {}
        if self.skies.collected:
            return _real_checks(rows)
        checks = _compared(rows, {"si_rmse": ("sh25",), "sun_dw_mae": ("sh25",)})
        return checks | (_simulated_checks(rows) if self.data is None else {})


def _simulated_checks(rows: Means) -> dict[str, Check]:
    model = rows["autoencoder"]
    checks = {
        f"autoencoder {metric}": Check.at_most(model[metric]["mean"], limit)
        for metric, limit in SIMULATED_GOALS.items()
        if metric in model
    }
    fed = rows["autoencoder_feedforward"]["mae"]["mean"]
    return checks | {"autoencoder_feedforward mae": Check.at_most(fed, FEED_FORWARD_MAE)}


def _real_checks(rows: Means) -> dict[str, Check]:
    checks = _compared(rows, REAL_GOALS)
    angle = rows["autoencoder"].get("sun_angle_deg")
    if angle is not None:
        checks["autoencoder sun_angle_deg"] = Check.at_most(angle["mean"], REAL_SUN_ANGLE_DEG)
    return checks


def _compared(rows: Means, goals: dict[str, tuple[str, ...]]) -> dict[str, Check]:
    """The autoencoder's means against the least of the named methods'."""
    checks = {}
    for metric, methods in goals.items():
        if metric in rows["autoencoder"]:  # nothing of the sun where none was visible
            best = min(methods, key=lambda method: rows[method][metric]["mean"])
            checks[f"autoencoder {metric} below {', '.join(methods)}"] = Check.below(
                rows["autoencoder"][metric]["mean"], rows[best][metric]["mean"], best
            )
    return checks
