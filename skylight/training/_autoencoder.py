"""Training of the sky autoencoder: the loop, its loss, validation and schedule.

An interrupted run is resumed bit for bit: what a step draws depends on the seed and its number.
"""

import math
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from skylight.errors import InputError
from skylight.io._atomic import atomic_path
from skylight.models._bundle import save_network
from skylight.models._network import SkyNetwork
from skylight.models._network_check import check_network, example_skies
from skylight.models._network_names import is_builtin, network_class, network_name
from skylight.models._sun_head import COORDINATES
from skylight.sphere._frame import DirectionGrid
from skylight.training._callbacks import Callback, Epoch, Run, Watch, watching
from skylight.training._checkpoint import (
    Network,
    drop_damaged,
    initial_network,
    read_state,
    reconstructions,
    sha256_of,
    spread,
    write_epoch,
    write_state,
)
from skylight.training._config import AutoencoderConfig, config_yaml
from skylight.training._processes import Processes, processes, share_batch_statistics
from skylight.training._skies import (
    FOLDER,
    CodedSkies,
    Corruption,
    SkyData,
    draw_batch,
    draw_corruption,
    load_data,
    open_cache,
    open_prepared,
    prepare,
)
from skylight.work._progress import StageProgress, Tell, silent
from skylight.work._threads import use_all_cores

# (network, sun, truth, config, corruption) -> (b,)
Loss = Callable[
    [
        SkyNetwork,
        Float[Tensor, "b s"],
        Float[Tensor, "b 3 h w"],
        AutoencoderConfig,
        Corruption | None,
    ],
    Float[Tensor, " b"],
]


@dataclass(kw_only=True)
class RunState:
    """Where a run stands, beside its weights; ``losses`` are those of the epoch so far."""

    step: int = 0
    epochs: int = 0  # to be done in all
    best: float = math.inf
    since_best: int = 0
    curves: list[dict[str, int | float]] = field(default_factory=list)
    losses: list[float] = field(default_factory=list)

    def end_epoch(self, **numbers: float) -> bool:
        """Add the epoch's entry to the curves; whether its validation loss is the best so far."""
        train = sum(self.losses) / len(self.losses)
        self.curves.append({"step": self.step, "train": train, **numbers})
        self.losses = []
        is_best = numbers["validation"] < self.best
        self.best = min(self.best, numbers["validation"])
        self.since_best = 0 if is_best else self.since_best + 1
        return is_best


def train(
    config: AutoencoderConfig,
    report: Tell = print,
    *,
    callbacks: Sequence[Callback] | None = None,
    progress: StageProgress = silent,
    network: Network | str | None = None,
    loss: Loss | None = None,
) -> Path:
    """Run to the end or to early stopping; returns the path of the best network.

    Writes ``model.safetensors`` (best on validation), ``config.yaml`` (resolved), ``curves.json``
    and ``reconstructions/*.png`` (of every epoch), and ``state.safetensors`` (everything needed to
    go on; the one before it in ``state.previous.safetensors``). The order of the skies, the noise
    and the augmentation of step n depend on the seed and n alone, so a resumed run computes what
    the uninterrupted one would have, bit by bit on the same machine; started by ``torchrun`` with
    several processes, what one process would have, but for rounding.

    A run with more ``epochs`` than before goes on too, also where it had ended. Its learning rate
    is from then on that of the new number: with a cosine it rises again, and the result is not that
    of a run that had them from the start. With a constant one it is, if the warm-up is at most a
    tenth of the shorter run.

    ``callbacks`` are told of steps and epochs; :class:`TensorBoard` alone if none are given.

    ``network`` is a class of yours (:class:`~skylight.models._network.SkyNetwork`), its name, or a
    network that it has made, in place of ``config.network``; ``loss`` takes the place
    of :func:`reconstruction_loss`: ``loss(network, sun, truth, config, corruption)`` is that of
    each sky, (b,), with None for the corruption of clean validation skies. What they draw of
    torch's generators is seeded for each step.

    Raises
    ------
    InputError
        Data, configuration or state that cannot be used, a loss that is no number, or a network
        or loss that does not do what these ask of it.
    """
    if isinstance(network, str):
        config, network = replace(config, network=network), None
    if network is not None:
        kind = network_class(network if isinstance(network, type) else type(network))
        config = replace(config, network=network_name(kind))
    with processes(config.device) as here:
        on = [here.device] if here.device.type == "cuda" else []
        if not here.first:
            callbacks, report, progress = [], lambda _: None, silent
        with torch.random.fork_rng(devices=on), watching(callbacks, progress) as watch:
            return _train(config, here, report, watch, network, loss)


