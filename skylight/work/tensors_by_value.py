"""Tensors sent between processes as copies."""

from multiprocessing.reduction import ForkingPickler

import numpy as np
import torch
from jaxtyping import Shaped
from torch import Tensor


def send_tensors_by_value() -> None:
    """From now on this process sends tensors as their values, which arrive on the CPU.

    PyTorch sends a file descriptor of shared memory for each instead: some hundred for a batch of
    photographs, and containers have as little as 64 MB of such memory.
    """
    ForkingPickler.register(Tensor, _reduced)


def _reduced(tensor: Shaped[Tensor, "*s"]) -> tuple:
    return _again, (tensor.detach().cpu().numpy(),)


def _again(array: Shaped[np.ndarray, "*s"]) -> Shaped[Tensor, "*s"]:
    return torch.from_numpy(array)
