"""What a training run starts from, goes on from and leaves: weights, states, curves, pictures.

A state is everything that a run needs to go on, in a file with a checksum; the one before it is
kept, so that one of the two is whole whenever the run is killed.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.errors import InputError
from skylight.imaging._colour import tone_map
from skylight.io._bounded import write_json
from skylight.io._files import write_png
from skylight.io._tensors import read_tensors, write_tensors
from skylight.models._bundle import load_network
from skylight.models._convolutional import ConvolutionalAutoencoder
from skylight.models._network import SkyNetwork
from skylight.models._network_check import made_network
from skylight.models._network_names import is_builtin, network_class, network_name
from skylight.training._config import AutoencoderConfig
from skylight.work._progress import Tell

NEWEST, PREVIOUS = "state.safetensors", "state.previous.safetensors"
SHOWN = 8  # validation skies
WHITE = 1.5  # shown as full white; skies have mean luminance 1, clear ones most of it in the sun


Network = SkyNetwork | type[SkyNetwork]  # a class of the user's, or one that it has made


def initial_network(config: AutoencoderConfig, own: Network | None = None) -> SkyNetwork:
    """A network with weights of ``config.seed``, or those of ``config.starts_from``.

    ``own`` stands for the class that ``config.network`` names; one that is made already starts
    with the weights that it has.
    """
    if isinstance(own, SkyNetwork) and config.starts_from:
        raise InputError("`starts_from` and a network that has weights: give one of them")
    kind = own_class(own) or network_class(config.network)
    if own is not None:  # whose registered name other processes may not know
        config = replace(config, network=network_name(kind))
    is_own = not is_builtin(config.network)
    if config.starts_from:
        network = load_network(config.starts_from, kind if is_own else None)
    else:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            network = (
                ConvolutionalAutoencoder(config.latents, coding=config.coding, sun=config.sun)
                if config.network == "convolutions"
                else made_network(kind, config.latents)
            )
        if isinstance(own, SkyNetwork):
            if _shapes(own) != _shapes(network):
                raise InputError(
                    f"{config.network}({config.latents}) is another network than the one given, "
                    "and files hold its class and latents alone: make it by its latents"
                )
            network = own.cpu()
    found = (network_name(type(network)), network.latents, network.coding, network.sun)
    wanted = (config.network, config.latents, config.coding, config.sun)
    if found != wanted:
        told = "network: {}, latents: {}, coding: {}, sun: {}"
        made = f"{config.starts_from}: made with" if config.starts_from else "the network has"
        raise InputError(
            f"{made} {told.format(*found)}; the configuration says {told.format(*wanted)}"
        )
    return network


def own_class(own: Network | None) -> type[SkyNetwork] | None:
    """That of a network which the user gives."""
    return own if own is None or isinstance(own, type) else type(own)


def _shapes(network: SkyNetwork) -> dict[str, tuple[int, ...]]:
    return {name: tuple(each.shape) for name, each in network.state_dict().items()}


def write_state(folder: Path, state: dict[str, Any]) -> None:
    """Write ``state.safetensors``, what it held before to ``state.previous.safetensors``.

    ``state`` nests dictionaries, lists, tensors, numbers and texts; all but the tensors is JSON in
    the file's header. At every moment one of the two files is whole.
    """
    tensors: dict[str, Tensor] = {}
    plain = json.dumps(_without_tensors(state, tensors))
    newest = folder / NEWEST
    if newest.exists():
        os.replace(newest, folder / PREVIOUS)
    write_tensors(newest, tensors, {"state": plain})


def read_state(
    folder: Path, identity: Mapping[str, Any], report: Tell = print
) -> dict[str, Any] | None:
    """The newest whole state of a run, or None where there is none yet.

    ``identity`` has all settings that the state's own must equal; where they do not, the
    :class:`InputError` names them.
    """
    present = [p for p in (folder / NEWEST, folder / PREVIOUS) if p.exists()]
    if not present:
        return None
    for path in present:
        state = _read(path)
        if state is None:
            report(f"{path}: damaged (its checksum differs)")
        elif different := _differences(state["identity"], identity):
            raise InputError(
                f"{path}: belongs to a run of another configuration: {different}; go on with those "
                f"of before, choose another `out`, or delete {folder / '*state*.safetensors'} to "
                "start anew"
            )
        else:
            return state
    names = " and ".join(str(p) for p in present)
    raise InputError(f"{names}: damaged, nothing to go on from; delete to start the run anew")


def _differences(before: Mapping[str, Any] | str, now: Mapping[str, Any]) -> str:
    """The settings that differ, with both values, or nothing."""
    if isinstance(before, str):
        return "its settings are kept in the form of an earlier version of skylight"
    names = [*now, *(name for name in before if name not in now)]
    return ", ".join(
        f"`{name}` was {before.get(name, 'not there')} and is {now.get(name, 'not there')}"
        for name in names
        if (name in before, before.get(name)) != (name in now, now.get(name))
    )


def sha256_of(path: Path) -> str:
    """How a setting that is a file is told from others: by what is in it, not where it is."""
    return f"SHA-256 {hashlib.sha256(path.read_bytes()).hexdigest()[:16]}"


def drop_damaged(folder: Path) -> None:
    """Remove a damaged newest state, before the next one pushes it over the whole one."""
    newest = folder / NEWEST
    if newest.exists() and _read(newest) is None:
        newest.unlink()


def _read(path: Path) -> dict[str, Any] | None:
    """None for a file that is damaged; :class:`InputError` where it cannot be read at all."""
    try:
        tensors, metadata = read_tensors(path)
        state = _with_tensors(json.loads(metadata["state"]), tensors)
        return state if isinstance(state, dict) and "identity" in state else None
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror or error}); mend that, or choose another out"
        ) from error
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def _without_tensors(value: Any, tensors: dict[str, Tensor]) -> Any:
    """``value`` as JSON can hold it; its tensors go to ``tensors`` and leave their names."""
    if isinstance(value, Tensor):
        name = str(len(tensors))
        tensors[name] = value.clone()  # tensors of a file share no memory
        return {"tensor": name}
    if isinstance(value, dict):  # pairs, since keys may be numbers
        return {"pairs": [[key, _without_tensors(each, tensors)] for key, each in value.items()]}
    if isinstance(value, list | tuple):
        return [_without_tensors(each, tensors) for each in value]
    return value


def _with_tensors(value: Any, tensors: dict[str, Tensor]) -> Any:
    if isinstance(value, list):
        return [_with_tensors(each, tensors) for each in value]
    if not isinstance(value, dict):
        return value
    if "tensor" in value:
        return tensors[value["tensor"]]
    return {key: _with_tensors(each, tensors) for key, each in value["pairs"]}


def write_epoch(
    out: Path,
    facts: Mapping[str, Any],
    curves: list[dict[str, int | float]],
    picture: UInt8[np.ndarray, "h w 3"],
) -> None:
    """``curves.json``, an entry per epoch, and the last one's picture."""
    write_json(out / "curves.json", {**facts, "curves": curves})
    folder = out / "reconstructions"
    folder.mkdir(exist_ok=True)
    write_png(folder / f"epoch_{len(curves):04d}.png", picture)


def spread(
    skies: Float[np.ndarray, "m h w 3"] | Float[Tensor, "m h w 3"],
) -> Float[Tensor, "n h w 3"]:
    """At most :data:`SHOWN` skies, evenly spread over all."""
    fixed = np.linspace(0, len(skies) - 1, min(SHOWN, len(skies))).round().astype(int)
    return torch.as_tensor(skies[fixed])


@torch.no_grad()
def reconstructions(
    network: SkyNetwork, truth: Float[Tensor, "n h w 3"]
) -> UInt8[np.ndarray, "_ _ 3"]:
    """Truth over reconstruction, 2h x nw pixels, under one exposure."""
    network.eval()
    device = next(network.parameters()).device
    again = network.decode(network.encode(truth.to(device))).cpu()
    rows = [torch.cat(list(skies), 1) for skies in (truth, again)]
    return tone_map(torch.cat(rows), white=WHITE)
