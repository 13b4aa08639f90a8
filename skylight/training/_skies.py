"""The skies of a training run, from the index to a step's batch.

1. :func:`load_data` converts the maps of an index once to float32 arrays, mapped from disk.
2. :func:`prepare` varies them as :func:`augment` says (mirrored, tinted, with surroundings), takes
   their suns out and codes the rest as the run's network takes it, once for all epochs and by all
   cores: drawing surroundings and finding suns take ten times as long as a small network's step.
3. :func:`draw_batch` reads a step's skies and draws their :class:`Corruption`, which the network
   learns to undo.

All of it is a function of the seed, and of the place in the run.
"""

import hashlib
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.errors import InputError, SkylightError
from skylight.io._atomic import atomic_path
from skylight.models._network import HEIGHT, WIDTH, SkyNetwork
from skylight.models._network_check import example_skies
from skylight.models._network_names import is_importable
from skylight.models._sun_head import COORDINATES
from skylight.skies._index import SkyRecord, folder_hash, load_skies, normalise, read_index
from skylight.skies.surroundings._scenes import surroundings
from skylight.sphere._frame import DirectionGrid
from skylight.training._checkpoint import initial_network
from skylight.training._config import AutoencoderConfig
from skylight.work._progress import StageProgress, Tell, silent, with_time_left
from skylight.work._threads import cores

CHUNK = 32  # skies that one process converts at a time
CACHE = ".cache"  # folder beside the index
FOLDER = "prepared"  # in a run's folder, until it ends
BLOCK = 8  # rows and columns of what is hidden together: 22.5 degrees
_CHUNK = 64  # skies varied by the same generator
_HALF_LIMIT = 6e4  # of half precision; reached by suns of the linear coding alone

Job = TypeVar("Job")
Result = TypeVar("Result")


@dataclass(frozen=True, kw_only=True)
class SkyData:
    """Training and validation skies (n,h,w,3), mapped from disk; where they lie, by the names
    "train" and "validation"; and the hash of their data."""

    train: Float[np.ndarray, "n h w 3"]
    validation: Float[np.ndarray, "m h w 3"]
    paths: dict[str, Path]
    hash: str


def load_data(place: Path, report: Tell = print, progress: StageProgress = silent) -> SkyData:
    """The training and validation days of an index (its file or folder), converted once.

    ``.cache`` beside the index keeps them as float32 arrays named by the hash of the data, each
    with its SHA-256; one that does not agree is made anew, which ``report`` is told.

    Raises
    ------
    InputError
        No index, a map that cannot be read, or a split without days.
    """
    records = read_index(place)
    splits = {s: [r for r in records if r.split == s] for s in ("train", "validation")}
    if not all(splits.values()):
        raise InputError(
            f"{place}: too few days: training and validation split by day, and one is empty"
        )
    digest = folder_hash(place, records)
    for split, rows in splits.items():
        path = _cache_path(place, digest, split)
        fault = _fault(path, len(rows))
        if fault == "missing":
            report(f"{place}: reading {len(rows)} {split} skies, this once")
        elif fault:
            report(f"{path}: damaged ({fault}); made anew")
        if fault:
            _write_cache(path, place, rows, progress)
    return open_cache(place, digest)


def open_cache(place: Path, digest: str) -> SkyData:
    """The data that :func:`load_data` has just checked, in another process."""
    paths = {split: _cache_path(place, digest, split) for split in ("train", "validation")}
    train, validation = (np.load(path, mmap_mode="r") for path in paths.values())
    return SkyData(train=train, validation=validation, paths=paths, hash=digest)


def _cache_path(place: Path, digest: str, split: str) -> Path:
    folder = place.parent if place.is_file() else place
    return folder / CACHE / f"{digest[:16]}-{split}.npy"


def _fault(path: Path, count: int) -> str | None:
    """Why a cache cannot be used: missing, its shape, or its checksum."""
    if not path.exists():
        return "missing"
    try:
        skies = np.load(path, mmap_mode="r")
        expected = path.with_suffix(".sha256").read_text()
        with path.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError, EOFError) as error:
        return type(error).__name__
    if skies.shape != (count, HEIGHT, WIDTH, 3) or skies.dtype != np.float32:
        return f"{skies.dtype} of shape {skies.shape}"
    return None if found == expected else "its checksum differs"


