"""Safetensors files whose checksum is right, whatever is in them.

A line of JSON, {"texts": {...}, "tensors": {name: [type, shape]}}, then the bytes of the tensors;
zeros where they end early. Mutated files themselves would all be refused for their checksum.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from skylight.errors import OutputError
from skylight.io._tensors import write_tensors

_TYPES = {
    str(kind).removeprefix("torch."): kind
    for kind in (torch.float32, torch.float16, torch.float64, torch.int64, torch.uint8, torch.bool)
}
_MOST_BYTES = 2**23


def described(
    tensors: Mapping[str, Tensor], texts: Mapping[str, str] | None = None, *, with_data: bool = True
) -> bytes:
    """The content that :func:`write_described` makes a file of; of zeros without the data."""
    kinds = {
        name: [str(each.dtype).removeprefix("torch."), list(each.shape)]
        for name, each in tensors.items()
    }
    data = b"".join(each.numpy().tobytes() for each in tensors.values()) if with_data else b""
    return json.dumps({"texts": texts or {}, "tensors": kinds}).encode() + b"\n" + data


def write_described(path: Path, content: bytes) -> dict[str, Tensor]:
    """The tensors of that file; none where it has the content as it is, which describes none."""
    line, _, data = content.partition(b"\n")
    try:
        told = json.loads(line)
        tensors, texts = _tensors(told["tensors"], data), dict(told["texts"])
        write_tensors(path, tensors, texts)
    # whatever a mutated description lacks, and what safetensors says of it
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, RuntimeError,
            OverflowError, OutputError):  # fmt: skip
        path.write_bytes(content)
        return {}
    return tensors


def _tensors(kinds: dict[str, Any], data: bytes) -> dict[str, Tensor]:
    tensors, start = {}, 0
    for name, (kind, shape) in kinds.items():
        dtype, count = _TYPES[kind], math.prod(shape)
        size = count * dtype.itemsize
        if not 0 <= start + size <= _MOST_BYTES or size < 0:
            raise ValueError
        own = data[start : start + size].ljust(size, b"\0")
        flat = torch.frombuffer(bytearray(own), dtype=dtype) if size else torch.zeros(0).to(dtype)
        tensors[name] = flat.reshape(shape)
        start += size
    return tensors
