"""Learns a dictionary of filters from a folder of light probes."""

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.csc.dictionary import FilterBank
from skylight.csc.learning import DictionaryLearner, LearningOptions
from skylight.csc.patches import ROWS, learn_patches
from skylight.errors import InputError, SkylightError
from skylight.imaging.collection import read_categories
from skylight.imaging.files import read_environment_map, write_json, write_png
from skylight.imaging.hdr import SUFFIXES
from skylight.imaging.listing import visible_files
from skylight.sphere.envmap import EnvironmentMap
from skylight.training.checkpoint import drop_damaged, read_state, write_state
from skylight.training.config import DictionaryConfig

FILE = "dictionary.safetensors"
LEAST_ROWS = 64
_TILE, _COLUMNS = 96, 10  # pixels of a filter's picture, filters in a row
_SHOWN_RAD = math.radians(45.0)  # from a filter's middle to its picture's rim


@dataclass(frozen=True, kw_only=True)
class _Probes:
    """Maps of at most ``ROWS`` rows, their file names, and the SHA-256 of the files."""

    names: list[str]
    maps: list[Float[Tensor, "h w 3"]]
    sha256: str


def learn_dictionary(config: DictionaryConfig, report: Callable[[str], None] = print) -> Path:
    """Write ``dictionary.safetensors``, ``.json`` and ``filters.png`` into ``config.out``.

    The dictionary is the constant, the learned filters, and ``ani``. "kmeans" takes mean patches
    (:func:`skylight.csc.patches.learn_patches`); "gradient" goes on from them
    (:mod:`skylight.csc.learning`), and after an interruption from its last epoch.

    Raises
    ------
    InputError
        No usable map, or too few for so many filters.
    """
    probes = _probes(config, report)
    config.out.mkdir(parents=True, exist_ok=True)
    learner = None
    if config.method == "gradient":
        learner = _learner(config, probes, report)
        bank = learner.bank
    else:
        bank = _patches(config, probes, report)
    ready = FilterBank(bank.coefficients, config.method)
    undershoot = ready.undershoot()[1 : config.filters + 1]
    write_png(config.out / "filters.png", filter_sheet(ready, config.filters))
    ready.save(config.out / FILE)
    write_json(
        config.out / "dictionary.json",
        {
            "method": config.method,
            "maps": probes.names,
            "maps_sha256": probes.sha256,
            "learned": config.filters,
            "filters": len(ready),
            "degree": ready.degree,
            "fingerprint": ready.fingerprint,
            "seed": config.seed,
            "date": datetime.now(UTC).date().isoformat(),
            "largest_undershoot": float(undershoot.max()),
            "mean_squared_error_by_epoch": learner.errors if learner else [],
        },
    )
    report(
        f"{config.filters} filters from {len(probes.names)} maps, none undershoots by more than "
        f"{float(undershoot.max()):.1%} of its height"
    )
    return config.out / FILE


