"""Test skies: simulated, or captured maps from a folder.

Two kinds of folder are read: one with skylight's own index (:mod:`skylight.skies.index`), of
which the test days are taken, and a collection whose ``index.csv`` says what each map shows in
the columns ``file`` and ``category``. Of the latter the outdoor maps by day are taken, those of
:data:`OUTDOOR`; every second of them in the order of their names is the *development* half,
which settings may be chosen by, and the rest is the *held-out* half.
"""

import hashlib
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.evaluation.harness.trained_model import trained_model
from skylight.io.collection import names_categories, read_categories
from skylight.io.files import read_environment_map
from skylight.skies.index import INDEX_NAME, SkyRecord, read_index
from skylight.skies.loading import centre_column_azimuth, load_skies, normalise
from skylight.skies.simulated import simulated_skies
from skylight.skies.splits import SUNNY
from skylight.sphere.envmap import shift_columns
from skylight.sphere.frame import angles_from_direction

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
        """SHA-256 of the folder's index: results of another one are none of these."""
        if self.data is None:
            return None
        return hashlib.sha256((self.data / INDEX_NAME).read_bytes()).hexdigest()

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
class SkyEvaluation:
    """What evaluations over ``count`` known skies have in common.

    The skies are simulated ones, or those of a folder of maps (``data``). Over a collection of
    real maps by category an evaluation goes by the name of its ``title`` with "-real" behind it.
    ``model`` is a trained model's folder, None for the one that comes with skylight.
    """

    title: ClassVar[str]

    count: int
    data: Path | None = None
    model: Path | None = None
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
        data = str(self.data.resolve()) if self.data else None
        config = {"seed": self.seed, "data": data, "index": self.skies.fingerprint()}
        if self.model is not None:
            config["model"] = trained_model(self.model).fingerprint
        return config

    def items(self) -> list[str]:
        return self.skies.names()


def _collected_sky(data: Path, number: int) -> KnownSky:
    """The upper half at 32 x 128, its energy kept, the brightest direction ahead."""
    file, category = _collection(data)[number]
    sky = read_environment_map(data / file).upper().resize(HEIGHT)
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