def _train(
    config: AutoencoderConfig,
    here: Processes,
    report: Tell,
    watch: Watch,
    given: Network | None,
    own_loss: Loss | None,
) -> Path:
    own_loss = None if own_loss is reconstruction_loss else own_loss
    loss_of = own_loss or reconstruction_loss
    # network: new, or as it is given
    network = initial_network(config, given)
    if not is_builtin(config.network):
        check_network(network)
    if own_loss is not None:
        _check_loss(network, config, own_loss)
    share = here.share(config.batch)
    if config.threads:
        torch.set_num_threads(config.threads)
    else:
        use_all_cores()
    data = _load(config, here, report, watch.progress)
    config.out.mkdir(parents=True, exist_ok=True)
    steps_per_epoch = len(data.train) // config.batch
    if steps_per_epoch < 1:
        raise InputError(
            f"{config.data}: {len(data.train)} training skies do not fill a batch of "
            f"{config.batch}; simulate more days or lower `batch`"
        )
    total = steps_per_epoch * config.epochs

    # network and optimiser: as they begin, or where an earlier run left them
    if here.size > 1:
        share_batch_statistics(network)
    network = network.to(here.device)
    if config.network == "convolutions":  # torch's stubs leave memory_format out
        network = network.to(memory_format=torch.channels_last)  # pyright: ignore
    here.share_weights(network)
    optimiser = _optimiser(network, config)
    now = RunState()
    identity = run_identity(config, data.hash, own_loss)
    if state := read_state(config.out, identity, report):
        network.load_state_dict(state["network"])
        optimiser.load_state_dict(state["optimiser"])
        now = RunState(**state["progress"])
        if now.step <= total:
            report(f"resuming at step {now.step} of {total}")
        if change := _other_epochs(now, steps_per_epoch, config):
            report(change)
    now.epochs = config.epochs
    best = config.out / "model.safetensors"
    if now.step >= total or now.since_best >= config.patience:
        _tell_early_end(now, total, report)
        if here.first:
            shutil.rmtree(config.out / FOLDER, ignore_errors=True)
        return best

    copies, validation = _prepared(config, data, here, watch.progress, type(network))
    here.meet()  # the first writes the state that the others have read by now
    facts = {"data_sha256": data.hash, "skies": len(data.train), "processes": here.size}
    shown = spread(data.validation)
    if here.first:
        drop_damaged(config.out)
        with atomic_path(config.out / "config.yaml") as path:
            path.write_text(config_yaml(config))
    objective = Objective(network, config, loss_of)
    if config.compile:
        objective = torch.compile(objective)

    watch.start(Run(config=config, module=network, step=now.step, steps=total, report=report))
    started, first_step = time.monotonic(), now.step
    while now.step < total and now.since_best < config.patience:
        epoch, within = divmod(now.step, steps_per_epoch)
        rate = config.learning_rate * schedule(now.step, total, config)
        for group in optimiser.param_groups:
            group["lr"] = rate

        # a step
        batch = draw_batch(copies, config, epoch, within, share)
        network.train()
        torch.manual_seed((config.seed * 1_000_003 + now.step) * 1_000_003 + here.rank)
        loss = objective(*(x.to(here.device) for x in batch))
        optimiser.zero_grad()
        loss.backward()
        here.mean_gradients(network)
        if config.gradient_clip:
            torch.nn.utils.clip_grad_norm_(network.parameters(), config.gradient_clip)
        optimiser.step()
        mean_loss = float(here.sum(loss.detach())) / here.size
        now.losses.append(mean_loss)
        now.step += 1

        # after the last step of an epoch: its losses, and its network where it is the best
        epoch_ends, picture = now.step % steps_per_epoch == 0, None
        if epoch_ends:
            speed = (now.step - first_step) * config.batch / (time.monotonic() - started)
            score = validate(network, validation, config, here, loss_of)
            if not math.isfinite(score):
                raise InputError(
                    f"training diverged in epoch {epoch + 1} (validation loss {score}): lower "
                    f"`learning_rate` and start anew in another `out`"
                )
            is_best = now.end_epoch(
                validation=score,
                denoising=validate(network, validation, config, here, loss_of, corrupted=True),
                learning_rate=rate,
                images_per_s=speed,
            )
            if is_best and here.first:
                save_network(network, best)
            if here.first:
                picture = reconstructions(network, shown)
                write_epoch(config.out, facts, now.curves, picture)
                report(_epoch_line(now))
            started, first_step = time.monotonic(), now.step
        if here.first and (epoch_ends or now.step % config.checkpoint_steps == 0):
            weights = {"network": network.state_dict(), "optimiser": optimiser.state_dict()}
            write_state(config.out, {"identity": identity, "progress": asdict(now), **weights})
        watch.step(now.step, mean_loss)
        if picture is not None:  # in the first process, of an epoch that has ended
            metrics = {name: value for name, value in now.curves[-1].items() if name != "step"}
            watch.epoch(Epoch(number=epoch + 1, step=now.step, metrics=metrics, picture=picture))
    _tell_early_end(now, total, report)
    if here.first:
        shutil.rmtree(config.out / FOLDER)
    return best


