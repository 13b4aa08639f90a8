"""Safetensors: priors and dictionaries of filters."""

import torch

from skylight.csc.dictionary import FilterBank
from skylight.errors import SkylightError
from skylight.models.prior import GaussianMixture
from tests.fuzz.files import as_file, written


def seeds() -> list[bytes]:
    bank = FilterBank(torch.eye(4, dtype=torch.float64), "four")
    mixture = GaussianMixture(torch.ones(1), torch.zeros(1, 2), torch.eye(2)[None])
    return [written("a.safetensors", bank.save), written("b.safetensors", mixture.save)]


def read(content: bytes) -> None:
    path = as_file(content, "a.safetensors")
    try:
        FilterBank.load(path)
    except SkylightError:
        GaussianMixture.load(path)