def _write_cache(
    path: Path, place: Path, records: list[SkyRecord], progress: StageProgress
) -> None:
    path.parent.mkdir(exist_ok=True)
    with atomic_path(path) as temporary:
        shape = (len(records), HEIGHT, WIDTH, 3)
        skies = np.lib.format.open_memmap(temporary, mode="w+", dtype=np.float32, shape=shape)
        done, tell = 0, with_time_left("reading sky", progress)
        chunks = [(place, records[i : i + CHUNK]) for i in range(0, len(records), CHUNK)]
        for part in in_order(_convert, chunks):
            skies[done : done + len(part)] = part
            done += len(part)
            tell(done, len(records))
        skies.flush()
        # before the array takes its place: an array without a checksum is a damaged one
        with temporary.open("rb") as file, atomic_path(path.with_suffix(".sha256")) as beside:
            beside.write_text(hashlib.file_digest(file, "sha256").hexdigest())


def _convert(chunk: tuple[Path, list[SkyRecord]]) -> Float[np.ndarray, "_ h w 3"]:
    return load_skies(*chunk, height=HEIGHT).numpy()


def augment(
    batch: Float[Tensor, "b h w 3"], generator: torch.Generator, config: AutoencoderConfig
) -> Float[Tensor, "b h w 3"]:
    """Skies mirrored, tinted and with things before them, by chance; mean luminance 1.

    ``mirror``: every other sky. ``tint``: standard deviation of each channel's log gain, as
    cameras' white balances differ. ``surroundings``: the share of skies that get them (see
    :func:`~skylight.skies.surroundings._scenes.surroundings`). ``white_balance``: a channel of
    mean m over the hemisphere, sun and surroundings included, is multiplied by m^-u, where u is
    uniform from 0 to ``white_balance``; 1 is a grey mean, to which cameras tend.
    """
    if config.mirror:
        # about the middle of column w/2, where the sun is: column c becomes w - c
        flipped = torch.roll(batch.flip(2), 1, dims=2)
        keep = torch.rand(len(batch), generator=generator) < 0.5
        batch = torch.where(keep[:, None, None, None], batch, flipped)
    if config.tint:
        gain = torch.exp(config.tint * torch.randn(len(batch), 1, 1, 3, generator=generator))
        batch = batch * gain
    if config.surroundings:
        some = torch.rand(len(batch), generator=generator) < config.surroundings
        cover, radiance = surroundings(batch[some], generator)
        batch = batch.clone()
        batch[some] = batch[some] * (1 - cover) + radiance * cover
    if config.white_balance:
        solid = DirectionGrid.sky(batch.shape[1]).solid_angles.to(batch)
        mean = torch.einsum("n,bnc->bc", solid, batch.flatten(1, 2)).clamp(min=1e-6)
        towards = config.white_balance * torch.rand(len(batch), 1, generator=generator)
        batch = batch * mean.pow(-towards)[:, None, None]
    return normalise(batch)


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
    path: Path,
    config: AutoencoderConfig,
    out: Path,
    copies: Sequence[int],
    progress: StageProgress = silent,
    network: type[SkyNetwork] | None = None,
) -> None:
    """Write the copies of the skies in ``path`` that are not there yet; see :func:`open_prepared`.

    Copy c of a sky is varied as ``augment`` says, by a generator that the seed, c and the sky's
    chunk of 64 decide. Different skies of ``path`` "train" and "validation" meet the same draws.
    ``network`` is the user's class where the configuration's name does not lead to it.
    """
    count = len(np.load(path, mmap_mode="r"))
    out.mkdir(parents=True, exist_ok=True)
    tell = with_time_left("preparing sky", progress)
    for turn, copy in enumerate(copies):
        place = _place(path, config, out, copy, network)
        if place.with_suffix(".sun.npy").exists():
            continue
        parts = [slice(i, min(i + _CHUNK, count)) for i in range(0, count, _CHUNK)]
        jobs = [(path, config, network, copy, part) for part in parts]
        varied = (
            in_order(_vary, jobs) if network is None or is_importable(network) else map(_vary, jobs)
        )
        # the suns take their place last: where they are, all is
        with atomic_path(place.with_suffix(".sun.npy")) as beside, atomic_path(place) as temporary:
            shape = (count, 3, HEIGHT, WIDTH)
            coded = np.lib.format.open_memmap(temporary, mode="w+", dtype=np.float16, shape=shape)
            suns = []
            for part, skies in zip(parts, varied, strict=True):
                coded[part] = skies.coded
                suns.append(skies.sun)
                tell(turn * count + part.stop, len(copies) * count)
            coded.flush()
            with beside.open("wb") as file:
                np.save(file, np.concatenate(suns))


def open_prepared(
    path: Path,
    config: AutoencoderConfig,
    out: Path,
    copy: int,
    network: type[SkyNetwork] | None = None,
) -> CodedSkies:
    """A copy that :func:`prepare` has written."""
    place = _place(path, config, out, copy, network)
    return CodedSkies(np.load(place.with_suffix(".sun.npy")), np.load(place, mmap_mode="r"))


