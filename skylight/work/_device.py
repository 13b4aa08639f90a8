"""The device of a computation: the meaning of ``--device``."""

from typing import TYPE_CHECKING, Literal

from skylight.errors import InputError

if TYPE_CHECKING:
    import torch

Device = Literal["auto", "cpu", "cuda"]


def choose_device(name: str = "auto") -> "torch.device":
    """The device of that name: ``auto`` is CUDA where torch finds it, otherwise the CPU.

    Raises
    ------
    InputError
        No such device here.
    """
    import torch  # the command line names the choices without it

    count = torch.cuda.device_count()
    if name == "auto":
        name = "cuda" if count else "cpu"
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise InputError(f"unknown device {name!r}: choose auto, cpu or cuda") from error
    if device.type == "mps":
        raise InputError(
            "device 'mps' is not supported: it has no float64, in which tables, sums and least "
            "squares are computed here; choose auto or cpu"
        )
    if device.type not in ("cpu", "cuda"):
        raise InputError(f"device {name!r} is not supported: choose auto, cpu or cuda")
    if device.type == "cuda" and (device.index or 0) >= count:
        raise InputError(
            f"device {name!r}: torch finds {count} CUDA devices here; choose auto or cpu"
        )
    return device
