"""Light models fitted to known skies: their errors of representation (thesis, 5.5.2, Table 5.1).

The skies are simulated, or captured maps from a folder; how models are fitted to them is in
:mod:`skylight.evaluation._sky_fits`. Two kinds of folder are read: one with skylight's own index
(:mod:`skylight.skies._index`), of which the test days are taken, and a collection whose
``index.csv`` says what each map shows in the columns ``file`` and ``category``. Of the latter the
outdoor maps by day are taken, those of :data:`OUTDOOR`; every second of them in the order of their
names is the *development* half, which settings may be chosen by, and the rest is the *held-out*
half.
"""

import math
import time
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.evaluation._pictures import panorama_rows
from skylight.evaluation._run import (
    Check,
    Evaluation,
    Item,
    Rows,
    index_sha256,
    trained_light,
    trained_model,
)
from skylight.evaluation._sky_fits import fits, over_ground
from skylight.inverse._scores import score
from skylight.io._files import names_categories, read_categories, read_environment_map, write_png
from skylight.models._bundle import Model
from skylight.models._ground import GROUND_ALBEDOS
from skylight.skies._index import (
    INDEX_NAME,
    SUNNY,
    SkyRecord,
    centre_column_azimuth,
    load_skies,
    normalise,
    read_index,
)
from skylight.skies._simulated import simulated_skies
from skylight.sphere._envmap import shift_columns
from skylight.sphere._frame import angles_from_direction

HEIGHT = 32
# What a collection's categories say of the sun: whether it is up and not behind cloud.
OUTDOOR = {"outdoor-sun": True, "outdoor-lowsun": False, "outdoor-nosun": False}
_SEEDS_APART = 1000


@dataclass(frozen=True, kw_only=True)
class KnownSky:
    """``radiance`` has a mean luminance of 1, and its sun or brightest place in column w/2."""

    radiance: Float[Tensor, "h w 3"]
    sun_visible: bool
    facts: dict[str, object]


@dataclass(frozen=True, kw_only=True)
class KnownSkies:
    """Up to ``count`` skies: of a folder, or simulated from ``seed`` on."""

    count: int
    seed: int
    data: Path | None = None

    def __post_init__(self) -> None:
        if self.data is not None and not self.names():
            raise InputError(
                f"{self.data / INDEX_NAME}: no outdoor maps in it; expected the categories "
                f"{', '.join(OUTDOOR)}"
            )

    @property
    def collected(self) -> bool:
        """Whether the maps come from a collection with categories."""
        return self.data is not None and names_categories(self.data)

    def fingerprint(self) -> str | None:
        """SHA-256 of the folder's index."""
        return None if self.data is None else index_sha256(self.data)

    def names(self) -> list[str]:
        if self.data is None:
            return [f"sky{i:04d}" for i in range(self.count)]
        if self.collected:
            return [_name(file) for file, _ in _collection(self.data)[: self.count]]
        return [_name(r.file) for r in _test_records(self.data)[: self.count]]

    def sky(self, number: int) -> KnownSky:
        if self.data is not None and self.collected:
            return _collected_sky(self.data, number)
        if self.data is not None:
            record = _test_records(self.data)[number]
            radiance = load_skies(self.data, [record], height=HEIGHT)[0]
        else:
            seed = self.seed + _SEEDS_APART * number
            ((record, sky),) = simulated_skies(1, first_seed=seed)
            radiance = normalise(sky.radiance[None])[0]
        visible = record.sun_transmittance >= SUNNY
        facts: dict[str, object] = {
            "day": record.day,
            "seed": record.seed,
            "regime": record.regime,
            "sun_zenith_deg": record.sun_zenith_deg,
            "sun_visible": visible,
        }
        return KnownSky(radiance=radiance, sun_visible=visible, facts=facts)


