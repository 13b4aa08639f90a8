"""What a training run starts from, goes on from and shows: weights, states and logs.

A state is everything that a run needs to go on, in a file with a checksum; the one before it is
kept, so that one of the two is whole whenever the run is killed. Logs are the curves as JSON,
reconstructions as PNG, and both for TensorBoard where it is installed.
"""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.errors import InputError, not_installed
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


def read_state(folder: Path, identity: str, report: Tell = print) -> dict[str, Any] | None:
    """The newest whole state of a run, or None where there is none yet."""
    present = [p for p in (folder / NEWEST, folder / PREVIOUS) if p.exists()]
    if not present:
        return None
    for path in present:
        state = _read(path)
        if state is None:
            report(f"{path}: damaged (its checksum differs)")
        elif state["identity"] != identity:
            raise InputError(
                f"{path}: belongs to a run with other data or another configuration; "
                "choose another `out`, or delete it to start anew"
            )
        else:
            return state
    names = " and ".join(str(p) for p in present)
    raise InputError(f"{names}: damaged, nothing to go on from; delete to start the run anew")


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


class Logs:
    """Writes ``curves.json``, ``reconstructions/*.png`` and, where installed, TensorBoard's logs.

    ``step`` is where the run goes on: TensorBoard hides what an earlier one logged beyond it.
    """

    def __init__(
        self,
        out: Path,
        validation: Float[np.ndarray, "m h w 3"],
        *,
        facts: dict[str, Any],
        step: int,
        report: Tell,
    ) -> None:
        self.out, self.facts, self.report = out, facts, report
        self.truth = spread(validation)
        (out / "reconstructions").mkdir(exist_ok=True)
        self.board = _tensorboard(out / "tensorboard", step, report)

    def epoch(self, network: SkyNetwork, curves: list[dict[str, int | float]], best: float) -> None:
        """Log the last of ``curves``, an entry per epoch."""
        last = curves[-1]
        step = int(last["step"])
        write_json(self.out / "curves.json", {**self.facts, "curves": curves})
        picture = reconstructions(network, self.truth)
        write_png(self.out / "reconstructions" / f"epoch_{len(curves):04d}.png", picture)
        if self.board:
            for name in ("train", "validation", "denoising"):
                self.board.add_scalar(f"loss/{name}", last[name], step)
            for name in ("learning_rate", "images_per_s"):
                self.board.add_scalar(name, last[name], step)
            self.board.add_image("reconstructions", picture, step, dataformats="HWC")
            self.board.flush()
        self.report(
            f"epoch {len(curves)}  train {last['train']:.4f}  validation "
            f"{last['validation']:.4f}  corrupted {last['denoising']:.4f}  best {best:.4f}  "
            f"{last['images_per_s']:.0f} images/s"
        )

    def close(self) -> None:
        if self.board:
            self.board.close()


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


def _tensorboard(folder: Path, step: int, report: Tell) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        report(f"no TensorBoard logs: {not_installed('tensorboard', 'writing them')}")
        return None
    return SummaryWriter(str(folder), purge_step=step + 1)
