"""Runs of a configuration (``train.py``), and from a folder of skies to a light model."""

import math
import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from skylight.errors import InputError, SkylightError
from skylight.models._bundle import NETWORK, SHIPPED, load_bundle
from skylight.models._network_names import is_builtin
from skylight.skies._captures import index_folder
from skylight.skies._index import INDEX_NAME, is_index, map_path, read_index
from skylight.training._autoencoder import train
from skylight.training._config import (
    AutoencoderConfig,
    Config,
    DictionaryConfig,
    PlacesConfig,
    PriorConfig,
    find_config,
    read_config,
)
from skylight.training._dictionary import learn_dictionary
from skylight.training._overrides import keys_page, read_overrides, usage, without_dashes
from skylight.training._places import train_places
from skylight.training._prior import fit_priors, splits_for_priors
from skylight.work._progress import StageProgress, Tell, silent, stage_bar, with_time_left
from skylight.work._resumable import locked

RUN = "training"  # in the model's folder: what training goes on from
SHIPPED_LATENTS = 64
FEW = 2000  # training skies; below, the shipped network is trained on instead of a new one
LEAST_STEPS = 300
LOG_EVERY_S = 60.0  # a line of progress, where standard error is no terminal


def main(arguments: list[str] | None = None) -> None:
    """``train.py CONFIG [KEY=VALUE ...]``: overrides are checked against the configuration.

    ``torchrun --nproc-per-node N train.py CONFIG`` trains in N processes on one machine.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    rank = int(os.environ.get("RANK", "0"))
    name = f"train.py, process {rank}" if rank else "train.py"
    try:
        wants_help = not {"-h", "--help"}.isdisjoint(arguments)
        if wants_help and arguments[0].startswith("-"):
            print(usage())
            return
        if not arguments or arguments[0].startswith("-"):
            raise InputError(
                "usage: python train.py CONFIG [KEY=VALUE ...]; --help lists what there is"
            )
        config = read_config(find_config(arguments[0]))
        if wants_help:
            print(*keys_page(config), sep="\n")
            return
        texts = without_dashes(type(config), arguments[1:])
        run(replace(config, **read_overrides(type(config), texts)))
    except SkylightError as error:
        print(f"{name}: {error}", file=sys.stderr)
        raise SystemExit(error.exit_code) from None
    except OSError as error:  # a folder that cannot be made or written
        print(f"{name}: {error}", file=sys.stderr)
        raise SystemExit(1) from None
    except KeyboardInterrupt:
        print(f"{name}: interrupted; the same command goes on from here", file=sys.stderr)
        raise SystemExit(1) from None
    if "LOCAL_RANK" in os.environ:
        # gloo's threads outlive its process group now and then, and ending Python would abort then
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)


def run(config: Config) -> None:
    """Do what a configuration says, and print where the result is."""
    if os.environ.get("RANK", "0") != "0":  # one of several, which the first speaks for
        if isinstance(config, AutoencoderConfig):
            train(config)
        return
    with stage_bar(log_every_s=LOG_EVERY_S) as progress:
        if isinstance(config, AutoencoderConfig):
            done = f"best network: {train(config, progress=progress)}"
        elif isinstance(config, DictionaryConfig):
            done = f"dictionary: {learn_dictionary(config, progress=progress)}"
        elif isinstance(config, PlacesConfig):
            done = f"model of places: {train_places(config, progress)}"
        else:
            done = f"light model: {fit_priors(config, progress=progress)}"
    print(done)


def train_folder(
    folder: Path,
    out: Path,
    config: AutoencoderConfig,
    changes: Mapping[str, Any] | None = None,
    *,
    report: Tell = print,
    progress: StageProgress = silent,
) -> Path:
    """Index ``folder``, train the network, fit the priors; returns ``out``, a light model's folder.

    ``folder`` is one of .exr or .hdr maps, or has an index of skies already. ``config`` says how
    to train; what the number of skies does not allow is changed, and ``report`` told: a batch of
    at most a quarter of the training skies, at least 300 steps, and below 2,000 training skies
    the weights of the shipped model to start from. ``changes`` are values by key that hold
    whatever the number of skies is.
    A run that was killed goes on where it was, in ``out / "training"``.
    """
    run = out / RUN
    with locked(run):
        place = _indexed(folder, run, report, progress)
        records = read_index(place)
        skies = sum(record.split == "train" for record in records)
        days = len({record.day for record in records})
        if len({record.split for record in records}) < 3:
            raise InputError(
                f"{folder}: {len(records)} skies of {days} day(s) cannot be divided into training, "
                "validation and test days; add skies of other days, or name their days with: "
                f"skylight skies index {folder} --days DAYS.csv"
            )
        priors = _priors(replace(config, **(changes or {})), place, out)
        try:
            splits_for_priors(priors, records)  # refuses too few before hours of training
        except InputError as error:
            again = f"; then delete {place}" if place != folder else ""
            raise InputError(f"{folder}: {error}{again}") from error
        fitted = fitting(config, changes or {}, skies, report)
        best = train(replace(fitted, data=place, out=run), report, progress=progress)
        report("fitting the priors")
        fit_priors(replace(priors, checkpoint=best), progress=progress)
    load_bundle(out, priors.network or None)
    return out


def light_model(config: AutoencoderConfig, progress: StageProgress = silent) -> Path:
    """The folder of a run of which the network is trained, with the priors fitted to its skies."""
    best = config.out / "model.safetensors"
    priors = replace(_priors(config, config.data, config.out), checkpoint=best)
    return fit_priors(priors, progress=progress)


def _priors(config: AutoencoderConfig, data: Path, out: Path) -> PriorConfig:
    own = "" if is_builtin(config.network) else config.network
    return PriorConfig(data=data, out=out, seed=config.seed, network=own)


def fitting(
    config: AutoencoderConfig, changes: Mapping[str, Any], skies: int, report: Tell
) -> AutoencoderConfig:
    """``config`` for so many training skies with ``changes``, as :func:`train_folder` says."""
    wanted = replace(config, **changes)
    batch = changes.get("batch", min(config.batch, max(1, skies // 4)))
    steps = max(1, skies // batch)
    epochs = changes.get("epochs", max(config.epochs, math.ceil(LEAST_STEPS / steps)))
    fitted: dict[str, Any] = {
        "batch": batch,
        "epochs": epochs,
        "patience": max(config.patience, epochs // 4),
    }
    like_shipped = (wanted.network, wanted.latents) == ("splines", SHIPPED_LATENTS)
    if skies < FEW and wanted.starts_from is None and like_shipped and "starts_from" not in changes:
        fitted |= {"starts_from": SHIPPED / NETWORK, "learning_rate": config.learning_rate / 3}
        report(f"{skies} training skies are few: the shipped model's weights are trained further")
    if batch != wanted.batch:
        report(f"batches of {batch} instead of {wanted.batch} skies")
    if epochs != wanted.epochs:
        report(f"{epochs} epochs instead of {wanted.epochs}")
    return replace(wanted, **{**fitted, **changes})


def _indexed(folder: Path, run: Path, report: Tell, progress: StageProgress) -> Path:
    """The place of an index of ``folder``: its own, that of an earlier run, or a new one."""
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; give one with .exr or .hdr maps")
    if is_index(folder / INDEX_NAME):
        return folder
    index = run / INDEX_NAME
    if index.exists():
        maps = (map_path(index, record).resolve() for record in read_index(index))
        if not any(folder.resolve() in path.parents for path in maps):
            raise InputError(
                f"{index} is of another folder than {folder}; choose another --out, or delete it"
            )
        report(f"{index}: used again; delete it to index {folder} anew")
        return index
    _, records, refusals = index_folder(folder, out=index, progress=with_time_left("map", progress))
    report(f"{len(records)} skies indexed")
    for refusal in refusals:
        report(refusal.sentence())
    return index
