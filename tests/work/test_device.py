"""Devices by name."""

import pytest
import torch

from skylight.errors import InputError
from skylight.work._device import choose_device

HAS_CUDA = torch.cuda.is_available()


def test_auto_is_cuda_where_it_is() -> None:
    assert choose_device("auto").type == ("cuda" if HAS_CUDA else "cpu")
    assert choose_device("cpu") == torch.device("cpu")


@pytest.mark.skipif(HAS_CUDA, reason="there is a CUDA device")
def test_cuda_without_a_device_is_refused() -> None:
    with pytest.raises(InputError, match="0 CUDA devices"):
        choose_device("cuda")


@pytest.mark.parametrize("name", ["cuda:99", "gpu", "meta", "", "mps:1"])
def test_devices_that_are_not_there(name: str) -> None:
    with pytest.raises(InputError) as caught:
        choose_device(name)
    assert "choose auto" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_mps_is_refused_for_what_it_lacks() -> None:
    with pytest.raises(InputError, match="it has no float64"):
        choose_device("mps")
