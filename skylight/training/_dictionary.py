"""Learning of a dictionary of filters from a folder of light probes."""

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.csc._code import CodeTensors
from skylight.csc._coder import SphericalSparseCoder
from skylight.csc._dictionary import FilterBank
from skylight.csc._learning import ROWS, CapFilterBank, learn_patches
from skylight.errors import InputError, SkylightError
from skylight.io._bounded import write_json
from skylight.io._files import read_categories, read_environment_map, visible_files, write_png
from skylight.io._hdr import SUFFIXES
from skylight.sphere._envmap import EnvironmentMap
from skylight.training._callbacks import Callback, Epoch, Run, Watch, watching
from skylight.training._checkpoint import drop_damaged, read_state, write_state
from skylight.training._config import DictionaryConfig
from skylight.work._progress import StageProgress, Tell, counted, silent
from skylight.work._threads import use_all_cores

FILE = "dictionary.safetensors"
LEAST_ROWS = 64
RATE = 0.01  # of Adam, in amounts of filters of unit norm
STEPS = 45  # of the optimiser between two searches for supports
MAPS_AT_ONCE = 8  # whose gradients are computed together
_TILE, _COLUMNS = 96, 10  # pixels of a filter's picture, filters in a row
_SHOWN_RAD = math.radians(45.0)  # from a filter's centre to its picture's rim


@dataclass(frozen=True, kw_only=True)
class _Probes:
    """Maps of at most ``ROWS`` rows, their file names, and the SHA-256 of the files."""

    names: list[str]
    maps: list[Float[Tensor, "h w 3"]]
    sha256: str


def learn_dictionary(
    config: DictionaryConfig,
    report: Tell = print,
    *,
    callbacks: Sequence[Callback] | None = None,
    progress: StageProgress = silent,
) -> Path:
    """Write ``dictionary.safetensors``, ``.json`` and ``filters.png`` into ``config.out``.

    The dictionary is the constant, the learned filters, and ``ani``. "kmeans" takes mean patches
    (:func:`skylight.csc._learning.learn_patches`); "gradient" improves them by Adam
    (:func:`learning_epoch`), resumes an interrupted run from its last epoch, and tells steps and
    epochs to ``callbacks``; :class:`TensorBoard` alone if none are given.

    Raises
    ------
    InputError
        No usable map, or too few for so many filters.
    """
    with watching(callbacks, progress) as watch:
        return _learn(config, report, watch)


def _learn(config: DictionaryConfig, report: Tell, watch: Watch) -> Path:
    use_all_cores()
    probes = _probes(config, report, watch.progress)
    config.out.mkdir(parents=True, exist_ok=True)
    errors: list[float] = []
    if config.method == "gradient":
        bank, errors = _learned(config, probes, report, watch)
    else:
        bank = _patches(config, probes, watch.progress)
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
            "mean_squared_error_by_epoch": errors,
        },
    )
    report(
        f"{config.filters} filters from {len(probes.names)} maps, none undershoots by more than "
        f"{float(undershoot.max()):.1%} of its height"
    )
    return config.out / FILE


def _probes(config: DictionaryConfig, report: Tell, progress: StageProgress = silent) -> _Probes:
    """The folder's usable maps in the order of their names; a line for each that is not."""
    names, maps, digest = [], [], hashlib.sha256()
    wanted = _wanted(config)
    for name in counted(wanted, "reading map", progress):
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


def _patches(config: DictionaryConfig, probes: _Probes, progress: StageProgress) -> FilterBank:
    maps = counted(probes.maps, "patches of map", progress)
    return learn_patches(maps, config.degree, config.filters, seed=config.seed)


