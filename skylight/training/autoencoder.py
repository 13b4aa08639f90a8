"""Trains the sky autoencoder; a run that was killed goes on as if it had not been."""

import math
import pickle
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from safetensors.torch import save_file
from torch import Tensor

from skylight.errors import InputError
from skylight.imaging.files import atomic_path, write_json
from skylight.models.autoencoder import SkyAutoencoder
from skylight.skies.dataset import folder_hash, load_skies, read_index
from skylight.sphere.grid import DirectionGrid
from skylight.training.config import AutoencoderConfig, config_yaml


@dataclass(frozen=True, kw_only=True)
class SkyData:
    """Training and validation skies (n,h,w,3), and the hash that names the data."""

    train: Float[Tensor, "n h w 3"]
    validation: Float[Tensor, "m h w 3"]
    hash: str


def load_data(folder: Path) -> SkyData:
    """The training and validation days of an index, cached as one file beside it."""
    records = read_index(folder)
    digest = folder_hash(folder, records)
    cache = folder / ".cache" / f"{digest[:16]}.pt"
    if not cache.exists():
        cache.parent.mkdir(exist_ok=True)
        parts = {
            split: load_skies(folder, [r for r in records if r.split == split])
            for split in ("train", "validation")
            if any(r.split == split for r in records)
        }
        with atomic_path(cache) as temporary:
            torch.save(parts, temporary)
    parts = torch.load(cache, weights_only=True)
    if len(parts) < 2:
        raise InputError(
            f"{folder}: too few days: training and validation split by day, and one is empty"
        )
    return SkyData(train=parts["train"], validation=parts["validation"], hash=digest)


def reconstruction_loss(
    network: SkyAutoencoder,
    clean: Float[Tensor, "b h w 3"],
    coded_input: Float[Tensor, "b 3 h w"],
    energy_weight: float,
) -> Float[Tensor, " b"]:
    """sum_w dw (1 + g max(L, L')) |y' - y| / 2 pi per sky, the mean of the channels.

    The thesis' solid-angle-weighted L1, on coded radiance y, plus ``energy_weight`` g times the
    same weighted by the energy of the pixel as well (of truth or reconstruction, whichever is
    larger, taken as a constant): about L1 of radiance where both agree, but its slope does not
    vanish where a sun of a thousand times the sky's radiance is missing altogether.
    """
    coded = network.decode_coded(network.encode_coded(coded_input)).float()
    error = (coded - network.code(clean)).abs()
    larger = torch.maximum(clean, network.uncode(coded).detach()).permute(0, 3, 1, 2)
    height, width = error.shape[-2:]
    row = DirectionGrid.latlong(height, width).solid_angles.reshape(height, width)[:, :1]
    weight = row.to(error) * (1 + energy_weight * larger)
    return (weight * error).sum((-1, -2)).mean(1) / (2 * math.pi)


