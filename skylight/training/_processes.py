"""Training in several processes: ``torchrun`` starts them, ``torch.distributed`` links them.

Each process computes the loss of an equal part of every batch; gradients are averaged and batch
normalisation's statistics added up by torch's ``all_reduce``, by gloo on CPUs and NCCL on CUDA.

Three things of torch's are left aside. ``DistributedDataParallel`` keeps the process group, and
with it the threads of gloo, beyond ``destroy_process_group``, where they may abort a process that
ends; one ``all_reduce`` of all gradients does what is needed of it. ``SyncBatchNorm`` exists on
CUDA alone, so that two processes on a CPU could not be compared with one. The ``all_reduce`` of
``torch.distributed.nn``, which has a gradient, is deprecated for one that is not public.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import torch
import torch.distributed as dist
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from skylight.errors import InputError
from skylight.work._device import choose_device

# The first process may convert a whole database while the others wait for it.
_PATIENCE = timedelta(hours=6)


@dataclass(frozen=True, kw_only=True)
class Processes:
    """This process, ``rank`` of ``size``, and where it computes."""

    rank: int
    size: int
    device: torch.device

    @property
    def first(self) -> bool:
        """Whether this one writes the files and speaks."""
        return self.rank == 0

    def share(self, batch: int) -> slice:
        """This process' part of a batch; all parts are equal, so means of means are means."""
        if batch % self.size:
            raise InputError(
                f"a `batch` of {batch} does not divide among {self.size} processes; "
                "choose a multiple of their number"
            )
        part = batch // self.size
        return slice(self.rank * part, (self.rank + 1) * part)

    def sum(self, value: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
        """The sum over all processes, the same bits in each; no gradient."""
        if self.size > 1:
            value = value.clone()
            dist.all_reduce(value)
        return value

    def from_first(self, sha256: str = "") -> str:
        """What the first process has as ``sha256``; the others give nothing."""
        if self.size == 1:
            return sha256
        # as plain bytes: torch's way to send objects is pickle
        content = torch.tensor(list(bytes.fromhex(sha256) or bytes(32)), dtype=torch.uint8)
        content = content.to(self.device)
        dist.broadcast(content, src=0)
        return bytes(content.tolist()).hex()

    def mean_gradients(self, module: nn.Module) -> None:
        """Replace the gradients of a module by their means over all processes, in one message.

        All processes have gradients of the same parameters.
        """
        if self.size == 1:
            return
        gradients = [p.grad for p in module.parameters() if p.grad is not None]
        mean = self.sum(torch.cat([g.reshape(-1) for g in gradients])) / self.size
        for gradient, part in zip(
            gradients, mean.split([g.numel() for g in gradients]), strict=True
        ):
            gradient.copy_(part.view_as(gradient))

    def share_weights(self, module: nn.Module) -> None:
        """Give the module the first process' weights and buffers in all."""
        if self.size > 1:
            for tensor in module.state_dict().values():
                dist.broadcast(tensor, src=0)

    def meet(self) -> None:
        """Return when all processes are here."""
        if self.size > 1:
            dist.barrier()


@contextmanager
def processes(device_name: str) -> Iterator[Processes]:
    """This process among those that ``torchrun`` started, or the only one.

    Talks by gloo on CPUs and by NCCL on CUDA, where each local process has a device of its own.
    """
    launched = "LOCAL_RANK" in os.environ and "WORLD_SIZE" in os.environ
    size = int(os.environ["WORLD_SIZE"]) if launched else 1
    device = _device(device_name, int(os.environ["LOCAL_RANK"]) if size > 1 else None)
    if size == 1:
        yield Processes(rank=0, size=1, device=device)
        return
    backend = "nccl" if device.type == "cuda" else "gloo"
    dist.init_process_group(backend, timeout=_PATIENCE)
    try:
        yield Processes(rank=dist.get_rank(), size=size, device=device)
    finally:
        dist.destroy_process_group()


def _device(name: str, local_rank: int | None) -> torch.device:
    device = choose_device(name)
    if device.type == "cuda":
        index = (device.index or 0) if local_rank is None else local_rank
        device = choose_device(f"cuda:{index}")
        torch.cuda.set_device(device)
    return device


class _SumOverProcesses(torch.autograd.Function):
    """y = sum over processes of x; every process' loss depends on y, so gradients add up too."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        y = x.clone()
        dist.all_reduce(y)
        return y

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        total = gradients[0].contiguous().clone()
        dist.all_reduce(total)
        return total


class SharedBatchNorm(_BatchNorm):
    """Batch normalisation by the mean and variance of all processes' equal shares.

    y = (x - m) / sqrt(v + eps) w + b with m, v over the global batch and all places, running
    statistics as torch's own (v n / (n - 1)).
    """

    def _check_input_dim(self, input: Tensor) -> None:
        assert input.dim() in (2, 3, 4)

    def forward(self, input: Float[Tensor, "b c *s"]) -> Float[Tensor, "b c *s"]:
        if not self.training:
            return super().forward(input)
        momentum, tracked = self.momentum, self.num_batches_tracked
        running_mean, running_variance = self.running_mean, self.running_var
        assert momentum is not None
        assert tracked is not None
        assert running_mean is not None
        assert running_variance is not None
        x = input.to(torch.promote_types(input.dtype, torch.float32))
        over = [d for d in range(x.dim()) if d != 1]
        column = [1, -1] + [1] * (x.dim() - 2)
        count = x.numel() // x.shape[1] * dist.get_world_size()
        mean = _SumOverProcesses.apply(x.sum(over)) / count
        centred = x - mean.reshape(column)
        variance = _SumOverProcesses.apply(centred.square().sum(over)) / count
        with torch.no_grad():
            tracked += 1
            running_mean.lerp_(mean, momentum)
            running_variance.lerp_(variance * count / (count - 1), momentum)
        scale = torch.rsqrt(variance + self.eps)
        if not self.affine:
            return (centred * scale.reshape(column)).to(input.dtype)
        scale = scale * self.weight
        return (centred * scale.reshape(column) + self.bias.reshape(column)).to(input.dtype)


def share_batch_statistics(module: nn.Module) -> None:
    """Replace every batch normalisation inside ``module``, its parameters and buffers kept."""
    for name, child in module.named_children():
        if isinstance(child, nn.BatchNorm1d | nn.BatchNorm2d):
            if child.momentum is None or not child.track_running_stats:
                raise InputError(
                    f"{name}: batch normalisation without running statistics of a fixed momentum "
                    "does not train in several processes; run one, or give it those"
                )
            shared = SharedBatchNorm(
                child.num_features, eps=child.eps, momentum=child.momentum, affine=child.affine
            )
            shared.weight, shared.bias = child.weight, child.bias
            for buffer in ("running_mean", "running_var", "num_batches_tracked"):
                setattr(shared, buffer, getattr(child, buffer))
            setattr(module, name, shared)
        else:
            share_batch_statistics(child)