def _learned(
    config: DictionaryConfig, probes: _Probes, report: Tell, watch: Watch
) -> tuple[FilterBank, list[float]]:
    """The bank after all epochs, one after the other left on disk, and the error after each."""
    maps = torch.stack(
        [EnvironmentMap(radiance=m).resize(config.rows).radiance for m in probes.maps]
    )
    identity = _identity(config, probes)
    drop_damaged(config.out)
    state = read_state(config.out, identity, report)
    start = (
        _patches(config, probes, watch.progress)
        if state is None
        else FilterBank(state["bank"], "kmeans")
    )
    bank = CapFilterBank(
        start,
        range(1, config.filters + 1),
        radius_rad=math.radians(config.radius_deg),
        signed=config.signed,
    )
    coder = SphericalSparseCoder(bank, height=config.rows, activations=config.activations)
    optimiser = torch.optim.Adam(bank.parameters(), lr=RATE)
    codes, errors = None, []
    if state is not None:
        bank.load_state_dict(state["filters"])
        optimiser.load_state_dict(state["optimiser"])
        codes, errors = CodeTensors(*state["codes"]), state["errors"]
        report(f"goes on after epoch {len(errors)}")
        if len(errors) > config.epochs:
            report(
                f"`epochs` is {config.epochs}: {len(errors)} are done already, none is taken back"
            )
    done, steps = STEPS * len(errors), STEPS * config.epochs
    if done >= steps:
        return bank, errors
    watch.start(Run(config=config, module=bank, step=done, steps=steps, report=report))
    step = count(done + 1)
    for epoch in range(len(errors) + 1, config.epochs + 1):
        codes = learning_epoch(
            coder, optimiser, maps, codes, lambda loss: watch.step(next(step), loss), watch.progress
        )
        errors.append(mean_squared_error(coder, maps, codes))
        state = {
            "identity": identity,
            "bank": start.coefficients.detach(),
            "filters": bank.state_dict(),
            "optimiser": optimiser.state_dict(),
            "codes": list(codes),
            "errors": errors,
        }
        write_state(config.out, state)
        active = codes.filters[codes.used].unique()
        used = int(((active >= 1) & (active <= config.filters)).sum())
        report(
            f"epoch {epoch}  mean squared relative error {errors[-1]:.5f}  "
            f"{used} of {config.filters} filters in use"
        )
        metrics = {"mean_squared_error": errors[-1], "used": used}
        picture = filter_sheet(bank, config.filters)
        watch.epoch(Epoch(number=epoch, step=STEPS * epoch, metrics=metrics, picture=picture))
    return bank, errors


def learning_epoch(
    coder: SphericalSparseCoder,
    optimiser: torch.optim.Optimizer,
    maps: Float[Tensor, "n h w 3"],
    codes: CodeTensors | None,
    on_step: Callable[[float], None] = lambda loss: None,
    progress: StageProgress = silent,
) -> CodeTensors:
    """A new support for each map that it suits better, then ``STEPS`` steps of the optimiser.

    The loss is the mean squared relative error of the maps under the best weights on those
    supports, which ``on_step`` is told; the greedy search for them has no gradient. Returned are
    the codes.
    """
    chunks = torch.arange(len(maps)).split(MAPS_AT_ONCE)
    parts = [coder(maps[some]) for some in counted(chunks, "searching the codes, part", progress)]
    found = CodeTensors(*(torch.cat(columns) for columns in zip(*parts, strict=True)))
    if codes is not None:
        with torch.no_grad():
            new, old = (coder.relative_error(maps, coder.refit(maps, c)) for c in (found, codes))
        found = CodeTensors(
            *(
                torch.where((new < old).view(-1, *[1] * (a.ndim - 1)), a, b)
                for a, b in zip(found, codes, strict=True)
            )
        )
    for _ in range(STEPS):
        optimiser.zero_grad()
        loss = 0.0
        for some in chunks:
            part = CodeTensors(*(each[some] for each in found))
            errors = coder.relative_error(maps[some], coder.refit(maps[some], part))
            share = errors.square().sum() / len(maps)
            share.backward()
            loss += float(share.detach())
        optimiser.step()
        if isinstance(coder.bank, CapFilterBank):
            coder.bank.project_()
        on_step(loss)
    with torch.no_grad():
        return coder.refit(maps, found)


@torch.no_grad()
def mean_squared_error(
    coder: SphericalSparseCoder, maps: Float[Tensor, "n h w 3"], codes: CodeTensors
) -> float:
    """The mean of the maps' squared relative errors."""
    return float(coder.relative_error(maps, codes).square().mean())


def _identity(config: DictionaryConfig, probes: _Probes) -> dict[str, Any]:
    """What a run must have in common with the one that it goes on from: all but epochs and folder,
    and the maps by their content."""
    free = ("out", "epochs", "maps", "category")
    facts = {name: value for name, value in asdict(config).items() if name not in free}
    return facts | {"data": f"SHA-256 {probes.sha256[:16]}"}


def filter_sheet(bank: FilterBank, count: int) -> UInt8[np.ndarray, "_ _ 3"]:
    """Filters 1 .. ``count`` seen from above (orthographic), 45 degrees about their centres.

    Grey from 0 to the largest value, blue where they are negative; phi = 0 points to the right.
    """
    side = (torch.arange(_TILE, dtype=torch.float64) + 0.5) / _TILE * 2 - 1
    v, u = torch.meshgrid(-side, side, indexing="ij")
    z, x = math.sin(_SHOWN_RAD) * u, math.sin(_SHOWN_RAD) * v
    inside = u.square() + v.square() <= 1
    y = (1 - x.square() - z.square()).clamp(min=0).sqrt()
    directions = torch.stack([x, y, z], -1).reshape(-1, 3)
    shown = FilterBank(bank.coefficients[1 : count + 1], bank.name)
    values = shown.evaluate(directions).detach().reshape(-1, _TILE, _TILE)
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