def train(config: AutoencoderConfig, report: Callable[[str], None] = print) -> Path:
    """Run to the end or to early stopping; returns the path of the best network.

    Writes ``model.safetensors`` (best on validation), ``config.yaml`` (resolved),
    ``curves.json`` and ``state.pt`` (everything needed to go on). The order of the skies, the
    noise and the mirroring of step n depend on the seed and n alone, so a resumed run
    computes what the uninterrupted one would have, bit by bit on the same machine.
    """
    if config.threads:
        torch.set_num_threads(config.threads)
    device = torch.device(config.device)
    data = load_data(config.data)
    config.out.mkdir(parents=True, exist_ok=True)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)  # initial weights
        network = SkyAutoencoder(config.coding)
    # torch's stubs leave memory_format out
    network = network.to(device, memory_format=torch.channels_last)  # pyright: ignore
    optimiser = torch.optim.SGD(
        network.parameters(),
        lr=config.learning_rate,
        momentum=config.momentum,
        nesterov=True,
        weight_decay=config.weight_decay,
    )
    steps_per_epoch = len(data.train) // config.batch
    if steps_per_epoch < 1:
        raise InputError(
            f"{config.data}: {len(data.train)} training skies do not fill a batch of "
            f"{config.batch}; simulate more days or lower `batch`"
        )
    total = steps_per_epoch * config.epochs
    best, since_best, step = math.inf, 0, 0
    curves: list[dict[str, float]] = []
    losses: list[float] = []
    state_path = config.out / "state.pt"
    # what changes no step may differ when a run goes on, the folders' names included
    anywhere = replace(config, data=Path(), out=Path(), checkpoint_steps=1, threads=0, device="cpu")
    identity = f"{data.hash}\n{config_yaml(anywhere)}"
    if state_path.exists():
        state = _read_state(state_path, identity)
        network.load_state_dict(state["network"])
        optimiser.load_state_dict(state["optimiser"])
        best, since_best, step, curves, losses = (
            state[k] for k in ("best", "since_best", "step", "curves", "losses")
        )
        report(f"resuming at step {step} of {total}")
    with atomic_path(config.out / "config.yaml") as path:
        path.write_text(config_yaml(config))

    started, first_step = time.monotonic(), step
    while step < total and since_best < config.patience:
        epoch, within = divmod(step, steps_per_epoch)
        batch, noise = _batch(data.train, config, epoch, within)
        for group in optimiser.param_groups:
            group["lr"] = config.learning_rate * _schedule(step, total, config.warmup_steps)
        network.train()
        clean = batch.to(device)
        coded = network.code(clean) + noise.to(device)
        with torch.autocast(device.type, torch.bfloat16, enabled=config.bfloat16):
            coded = coded.contiguous(memory_format=torch.channels_last)
            loss = reconstruction_loss(network, clean, coded, config.energy_weight).mean()
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), config.gradient_clip)
        optimiser.step()
        losses.append(float(loss.detach()))
        step += 1
        if step % steps_per_epoch == 0:
            score = validate(network, data.validation, config)
            if not math.isfinite(score):
                raise InputError(
                    f"training diverged in epoch {epoch + 1} (validation loss {score}): lower "
                    f"`learning_rate` and start anew without {state_path}"
                )
            curves.append({"step": step, "train": sum(losses) / len(losses), "validation": score})
            losses = []
            since_best = 0 if score < best else since_best + 1
            if score < best:
                best = score
                save_network(network, config.out / "model.safetensors")
            write_json(
                config.out / "curves.json",
                {"data_sha256": data.hash, "skies": len(data.train), "curves": curves},
            )
            rate = (time.monotonic() - started) * steps_per_epoch / (step - first_step)
            report(
                f"epoch {epoch + 1}/{config.epochs}  train {curves[-1]['train']:.4f}  "
                f"validation {score:.4f}  best {best:.4f}  {rate:.0f} s an epoch"
            )
        if step % config.checkpoint_steps == 0 or step % steps_per_epoch == 0:
            with atomic_path(state_path) as path:
                torch.save(
                    {
                        "identity": identity,
                        "network": network.state_dict(),
                        "optimiser": optimiser.state_dict(),
                        "best": best,
                        "since_best": since_best,
                        "step": step,
                        "curves": curves,
                        "losses": losses,
                    },
                    path,
                )
    return config.out / "model.safetensors"


@torch.no_grad()
def validate(
    network: SkyAutoencoder, skies: Float[Tensor, "n h w 3"], config: AutoencoderConfig
) -> float:
    """Mean loss over clean validation skies."""
    network.eval()
    device = torch.device(config.device)
    total = 0.0
    for part in skies.split(config.batch):
        clean = part.to(device)
        loss = reconstruction_loss(network, clean, network.code(clean), config.energy_weight)
        total += float(loss.sum())
    return total / len(skies)


def save_network(network: SkyAutoencoder, path: Path) -> None:
    state = {k: v.detach().cpu().contiguous() for k, v in network.state_dict().items()}
    if network.coding == "linear":
        state["coding_linear"] = torch.ones(1)
    with atomic_path(path) as temporary:
        save_file(state, temporary)


def _batch(
    skies: Float[Tensor, "n h w 3"], config: AutoencoderConfig, epoch: int, within: int
) -> tuple[Float[Tensor, "b h w 3"], Float[Tensor, "b 3 h w"]]:
    """Batch ``within`` of an epoch, with its noise: functions of seed, epoch and place alone."""
    order = torch.Generator().manual_seed(config.seed * 1_000_003 + epoch)
    permutation = torch.randperm(len(skies), generator=order)
    chosen = permutation[within * config.batch : (within + 1) * config.batch]
    batch = skies[chosen]
    local = torch.Generator().manual_seed((config.seed * 1_000_003 + epoch) * 1_000_003 + within)
    if config.mirror:
        # about the middle of column w/2, where the sun is: column c becomes w - c
        flipped = torch.roll(batch.flip(2), 1, dims=2)
        keep = torch.rand(len(batch), generator=local) < 0.5
        batch = torch.where(keep[:, None, None, None], batch, flipped)
    height, width = batch.shape[1:3]
    noise = torch.randn(len(batch), 3, height, width, generator=local) * config.noise_sigma
    return batch, noise


def _schedule(step: int, total: int, warmup: int) -> float:
    """Linear warm-up, then half a cosine down to 1 %."""
    if step < warmup:
        return (step + 1) / warmup
    return 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * (step - warmup) / max(1, total - warmup)))


def _read_state(path: Path, identity: str) -> dict:
    try:
        state = torch.load(path, weights_only=True)
        same_run = state["identity"] == identity
    except (
        *(RuntimeError, OSError, EOFError, ValueError),
        *(pickle.UnpicklingError, KeyError, TypeError, IndexError),
    ) as error:
        raise InputError(
            f"{path}: the run's state is damaged ({type(error).__name__}); "
            "delete it to start the run anew"
        ) from error
    if not same_run:
        raise InputError(
            f"{path}: belongs to a run with other data or another configuration; "
            "choose another `out`, or delete it to start anew"
        )
    return state