@dataclass(frozen=True, kw_only=True)
class SkyEvaluation(Evaluation):
    """What evaluations over ``count`` known skies have in common.

    The skies are simulated ones, or those of a folder of maps (``data``). Over a collection of
    real maps by category an evaluation goes by the name of its ``title`` with "-real" behind it.
    ``model`` is a trained model or its folder, None for the one that comes with skylight.
    """

    data_folder = None
    selects = ("count",)

    count: int
    data: Path | None = None
    model: Model | None = None
    seed: int = 30_000_000

    def __post_init__(self) -> None:
        _ = self.skies  # refuses a folder that cannot be used before anything is measured

    @property
    def skies(self) -> KnownSkies:
        return KnownSkies(count=self.count, seed=self.seed, data=self.data)

    @property
    def name(self) -> str:
        return f"{self.title}-real" if self.skies.collected else self.title

    def config(self) -> dict[str, object]:
        model = None if self.model is None else trained_model(self.model).fingerprint
        return super().config() | {"index": self.skies.fingerprint(), "model": model}

    def items(self) -> list[str]:
        return self.skies.names()

    def with_model(self, model: Model | None, device: str) -> "SkyEvaluation":
        if device != "auto":
            raise InputError(f"{self.title} fits skies on the CPU: leave --device out")
        return replace(self, model=model)


def _collected_sky(data: Path, number: int) -> KnownSky:
    """The upper half at 32 x 128, its energy kept, the brightest direction ahead."""
    file, category = _collection(data)[number]
    sky = read_environment_map(data / file).upper().resize(HEIGHT)
    if not sky.radiance.any():
        raise InputError(f"{data / file}: its sky is all black; take it out of the index")
    azimuth, zenith = angles_from_direction(sky.brightest_direction())
    turn = (centre_column_azimuth(HEIGHT) - azimuth).to(sky.radiance)
    facts: dict[str, object] = {
        "category": category,
        "half": "held-out" if number % 2 else "development",
        "sun_zenith_deg": math.degrees(float(zenith)),
        "sun_visible": OUTDOOR[category],
    }
    return KnownSky(
        radiance=normalise(shift_columns(sky.radiance[None], turn[None]))[0],
        sun_visible=OUTDOOR[category],
        facts=facts,
    )


def _name(file: str) -> str:
    """A map's path as the name of a picture: maps of one name may lie in several folders."""
    return Path(file).with_suffix("").as_posix().strip("/").replace("/", "_")


@cache
def _collection(data: Path) -> list[tuple[str, str]]:
    """(file, category) of the outdoor maps by day, in the order of their names."""
    rows = read_categories(data).items()
    return sorted((file, category) for file, category in rows if category in OUTDOOR)


@cache
def _test_records(data: Path) -> list[SkyRecord]:
    """The test days' skies."""
    records = [r for r in read_index(data) if r.split == "test"]
    if not records:
        raise InputError(f"{data / INDEX_NAME}: none of its days is a test day; add days")
    return records


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
    quick = MappingProxyType({"count": 24})

    count: int = 150

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

    def checks(self, rows: Rows, items: list[Item]) -> dict[str, Check]:
        if "autoencoder" not in rows:
            return {}
        if self.skies.collected:
            return _real_checks(rows)
        checks = _compared(rows, {"si_rmse": ("sh25",), "sun_dw_mae": ("sh25",)})
        return checks | (_simulated_checks(rows) if self.data is None else {})


def _simulated_checks(rows: Rows) -> dict[str, Check]:
    model = rows["autoencoder"]
    checks = {
        f"autoencoder {metric}": Check.at_most(model[metric]["mean"], limit)
        for metric, limit in SIMULATED_GOALS.items()
        if metric in model
    }
    fed = rows["autoencoder_feedforward"]["mae"]["mean"]
    return checks | {"autoencoder_feedforward mae": Check.at_most(fed, FEED_FORWARD_MAE)}


def _real_checks(rows: Rows) -> dict[str, Check]:
    checks = _compared(rows, REAL_GOALS)
    angle = rows["autoencoder"].get("sun_angle_deg")
    if angle is not None:
        checks["autoencoder sun_angle_deg"] = Check.at_most(angle["mean"], REAL_SUN_ANGLE_DEG)
    return checks


def _compared(rows: Rows, goals: dict[str, tuple[str, ...]]) -> dict[str, Check]:
    """The autoencoder's means against the least of the named methods'."""
    checks = {}
    for metric, methods in goals.items():
        if metric in rows["autoencoder"]:  # nothing of the sun where none was visible
            best = min(methods, key=lambda method: rows[method][metric]["mean"])
            checks[f"autoencoder {metric} below {', '.join(methods)}"] = Check.below(
                rows["autoencoder"][metric]["mean"], rows[best][metric]["mean"], best
            )
    return checks
