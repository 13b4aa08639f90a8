"""Checkpoints of a run."""

import json
import os
from pathlib import Path
from typing import Any

from torch import Tensor

from skylight.errors import InputError
from skylight.io.tensors import read_tensors, write_tensors
from skylight.work.progress import Tell

NEWEST, PREVIOUS = "state.safetensors", "state.previous.safetensors"


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
