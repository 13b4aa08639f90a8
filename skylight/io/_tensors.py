"""Tensors in safetensors files, which carry the SHA-256 of what they hold in their JSON header."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, uint8

from skylight.io._atomic import atomic_path
from skylight.io._bounded import json_loads, require_bytes

_HEADER, _DIGEST = "skylight", "sha256"


def write_tensors(
    path: str | Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str] | None = None
) -> None:
    """Write tensors and metadata atomically.

    Raises
    ------
    OutputError
        The disk does not take the file.
    """
    here = {name: t.detach().cpu().contiguous() for name, t in tensors.items()}
    told = dict(metadata or {})
    with atomic_path(path) as temporary:
        try:
            # one entry, as the format keeps several in no order: equal content, equal files
            header = json.dumps({**told, _DIGEST: tensors_sha256(here, told)}, sort_keys=True)
            save_file(here, temporary, metadata={_HEADER: header})
        except SafetensorError as error:  # its word for an operating system's error
            raise OSError(str(error)) from error


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """The tensors and the metadata that :func:`write_tensors` wrote, checked by their hash.

    Raises
    ------
    OSError, ValueError
        The file cannot be opened; it is cut short, damaged, without a hash, or no such file.
    """
    require_bytes(path)
    try:
        with safe_open(path, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            header = (file.metadata() or {}).get(_HEADER, "{}")
    except SafetensorError as error:
        raise ValueError(" ".join(str(error).split())) from error
    metadata = json_loads(header)
    if not isinstance(metadata, dict) or not all(type(v) is str for v in metadata.values()):
        raise ValueError("its header is damaged")
    digest = metadata.pop(_DIGEST, None)
    if digest is None:
        raise ValueError("it carries no SHA-256 of its content")
    if digest != tensors_sha256(tensors, metadata):
        raise ValueError("damaged: its content has another SHA-256 than it says")
    return tensors, metadata


def tensors_sha256(tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> str:
    """SHA-256 over names, types, shapes and bytes of tensors, and over texts."""
    digest = hashlib.sha256()
    for name, text in sorted(metadata.items()):
        digest.update(repr((name, text)).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(repr((name, str(tensor.dtype), tuple(tensor.shape))).encode())
        digest.update(tensor.reshape(-1).view(uint8).numpy().data)
    return digest.hexdigest()