def _probes(config: DictionaryConfig, report: Callable[[str], None]) -> _Probes:
    """The folder's usable maps in the order of their names; a line for each that is not."""
    names, maps, digest = [], [], hashlib.sha256()
    wanted = _wanted(config)
    for name in wanted:
        path = config.data / name
        try:
            one = _read(path)
        except SkylightError as error:
            report(f"left out: {error}")
            continue
        names.append(name)
        maps.append(one.resize(min(ROWS, one.layout[0])).radiance)
        digest.update(name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    if not names:
        raise InputError(
            f"{config.data}: none of {len(wanted)} maps can be learned from; give full lat-long "
            f"maps of {LEAST_ROWS} or more rows as .exr or .hdr"
        )
    report(f"{len(names)} of {len(wanted)} maps in {config.data}")
    return _Probes(names=names, maps=maps, sha256=digest.hexdigest())


def _wanted(config: DictionaryConfig) -> list[str]:
    if not config.data.is_dir():
        raise InputError(f"{config.data}: no such folder; give one of .exr or .hdr light probes")
    names = [path.name for path in visible_files(config.data, SUFFIXES)]
    if config.maps:
        if absent := sorted(set(config.maps) - set(names)):
            raise InputError(f"{config.data}: no {', '.join(absent)} there, named under `maps`")
        names = [n for n in names if n in config.maps]
    if config.category:
        kinds = read_categories(config.data)
        names = [n for n in names if kinds.get(n, "").startswith(config.category)]
        if not names:
            raise InputError(
                f"{config.data / 'index.csv'}: no map of `category` {config.category!r}; there are "
                f"{', '.join(sorted(set(kinds.values())))}"
            )
    return names


def _read(path: Path) -> EnvironmentMap:
    one = read_environment_map(path)
    rows, columns = one.layout
    if one.is_sky:
        raise InputError(f"{path}: a sky without its lower half; give a full lat-long map")
    if rows < LEAST_ROWS:
        raise InputError(f"{path}: {columns}x{rows} is coarse; give {LEAST_ROWS} or more rows")
    if float(one.radiance.max()) == 0:
        raise InputError(f"{path}: black")
    return one


def _patches(
    config: DictionaryConfig, probes: _Probes, report: Callable[[str], None]
) -> FilterBank:
    report(f"{config.filters} means of patches, half a second a map or so")
    return learn_patches(probes.maps, config.degree, config.filters, seed=config.seed)


def _learner(
    config: DictionaryConfig, probes: _Probes, report: Callable[[str], None]
) -> DictionaryLearner:
    """Learned over all epochs, one after the other left on disk."""
    maps = torch.stack(
        [EnvironmentMap(radiance=m).resize(config.rows).radiance for m in probes.maps]
    )
    options = LearningOptions(
        activations=config.activations,
        radius_rad=math.radians(config.radius_deg),
        signed=config.signed,
    )
    identity = _identity(config, probes)
    drop_damaged(config.out)
    state = read_state(config.out, identity, report)
    learned = range(1, config.filters + 1)
    bank = (
        _patches(config, probes, report) if state is None else FilterBank(state["bank"], "kmeans")
    )
    learner = DictionaryLearner(maps, bank, learned, options)
    if state is not None:
        learner.restore(state["learner"])
        report(f"goes on after epoch {len(learner.errors)}")
    start = bank.coefficients
    for epoch in range(len(learner.errors) + 1, config.epochs + 1):
        learner.epoch(lambda done, n=epoch: report(f"epoch {n}: {done:.0%} of the maps coded"))
        write_state(config.out, {"identity": identity, "bank": start, "learner": learner.state()})
        report(
            f"epoch {epoch}  mean squared relative error {learner.error:.5f}  "
            f"{learner.used} of {config.filters} filters in use"
        )
    return learner


def _identity(config: DictionaryConfig, probes: _Probes) -> str:
    """What a state must share to be gone on from: all but how long, and where."""
    facts = {
        k: v
        for k, v in asdict(config).items()
        if k not in ("data", "out", "epochs", "maps", "category")
    }
    return hashlib.sha256(f"{json.dumps(facts)} {probes.sha256}".encode()).hexdigest()


def filter_sheet(bank: FilterBank, count: int) -> UInt8[np.ndarray, "_ _ 3"]:
    """Filters 1 .. ``count`` seen from above (orthographic), 45 degrees about their middles.

    Grey from 0 to the largest value, blue where they are negative; phi = 0 points to the right.
    """
    side = (torch.arange(_TILE, dtype=torch.float64) + 0.5) / _TILE * 2 - 1
    v, u = torch.meshgrid(-side, side, indexing="ij")
    z, x = math.sin(_SHOWN_RAD) * u, math.sin(_SHOWN_RAD) * v
    inside = u.square() + v.square() <= 1
    y = (1 - x.square() - z.square()).clamp(min=0).sqrt()
    directions = torch.stack([x, y, z], -1).reshape(-1, 3)
    shown = FilterBank(bank.coefficients[1 : count + 1], bank.name)
    values = shown.evaluate(directions).reshape(-1, _TILE, _TILE)
    values = values / values.abs().amax((1, 2), keepdim=True)
    light, dark = values.clamp(min=0).sqrt(), (-values).clamp(min=0).sqrt()
    tiles = torch.stack([light, light, torch.maximum(light, dark)], -1)
    tiles = torch.where(inside[..., None], tiles, torch.ones_like(tiles))
    tiles = torch.nn.functional.pad(tiles, (0, 0, 2, 2, 2, 2), value=1.0)
    columns = min(_COLUMNS, len(tiles))
    blank = torch.ones_like(tiles[:1]).expand(-len(tiles) % columns, -1, -1, -1)
    rows = torch.cat([tiles, blank]).unflatten(0, (-1, columns))
    sheet = rows.permute(0, 2, 1, 3, 4).flatten(2, 3).flatten(0, 1)
    return (sheet * 255).round().to(torch.uint8).numpy()