def _epoch_line(now: RunState) -> str:
    last = now.curves[-1]
    return (
        f"epoch {len(now.curves)}  train {last['train']:.4f}  validation {last['validation']:.4f}  "
        f"corrupted {last['denoising']:.4f}  best {now.best:.4f}  "
        f"{last['images_per_s']:.0f} images/s"
    )


def _other_epochs(now: RunState, steps_per_epoch: int, config: AutoencoderConfig) -> str:
    """What another number of epochs does to a run that goes on; nothing where it is the same."""
    changed = f"`epochs` was {now.epochs} and is {config.epochs}"
    if now.epochs == config.epochs:
        return ""
    if now.step >= steps_per_epoch * config.epochs:
        done = now.step // steps_per_epoch
        return f"{changed}: {done} are done already, and none is taken back"
    before, after = (
        config.learning_rate * schedule(now.step, steps_per_epoch * epochs, config)
        for epochs in (now.epochs, config.epochs)
    )
    return f"{changed}: the learning rate is {after:.3g} here, {before:.3g} before"


def _tell_early_end(now: RunState, total: int, report: Tell) -> None:
    if now.step < total:
        report(
            f"ended early: no better validation loss for {now.since_best} epochs; a higher "
            "`patience` goes on"
        )


class Objective(nn.Module):
    """The mean loss of a batch, as one module: what is compiled."""

    def __init__(
        self, network: SkyNetwork, config: AutoencoderConfig, loss: Loss | None = None
    ) -> None:
        super().__init__()
        self.network, self.config = network, config
        self.loss = loss or reconstruction_loss

    def forward(
        self, sun: Float[Tensor, "b s"], coded: Float[Tensor, "b 3 h w"], corruption: Corruption
    ) -> Float[Tensor, ""]:
        mixed = self.config.bfloat16 and has_bfloat16(coded.device)
        with torch.autocast(coded.device.type, torch.bfloat16, enabled=mixed):
            return self.loss(self.network, sun, coded, self.config, corruption).mean()


