"""Skies as a run's network takes them, made once by all cores: varied, without their sun, coded.

A step then reads its batch from disk. Drawing surroundings and finding suns takes ten times as
long as a step of a small network.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.io.atomic import atomic_path
from skylight.models.networks.base import HEIGHT, WIDTH, SkyNetwork
from skylight.training.config import AutoencoderConfig
from skylight.training.initial import initial_network
from skylight.training.skies.augment import augment
from skylight.training.skies.cores import in_order
from skylight.work.progress import Tell

FOLDER = "prepared"  # in a run's folder, until it ends
_CHUNK = 64  # skies varied by the same generator
_HALF_LIMIT = 6e4  # of half precision; reached by suns of the linear coding alone


@dataclass(frozen=True)
class CodedSkies:
    """What :meth:`SkyNetwork.split` makes of n skies: ``sun`` (n,s), and the rest coded, on disk
    in half precision (n,3,h,w)."""

    sun: Float[np.ndarray, "n s"]
    coded: Float[np.ndarray, "n 3 h w"]

    def __len__(self) -> int:
        return len(self.coded)

    def batch(
        self, chosen: Int[np.ndarray, " b"] | list[int]
    ) -> tuple[Float[Tensor, "b s"], Float[Tensor, "b 3 h w"]]:
        """Those skies in single precision."""
        coded = torch.from_numpy(self.coded[chosen]).float()
        return torch.from_numpy(self.sun[chosen]), coded


def coded_skies(network: SkyNetwork, skies: Float[Tensor, "n h w 3"]) -> CodedSkies:
    """Those skies, in memory and as they are."""
    sun, rest = network.split(skies)
    return CodedSkies(sun.numpy(), network.code(rest).clamp(max=_HALF_LIMIT).half().numpy())


def prepare(
    path: Path, config: AutoencoderConfig, out: Path, copies: Sequence[int], report: Tell
) -> None:
    """Write the copies of the skies in ``path`` that are not there yet; see :func:`open_prepared`.

    Copy c of a sky is varied as ``augment`` says, by a generator that the seed, c and the sky's
    chunk of 64 decide. Different skies of ``path`` "train" and "validation" meet the same draws.
    """
    count = len(np.load(path, mmap_mode="r"))
    out.mkdir(parents=True, exist_ok=True)
    for copy in copies:
        place = _place(path, config, out, copy)
        if place.with_suffix(".sun.npy").exists():
            continue
        parts = [slice(i, min(i + _CHUNK, count)) for i in range(0, count, _CHUNK)]
        jobs = [(path, config, copy, part) for part in parts]
        # the suns take their place last: where they are, all is
        with atomic_path(place.with_suffix(".sun.npy")) as beside, atomic_path(place) as temporary:
            shape = (count, 3, HEIGHT, WIDTH)
            coded = np.lib.format.open_memmap(temporary, mode="w+", dtype=np.float16, shape=shape)
            suns = []
            for part, skies in zip(parts, in_order(_vary, jobs), strict=True):
                coded[part] = skies.coded
                suns.append(skies.sun)
            coded.flush()
            with beside.open("wb") as file:
                np.save(file, np.concatenate(suns))
        report(f"{count} skies prepared, copy {copy + 1}")


def open_prepared(path: Path, config: AutoencoderConfig, out: Path, copy: int) -> CodedSkies:
    """A copy that :func:`prepare` has written."""
    place = _place(path, config, out, copy)
    return CodedSkies(np.load(place.with_suffix(".sun.npy")), np.load(place, mmap_mode="r"))


def _place(path: Path, config: AutoencoderConfig, out: Path, copy: int) -> Path:
    what = (path.stem, config.network, config.coding, config.sun, config.seed)
    how = (config.mirror, config.tint, config.surroundings, config.white_balance, copy)
    return out / f"{hashlib.sha256(repr((what, how)).encode()).hexdigest()[:16]}.npy"


def _vary(job: tuple[Path, AutoencoderConfig, int, slice]) -> CodedSkies:
    path, config, copy, part = job
    generator = torch.Generator().manual_seed(
        (config.seed * 1_000_003 + copy) * 1_000_003 + part.start
    )
    skies = torch.from_numpy(np.load(path, mmap_mode="r")[part].copy())
    return coded_skies(_network(config), augment(skies, generator, config))


@cache
def _network(config: AutoencoderConfig) -> SkyNetwork:
    return initial_network(config)