def _place(
    path: Path,
    config: AutoencoderConfig,
    out: Path,
    copy: int,
    network: type[SkyNetwork] | None,
) -> Path:
    # by what the network makes of skies: a user may have changed its class since
    seen = coded_skies(_network(config, network), example_skies())
    code = hashlib.sha256(seen.sun.tobytes() + seen.coded.tobytes()).hexdigest()
    what = (path.stem, code, config.seed)
    how = (config.mirror, config.tint, config.surroundings, config.white_balance, copy)
    return out / f"{hashlib.sha256(repr((what, how)).encode()).hexdigest()[:16]}.npy"


def _vary(job: tuple[Path, AutoencoderConfig, type[SkyNetwork] | None, int, slice]) -> CodedSkies:
    path, config, network, copy, part = job
    generator = torch.Generator().manual_seed(
        (config.seed * 1_000_003 + copy) * 1_000_003 + part.start
    )
    skies = torch.from_numpy(np.load(path, mmap_mode="r")[part].copy())
    return coded_skies(_network(config, network), augment(skies, generator, config))


_network = cache(initial_network)


class Corruption(NamedTuple):
    """The encoder sees ``kept * (y + noise)`` for coded radiance y, and ``sun`` is added to the
    sun's coordinates and ``latents`` to the others; the loss compares with y itself."""

    noise: Float[Tensor, "b 3 h w"]
    kept: Float[Tensor, "b 1 h w"]
    sun: Float[Tensor, "b s"]
    latents: Float[Tensor, "b z"]

    @staticmethod
    def stack(parts: "Sequence[Corruption]") -> "Corruption":
        """Those of several skies as one batch."""
        return Corruption(*(torch.cat(each) for each in zip(*parts, strict=True)))

    def to(self, device: torch.device) -> "Corruption":
        return Corruption(*(part.to(device) for part in self))


def draw_corruption(
    count: int,
    layout: tuple[int, int],
    generator: torch.Generator,
    config: AutoencoderConfig,
) -> Corruption:
    """Gaussian noise of ``noise_sigma``, blocks hidden with probability ``masked``, noise of
    ``sun_noise`` on the sun's coordinates and of ``latent_noise`` on the other latents (Vincent et
    al. 2010: additive and masking noise)."""
    height, width = layout

    def normal(*shape: int) -> Tensor:
        return torch.randn(count, *shape, generator=generator)

    noise = normal(3, height, width) * config.noise_sigma
    rows, columns = height // BLOCK, width // BLOCK
    hidden = torch.rand(count, 1, rows, columns, generator=generator) < config.masked
    kept = (~hidden).float().repeat_interleave(BLOCK, 2).repeat_interleave(BLOCK, 3)
    return Corruption(
        noise=noise,
        kept=kept,
        sun=normal(COORDINATES) * config.sun_noise,
        latents=normal(config.latents - COORDINATES * config.sun) * config.latent_noise,
    )


def draw_batch(
    copies: Sequence[CodedSkies],
    config: AutoencoderConfig,
    epoch: int,
    within: int,
    share: slice,
) -> tuple[Float[Tensor, "b s"], Float[Tensor, "b 3 h w"], Corruption]:
    """Batch ``within`` of an epoch, of the copy whose turn it is, and its corruption.

    Both depend on seed, epoch and place alone. They are drawn for the whole batch, of which
    ``share`` is returned: several processes together see what one would have seen.
    """
    skies = copies[epoch % len(copies)]
    order = torch.Generator().manual_seed(config.seed * 1_000_003 + epoch)
    permutation = torch.randperm(len(skies), generator=order)
    chosen = permutation[within * config.batch : (within + 1) * config.batch]
    sun, coded = skies.batch(chosen[share].numpy())
    local = torch.Generator().manual_seed((config.seed * 1_000_003 + epoch) * 1_000_003 + within)
    height, width = coded.shape[2:]
    corruption = draw_corruption(len(chosen), (height, width), local, config)
    return sun, coded, Corruption(*(part[share] for part in corruption))


def in_order(work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
    """``work(job)`` of all jobs in their order, by as many processes as cores."""
    workers = min(cores(), len(jobs))
    if workers <= 1:
        yield from map(work, jobs)
        return
    # spawned, because a process that has run torch's threads cannot be forked safely
    with ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=torch.set_num_threads,
        initargs=(1,),
    ) as pool:
        try:
            yield from pool.map(work, jobs)
        except BrokenProcessPool as error:
            raise SkylightError(
                "a process that worked on skies died; where memory is short, let the same command "
                'run alone, and again; a script begins below: if __name__ == "__main__":'
            ) from error
