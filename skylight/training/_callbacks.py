"""What is told of a training run while it goes on: to loggers, TensorBoard's among them."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import UInt8
from torch import nn

from skylight.errors import InputError, not_installed
from skylight.training._config import AutoencoderConfig, DictionaryConfig
from skylight.work._progress import StageProgress, Tell, with_time_left

_LOSSES = ("train", "validation", "denoising")  # metrics that TensorBoard shows together


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run that begins, or goes on after ``step`` of its ``steps``."""

    config: AutoencoderConfig | DictionaryConfig
    module: nn.Module
    """What is trained: the network, or the bank of filters. It changes with every step."""
    step: int
    steps: int
    report: Tell
    """Says a line where the run says its own."""


@dataclass(frozen=True, kw_only=True)
class Epoch:
    """An epoch that has ended, the first of which is 1, after ``step`` steps of the run."""

    number: int
    step: int
    metrics: Mapping[str, float]
    """Of the autoencoder ``train``, ``validation`` and ``denoising``, which are losses,
    ``learning_rate`` and ``images_per_s``; of a dictionary ``mean_squared_error`` and ``used``."""
    picture: UInt8[np.ndarray, "h w 3"]
    """Validation skies over their reconstructions, or the filters of a dictionary."""


class Callback:
    """What a run tells: subclass it and say what to do. All its methods do nothing by themselves.

    They are called in the first process of several. What a method raises ends the run, as Ctrl-C
    does, and every callback that was started is closed. The same run then goes on from its last
    state, so that steps since then are told again; that of an epoch is on disk before ``on_epoch``.
    """

    def on_start(self, run: Run) -> None:
        """Before the first step; not for a run that has ended before."""

    def on_step(self, step: int, loss: float) -> None:
        """After each step, the first of which is 1, with the loss of its batch."""

    def on_epoch(self, epoch: Epoch) -> None:
        """After each epoch."""

    def close(self) -> None:
        """At the end, whatever it is; not where ``on_start`` has raised."""


class TensorBoard(Callback):
    """Metrics and pictures of every epoch for TensorBoard, in ``tensorboard`` of the run's folder.

    Where it is not installed, a line says so.
    """

    def __init__(self) -> None:
        self.writer: Any = None
        self.shown = ""

    def on_start(self, run: Run) -> None:
        is_dictionary = isinstance(run.config, DictionaryConfig)
        self.shown = "filters" if is_dictionary else "reconstructions"
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            run.report(f"no TensorBoard logs: {not_installed('tensorboard', 'writing them')}")
            return
        # what an interrupted run logged beyond its last state is hidden
        self.writer = SummaryWriter(str(run.config.out / "tensorboard"), purge_step=run.step + 1)

    def on_epoch(self, epoch: Epoch) -> None:
        if self.writer is None:
            return
        for name, value in epoch.metrics.items():
            tag = f"loss/{name}" if name in _LOSSES else name
            self.writer.add_scalar(tag, value, epoch.step)
        self.writer.add_image(self.shown, epoch.picture, epoch.step, dataformats="HWC")
        self.writer.flush()

    def close(self) -> None:
        if self.writer is not None:
            self.writer.close()


class Watch:
    """Those who are told of a run: its callbacks, and its progress."""

    def __init__(
        self, callbacks: Sequence[Callback], progress: StageProgress, closing: ExitStack
    ) -> None:
        self.callbacks, self.progress, self.closing = callbacks, progress, closing
        self.count, self.steps = with_time_left("step", progress), 0

    def start(self, run: Run) -> None:
        for each in self.callbacks:
            each.on_start(run)
            self.closing.callback(each.close)
        self.steps = run.steps
        self.count(run.step, run.steps)

    def step(self, step: int, loss: float) -> None:
        self.count(step, self.steps)
        for each in self.callbacks:
            each.on_step(step, loss)

    def epoch(self, epoch: Epoch) -> None:
        for each in self.callbacks:
            each.on_epoch(epoch)


@contextmanager
def watching(callbacks: Iterable[Any] | None, progress: StageProgress) -> Iterator[Watch]:
    """Callbacks, or TensorBoard's logger where none are given; closed at the end, whatever it is.

    Raises
    ------
    InputError
        What is no callback.
    """
    given = [TensorBoard()] if callbacks is None else list(callbacks)
    for each in given:
        if not isinstance(each, Callback):
            raise InputError(
                f"callbacks: {each!r} is no Callback; give objects of classes that are derived "
                "from skylight.training.Callback"
            )
    with ExitStack() as closing:
        yield Watch(given, progress, closing)
