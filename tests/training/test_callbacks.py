"""Callbacks of training runs: what they are told, and what happens when they fail."""

import csv
import json
import runpy
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.skies._index import read_index
from skylight.training._autoencoder import train
from skylight.training._callbacks import Callback, Epoch, Run, TensorBoard, watching
from skylight.training._config import AutoencoderConfig, DictionaryConfig

EXAMPLE = Path(__file__).parents[2] / "examples" / "training_logger.py"
PICTURE = np.random.default_rng(0).integers(0, 255, (8, 16, 3), dtype=np.uint8)


class Recorder(Callback):
    """Writes all down, and raises what it is given at one of its methods."""

    def __init__(self, at: str = "", error: BaseException | None = None) -> None:
        self.told: list[tuple] = []
        self.at, self.error = at, error

    def add(self, name: str, *what: object) -> None:
        self.told.append((name, *what))
        if name == self.at and self.error is not None:
            raise self.error

    def on_start(self, run: Run) -> None:
        self.add("start", run.step, run.steps)

    def on_step(self, step: int, loss: float) -> None:
        self.add("step", step, loss)

    def on_epoch(self, epoch: Epoch) -> None:
        self.add("epoch", epoch.number, epoch.step, dict(epoch.metrics), epoch.picture.shape)

    def close(self) -> None:
        self.add("close")


