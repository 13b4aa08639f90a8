"""Sparse codes: JSON."""

import torch

from skylight.csc._code import SparseCode
from tests.fuzz.files import as_file, written


def seeds() -> list[bytes]:
    code = SparseCode(
        dictionary="ani",
        fingerprint="0123",
        height=16,
        banded=True,
        filters=torch.tensor([0, 3]),
        directions=torch.tensor([[0.0, 1.0, 0.0], [0.6, 0.8, 0.0]], dtype=torch.float64),
        twists_rad=torch.tensor([0.0, 0.5], dtype=torch.float64),
        weights=torch.ones(2, 3, dtype=torch.float64),
        relative_error=0.25,
    )
    return [written("a.json", code.save)]


def read(content: bytes) -> None:
    code = SparseCode.load(as_file(content, "code.json"))
    assert bool(code.weights.isfinite().all())