def reconstruction_loss(
    network: SkyNetwork,
    sun: Float[Tensor, "b s"],
    truth: Float[Tensor, "b 3 h w"],
    config: AutoencoderConfig,
    corruption: Corruption | None = None,
) -> Float[Tensor, " b"]:
    """The loss of each sky, of coordinates ``sun`` (none without a sun head) and coded rest y::

        mean of (1 + g max(L, L')) |d| + q d^2, plus s (mean of d^2 - (mean of d)^2)
        plus p mean of z^2,    d = y' - y

    The first means are over solid angle and channels. They hold the thesis' solid-angle-weighted
    L1, on coded radiance, plus ``energy_weight`` g times the same weighted by the energy of the
    pixel as well (of truth or reconstruction, whichever is larger, taken as a constant): about L1
    of radiance where both agree, but its slope does not vanish where a sun of a thousand times
    the sky's radiance is missing altogether. ``squared_weight`` q counts large errors, as clouds'
    edges are, more than L1 does, which is content with a median. ``scale_invariant`` s forgives a
    wrong exposure (Gardner et al. 2023, RENI++). ``latent_penalty`` p keeps the latents z (but
    the sun's) near 0, so that a ``corruption`` of given size has a meaning.

    The network encodes y, or what the ``corruption`` makes of it, and decodes its own latents or
    those.
    """
    seen = truth
    if corruption is not None:
        seen = corruption.kept * (truth + corruption.noise)
        sun = sun + corruption.sun[:, : sun.shape[1]]
    z = network.encode_coded(sun, seen)
    own = z[:, : network.latents - COORDINATES * network.sun]
    penalty = own.float().square().mean(1)
    if corruption is not None:
        z = torch.cat([own + corruption.latents, z[:, own.shape[1] :]], 1)
    coded = network.decode_coded(z).float()
    error = coded - truth
    energy = torch.maximum(_radiance(network, truth), _radiance(network, coded.detach()))
    height, width = error.shape[-2:]
    row = DirectionGrid.latlong(height, width).solid_angles.reshape(height, width)[:, :1]
    share = row.to(error) / (3 * 2 * math.pi)
    each = (1 + config.energy_weight * energy) * error.abs()
    if config.squared_weight:
        each = each + config.squared_weight * error.square()
    loss = (share * each).sum((1, 2, 3))
    if config.scale_invariant:
        mean = (share * error).sum((1, 2, 3))
        spread = (share * error.square()).sum((1, 2, 3)) - mean.square()
        loss = loss + config.scale_invariant * spread
    return loss + config.latent_penalty * penalty


def _check_loss(network: SkyNetwork, config: AutoencoderConfig, loss: Loss) -> None:
    """:class:`InputError` unless a user's loss gives a number for each of two skies."""
    sun, rest = network.split(example_skies())
    network.eval()  # so that no statistics change
    try:
        found = loss(network, sun, network.code(rest), config, None)
    except Exception as error:
        first = str(error).partition("\n")[0]
        raise InputError(f"the loss fails ({type(error).__name__}: {first})") from error
    if not isinstance(found, Tensor) or found.shape != (len(rest),):
        got = tuple(found.shape) if isinstance(found, Tensor) else type(found).__name__
        raise InputError(f"the loss must give one number for each sky, (b,), got {got} for b = 2")
    if not found.requires_grad:
        raise InputError("the loss has no gradient in the network's parameters")