@pytest.fixture(scope="module")
def config(sky_folder: Path) -> AutoencoderConfig:
    """Two epochs of two steps."""
    skies = sum(record.split == "train" for record in read_index(sky_folder))
    return AutoencoderConfig(data=sky_folder, epochs=2, batch=skies // 2, bfloat16=False, latents=8)


@pytest.fixture(scope="module")
def whole(
    config: AutoencoderConfig, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Recorder, list[tuple[str, float]]]:
    out, recorder, shown = tmp_path_factory.mktemp("whole"), Recorder(), []

    def progress(stage: str, share: float) -> None:
        shown.append((stage, share))

    train(
        replace(config, out=out),
        lambda _: None,
        callbacks=[recorder, Callback()],
        progress=progress,
    )
    return out, recorder, shown


def curves(out: Path) -> list[dict[str, float]]:
    return json.loads((out / "curves.json").read_text())["curves"]


def test_steps_and_epochs_are_told_in_their_order(
    whole: tuple[Path, Recorder, list[tuple[str, float]]],
) -> None:
    out, recorder, _ = whole
    told = recorder.told
    assert [each[0] for each in told] == ["start", *["step", "step", "epoch"] * 2, "close"]
    assert told[0] == ("start", 0, 4)
    losses = {each[1]: each[2] for each in told if each[0] == "step"}
    assert list(losses) == [1, 2, 3, 4]
    for (_, number, step, metrics, shape), entry in zip(
        [each for each in told if each[0] == "epoch"], curves(out), strict=True
    ):
        assert {"step": step, **metrics} == entry
        assert metrics["train"] == (losses[step - 1] + losses[step]) / 2
        assert step == 2 * number
        assert shape[0] == 64
    assert not (out / "tensorboard").exists()  # which stands where none are given


def test_every_stage_shows_its_progress(
    whole: tuple[Path, Recorder, list[tuple[str, float]]],
) -> None:
    stages = [(stage.split(" of ")[0].rstrip("0123456789 "), share) for stage, share in whole[2]]
    assert stages[-5:] == [("step", step / 4) for step in range(5)]
    assert ("preparing sky", 1.0) in stages


@pytest.mark.parametrize(
    ("at", "error"), [("step", ValueError("a logger's own")), ("epoch", KeyboardInterrupt())]
)
def test_a_run_goes_on_after_what_a_callback_raised(
    at: str,
    error: BaseException,
    config: AutoencoderConfig,
    whole: tuple[Path, Recorder, list[tuple[str, float]]],
    tmp_path: Path,
) -> None:
    """All are closed, and the end is that of a run without any."""
    first, failing, last = Recorder(), Recorder(at, error), Recorder()
    config = replace(config, out=tmp_path)
    with pytest.raises(type(error)) as caught:
        train(config, lambda _: None, callbacks=[first, failing, last])
    assert caught.value is error
    assert [each.told[-1] for each in (first, failing, last)] == [("close",)] * 3
    assert not any(each[0] == at for each in last.told)
    again = Recorder()
    train(config, lambda _: None, callbacks=[again])
    assert again.told[0] == ("start", 0 if at == "step" else 2, 4)
    name = "model.safetensors"
    assert (tmp_path / name).read_bytes() == (whole[0] / name).read_bytes()
    finished = Recorder()
    train(config, lambda _: None, callbacks=[finished])
    assert finished.told == []


def test_only_what_was_started_is_closed() -> None:
    first, failing, last = Recorder(), Recorder("start", OSError("no room")), Recorder()
    run = Run(config=AutoencoderConfig(), module=torch.nn.Identity(), step=0, steps=1, report=print)
    with (
        pytest.raises(OSError, match="no room"),
        watching([first, failing, last], lambda *_: None) as watch,
    ):
        watch.start(run)
    assert [len(each.told) for each in (first, failing, last)] == [2, 1, 0]
    assert first.told[-1] == ("close",)


@pytest.mark.parametrize("wrong", [Recorder, "tensorboard", print])
def test_what_is_no_callback_is_refused(wrong: object) -> None:
    with pytest.raises(InputError, match="no Callback"), watching([wrong], lambda *_: None):
        pass


def told_to(
    board: TensorBoard, config: AutoencoderConfig | DictionaryConfig, step: int = 0
) -> list[str]:
    """Two epochs of four steps, the first after ``step``; what was reported."""
    said: list[str] = []
    module = torch.nn.Identity()
    board.on_start(Run(config=config, module=module, step=step, steps=8, report=said.append))
    for number in (1, 2):
        names = ("train", "validation", "denoising", "learning_rate", "images_per_s")
        metrics = {name: number + i / 8 for i, name in enumerate(names)}
        step += 4
        board.on_epoch(Epoch(number=number, step=step, metrics=metrics, picture=PICTURE))
    board.close()
    return said


def test_tensorboard_has_metrics_and_pictures(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    assert told_to(TensorBoard(), AutoencoderConfig(out=tmp_path)) == []
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    tags = ["loss/train", "loss/validation", "loss/denoising", "learning_rate", "images_per_s"]
    for i, tag in enumerate(tags):
        values = [(e.step, e.value) for e in events.Scalars(tag)]
        assert values == [(4, 1 + i / 8), (8, 2 + i / 8)]
    assert [i.step for i in events.Images("reconstructions")] == [4, 8]
    told_to(TensorBoard(), DictionaryConfig(out=tmp_path / "filters"))
    events = EventAccumulator(str(tmp_path / "filters" / "tensorboard")).Reload()
    assert events.Tags()["images"] == ["filters"]


def test_without_tensorboard_a_line_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    (line,) = told_to(TensorBoard(), AutoencoderConfig(out=tmp_path))
    assert "no TensorBoard logs" in line
    assert not (tmp_path / "tensorboard").exists()


def test_the_example_logs_every_step(
    sky_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(EXAMPLE.read_text().splitlines()) <= 40
    monkeypatch.setattr("sys.argv", [str(EXAMPLE), str(sky_folder), str(tmp_path)])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    with (tmp_path / "log.csv").open() as file:
        rows = list(csv.reader(file))
    losses = [float(loss) for _, name, loss in rows if name == "step"]
    found = [float(value) for _, name, value in rows if name == "validation"]
    (entry,) = curves(tmp_path)
    assert len(losses) == entry["step"] > 1
    assert entry["train"] == pytest.approx(np.mean(losses))
    assert found == [entry["validation"]]
    assert (tmp_path / "tensorboard").exists()
