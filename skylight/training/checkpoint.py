"""What a run leaves behind to go on from: its state, twice, and the best network."""

import hashlib
import io
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file

from skylight.errors import InputError
from skylight.imaging.atomic import atomic_path
from skylight.models.autoencoder import SkyAutoencoder

NEWEST, PREVIOUS = "state.pt", "state.previous.pt"
_DIGEST = hashlib.sha256().digest_size


def save_network(network: SkyAutoencoder, path: Path) -> None:
    """Write the weights as ``skylight.models.autoencoder.load_network`` reads them."""
    state = {k: v.detach().cpu().contiguous() for k, v in network.state_dict().items()}
    if network.coding == "linear":
        state["coding_linear"] = torch.ones(1)
    with atomic_path(path) as temporary:
        save_file(state, temporary)


def write_state(folder: Path, state: dict[str, Any]) -> None:
    """Write ``state.pt``, what it held before to ``state.previous.pt``.

    Torch's own format with the SHA-256 of its bytes behind it. At every moment one of the two
    files is whole.
    """
    content = io.BytesIO()
    torch.save(state, content)
    payload = content.getvalue()
    newest = folder / NEWEST
    if newest.exists():
        os.replace(newest, folder / PREVIOUS)
    with atomic_path(newest) as path:
        path.write_bytes(payload + hashlib.sha256(payload).digest())


def read_state(
    folder: Path, identity: str, report: Callable[[str], None] = print
) -> dict[str, Any] | None:
    """The newest whole state of a run, or None where there is none yet.

    Raises
    ------
    InputError
        Both states are damaged, or they belong to a run with another ``identity``.
    """
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
    """Remove a damaged ``state.pt``, before the next state pushes it over the whole one."""
    newest = folder / NEWEST
    if newest.exists() and _read(newest) is None:
        newest.unlink()


def _read(path: Path) -> dict[str, Any] | None:
    content = path.read_bytes()
    payload, digest = content[:-_DIGEST], content[-_DIGEST:]
    if hashlib.sha256(payload).digest() != digest:
        return None
    try:
        # to the CPU first: a run may go on where the device that it began on is not there
        return torch.load(io.BytesIO(payload), weights_only=True, map_location="cpu")
    except (RuntimeError, EOFError, ValueError, KeyError, pickle.UnpicklingError) as error:
        raise InputError(
            f"{path}: whole, but this torch cannot read it ({type(error).__name__}: {error}); "
            "use the version that wrote it, or choose another `out`".replace("\n", " ")
        ) from error