def _radiance(network: SkyNetwork, coded: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
    return network.uncode(coded).permute(0, 3, 1, 2)


@torch.no_grad()
def validate(
    network: SkyNetwork,
    skies: CodedSkies,
    config: AutoencoderConfig,
    here: Processes,
    loss_of: Loss = reconstruction_loss,
    *,
    corrupted: bool = False,
) -> float:
    """Mean loss over the validation skies, of which each process takes its part.

    The network sees them clean or, ``corrupted``, as training does: always by the same noise.
    """
    network.eval()
    total = torch.zeros((), dtype=torch.float64, device=here.device)
    mine = range(here.rank, len(skies), here.size)
    for start in range(0, len(mine), config.batch):
        chosen = np.array(mine[start : start + config.batch])
        sun, coded = skies.batch(chosen)
        corruption = None
        if corrupted:
            height, width = coded.shape[2:]
            corruption = Corruption.stack(
                [
                    draw_corruption(1, (height, width), torch.Generator().manual_seed(n), config)
                    for n in chosen.tolist()
                ]
            ).to(here.device)
        sun, coded = sun.to(here.device), coded.to(here.device)
        loss = loss_of(network, sun, coded, config, corruption)
        total += loss.double().sum()
    return float(here.sum(total)) / len(skies)


def _optimiser(network: SkyNetwork, config: AutoencoderConfig) -> torch.optim.Optimizer:
    rate, decay = config.learning_rate, config.weight_decay
    if config.optimiser == "adamw":
        return torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=decay, fused=True)
    return torch.optim.SGD(
        network.parameters(),
        lr=rate,
        weight_decay=decay,
        momentum=config.momentum,
        nesterov=config.nesterov,
    )


def schedule(step: int, total: int, config: AutoencoderConfig) -> float:
    """The learning rate of a step as a part of its height.

    A linear warm-up of at most a tenth of all steps, then half a cosine down to 1 % or constant.
    """
    warmup = min(config.warmup_steps, total // 10)
    if step < warmup:
        return (step + 1) / warmup
    if config.schedule == "constant":
        return 1.0
    return 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * (step - warmup) / max(1, total - warmup)))


def has_bfloat16(device: torch.device) -> bool:
    """Whether bfloat16 is no slower there than float32: without AVX-512, CPUs take 100 times as
    long for its convolutions."""
    return device.type != "cpu" or torch.backends.cpu.get_cpu_capability().startswith("AVX512")


def _load(
    config: AutoencoderConfig, here: Processes, report: Tell, progress: StageProgress
) -> SkyData:
    """The data, read and checked by the first process, then opened by the others."""
    if not here.first:
        return open_cache(config.data, here.from_first())
    data = load_data(config.data, report, progress)
    here.from_first(data.hash)
    return data


def _prepared(
    config: AutoencoderConfig,
    data: SkyData,
    here: Processes,
    progress: StageProgress,
    network: type[SkyNetwork],
) -> tuple[list[CodedSkies], CodedSkies]:
    """(the copies of the training skies, the validation skies), made by the first process."""
    folder, copies = config.out / FOLDER, range(config.copies)
    if here.first:
        prepare(data.paths["train"], config, folder, copies, progress, network)
        prepare(data.paths["validation"], config, folder, [0], progress, network)
    here.meet()
    train = [open_prepared(data.paths["train"], config, folder, copy, network) for copy in copies]
    return train, open_prepared(data.paths["validation"], config, folder, 0, network)


def run_identity(
    config: AutoencoderConfig, data_hash: str, loss: Loss | None = None
) -> dict[str, Any]:
    """What a run must have in common with the one that it goes on from.

    What changes no step may differ, the folders' names included, and when it ends; the data and the
    checkpoint that it starts from count by their content, a user's loss by its name.
    """
    free = ("out", "checkpoint_steps", "threads", "device", "compile", "epochs", "patience")
    start = config.starts_from
    facts = {name: value for name, value in asdict(config).items() if name not in free}
    return facts | {
        "data": f"SHA-256 {data_hash[:16]}",
        "starts_from": sha256_of(start) if start else None,
        "loss": loss and getattr(loss, "__qualname__", type(loss).__name__),
    }
