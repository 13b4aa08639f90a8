"""From a folder of EXR skies to a light model, and the command line of train.py."""

import re
import runpy
import shutil
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.io._hdr import write_exr
from skylight.models._bundle import NETWORK, SHIPPED, load_bundle
from skylight.models.autoencoder import AutoencoderLight
from skylight.training import _autoencoder as autoencoder, _run as folder
from skylight.training._config import (
    AutoencoderConfig,
    Config,
    DictionaryConfig,
    PlacesConfig,
    PriorConfig,
    find_config,
    read_config,
)
from skylight.training._overrides import _meanings, read_overrides, without_dashes
from skylight.training._run import fitting, main, train_folder
from tests.drawn_skies import draw_skies

COUNT = 20


@pytest.fixture(scope="session")
def exr_skies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Skies of 20 days, with a sun or overcast, and a room."""
    out = tmp_path_factory.mktemp("exr_skies")
    draw_skies(out, COUNT)
    room = np.ones((96, 192, 3), np.float32) * [1.0, 0.9, 0.5]
    write_exr(out / "room.exr", room.astype(np.float32), half=False, header={})
    return out


def config(**changes: object) -> AutoencoderConfig:
    settings = {"batch": 16, "epochs": 1, "device": "cpu", "bfloat16": False}
    return AutoencoderConfig(**{**settings, **changes})  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def model(exr_skies: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    said: list[str] = []
    out = tmp_path_factory.mktemp("models") / "mine"
    train_folder(exr_skies, out, config(), {"epochs": 1}, report=said.append)
    return out, said


def test_twenty_skies_make_a_model(model: tuple[Path, list[str]], exr_skies: Path) -> None:
    out, said = model
    bundle = load_bundle(out)
    assert bundle.name == "mine"
    assert bundle.skies == 16
    assert any(line.startswith("room.exr: left out, no sky above") for line in said)
    assert any("batches of 4 instead of 16" in line for line in said)
    light = bundle.light()
    with torch.no_grad():
        sky = light(light.starts_towards(torch.tensor([[0.5, 0.5, -0.7]]))[0])
    assert bool(sky.isfinite().all())
    assert float(sky.min()) >= 0
    card = (out / "card.md").read_text()
    assert "| train | 16 | 16 |" in card
    assert bundle.data_sha256 in card
    assert (out / "reconstructions.png").is_file()
    assert not (exr_skies / "index.csv").exists()  # FOLDER may be read-only


SELDOM = [
    pytest.param(moment, marks=pytest.mark.slow) for moment in ("indexed", "trained", "priors")
]


class Killed(BaseException):
    """A kill as far as Python can feel one."""


@pytest.mark.parametrize("moment", ["within the epoch", *SELDOM])
def test_a_run_that_was_killed_goes_on_to_the_same_model(
    moment: str,
    model: tuple[Path, list[str]],
    exr_skies: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn = []
    draw_batch = autoencoder.draw_batch

    def draw(*arguments: object) -> object:
        drawn.append(arguments)
        if len(drawn) == 3:
            raise Killed
        return draw_batch(*arguments)  # type: ignore[arg-type]

    def kill(*_: object, **__: object) -> None:
        raise Killed

    settings = config(checkpoint_steps=1)
    with monkeypatch.context() as patched:
        if moment == "indexed":
            patched.setattr(folder, "train", kill)
        elif moment == "within the epoch":
            patched.setattr(autoencoder, "draw_batch", draw)
        elif moment == "trained":
            patched.setattr(folder, "fit_priors", kill)
        else:
            patched.setattr("skylight.training._prior.model_card", kill)
        with pytest.raises(Killed):
            train_folder(
                exr_skies, tmp_path / "mine", settings, {"epochs": 1}, report=lambda _: None
            )
    with pytest.raises(InputError, match=r"bundle\.json"):
        load_bundle(tmp_path / "mine")
    said: list[str] = []
    train_folder(exr_skies, tmp_path / "mine", settings, {"epochs": 1}, report=said.append)
    assert load_bundle(tmp_path / "mine").fingerprint == load_bundle(model[0]).fingerprint
    resumed = {"indexed": None, "within the epoch": "resuming at step 2 of 4"}
    wanted = resumed.get(moment, "resuming at step 4 of 4")
    assert wanted is None or wanted in said


@pytest.mark.parametrize(("skies", "batch", "epochs"), [(3, 1, 100), (32, 8, 75), (5000, 16, 9)])
def test_few_skies_get_small_batches_and_many_epochs(skies: int, batch: int, epochs: int) -> None:
    said: list[str] = []
    base = AutoencoderConfig(batch=16, epochs=9)
    found = fitting(base, {}, skies, said.append)
    assert (found.batch, found.epochs) == (batch, epochs)
    assert (found.starts_from == SHIPPED / NETWORK) == (skies < 2000)
    assert found.learning_rate == base.learning_rate / (3 if skies < 2000 else 1)
    assert bool(said) == (found.batch != 16 or found.epochs != 9 or skies < 2000)
    thesis = AutoencoderConfig(network="convolutions", sun=False)
    scratch = fitting(thesis, {}, skies, said.append)
    assert scratch.starts_from is None  # the shipped weights are of another network
    asked = {"batch": 2, "epochs": 5, "patience": 1, "learning_rate": 0.5, "starts_from": None}
    assert fitting(base, asked, skies, said.append) == replace(base, **asked)


def test_skies_of_one_day_are_refused(exr_skies: Path, tmp_path: Path) -> None:
    skies = tmp_path / "skies"
    skies.mkdir()
    for number, path in enumerate(sorted(exr_skies.glob("2024*"))[:5]):
        (skies / f"2024-05-01_10{number:02d}00.exr").write_bytes(path.read_bytes())
    with pytest.raises(InputError) as caught:
        train_folder(skies, tmp_path / "out", config(), report=lambda _: None)
    assert "1 day(s)" in str(caught.value)
    assert "skies index" in str(caught.value)


def test_too_few_skies_for_the_priors_are_refused_before_training(
    exr_skies: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    skies = tmp_path / "skies"
    skies.mkdir()
    for path in sorted(exr_skies.glob("2024*"))[:5]:
        shutil.copy(path, skies)
    monkeypatch.setattr(folder, "train", lambda *_: pytest.fail("the network was trained"))
    with pytest.raises(InputError) as caught:
        train_folder(skies, tmp_path / "out", config(), report=lambda _: None)
    assert "3 training skies" in str(caught.value)
    assert f"at least {AutoencoderLight.candidates}" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_the_folders_own_index_is_used(sky_folder: Path, tmp_path: Path) -> None:
    """That of simulated skies knows more than their maps show; they need not be 32 rows high."""
    said: list[str] = []
    train_folder(sky_folder, tmp_path / "out", config(), {"epochs": 1}, report=said.append)
    assert not (tmp_path / "out" / "training" / "index.csv").exists()
    assert load_bundle(tmp_path / "out").skies > 0


@pytest.mark.parametrize("name", ["sky_autoencoder", "sky_autoencoder_thesis", "sky_prior"])
def test_configurations_by_name(name: str) -> None:
    assert read_config(find_config(name)) == read_config(
        Path(__file__).parents[2] / "configs" / f"{name}.yaml"
    )
    with pytest.raises(InputError, match=name):
        find_config("sky_autoencode")


def test_a_run_is_of_one_folder(
    model: tuple[Path, list[str]], exr_skies: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    shutil.copy(next(exr_skies.glob("2024*.exr")), other)
    with pytest.raises(InputError, match=f"than {re.escape(str(other))}"):
        train_folder(other, model[0], config(), {"epochs": 1})


ROOT = Path(__file__).parents[2]


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line that ``train.py`` says before it exits with 2."""
    with pytest.raises(SystemExit) as caught:
        main(list(arguments))
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said
    return said


@pytest.fixture
def run_yaml(tmp_path: Path) -> str:
    path = tmp_path / "run.yaml"
    path.write_text(f"kind: autoencoder\ndata: {tmp_path}/none\nout: {tmp_path}/out\n")
    return str(path)


@pytest.mark.parametrize("arguments", [(), ("--epochs", "3")])
def test_usage(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]) -> None:
    assert refused(capsys, *arguments).startswith("train.py: usage: python train.py")


def test_help_lists_configurations_and_keys(
    capsys: pytest.CaptureFixture[str], run_yaml: str, tmp_path: Path
) -> None:
    """With all defaults, or the values of a file; every key has a meaning."""
    main(["--help"])
    page = capsys.readouterr().out
    assert page.startswith("usage: python train.py CONFIG [KEY=VALUE ...]")
    for name in ("sky_autoencoder", "sky_autoencoder_thesis", "sky_prior", "csc_dictionary"):
        assert re.search(rf"^  {name} +\w", page, re.MULTILINE)
    for kind in (AutoencoderConfig, PriorConfig, DictionaryConfig, PlacesConfig):
        meanings = _meanings(kind)
        for field in fields(kind):
            if field.name != "kind":
                assert f"\n  {field.name}=" in page
                assert " ".join(meanings[field.name].split()[:2]) in " ".join(page.split())
    assert re.search(r"^  masked=0.0 +a number from 0 to 1\. Probability", page, re.MULTILINE)
    main([run_yaml, "--help"])
    assert f"  out={tmp_path}/out\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("kind", "arguments", "changes"),
    [
        (AutoencoderConfig, "epochs=3 --batch 4", {"epochs": 3, "batch": 4}),
        (AutoencoderConfig, "--learning-rate=3e-4", {"learning_rate": 3e-4}),
        (
            AutoencoderConfig,
            "--no-mirror --sun --compile true",
            {"mirror": False} | dict.fromkeys(["sun", "compile"], True),
        ),
        (
            AutoencoderConfig,
            "starts_from=a=b --data c",
            {"starts_from": Path("a=b"), "data": Path("c")},
        ),
        (AutoencoderConfig, "mirror=off starts_from=none", {"mirror": False, "starts_from": None}),
        (PriorConfig, "bank=48 seed=-1", {"bank": 48, "seed": -1}),
        (
            DictionaryConfig,
            "maps=a.exr,b.exr category=",
            {"maps": ("a.exr", "b.exr"), "category": ""},
        ),
        (
            DictionaryConfig,
            "--maps a.exr b.exr --signed",
            {"maps": ("a.exr", "b.exr"), "signed": True},
        ),
    ],
)
def test_overrides(kind: type[Config], arguments: str, changes: dict[str, object]) -> None:
    assert read_overrides(kind, without_dashes(kind, arguments.split())) == changes


@pytest.mark.parametrize(
    ("kind", "arguments", "said"),
    [
        (AutoencoderConfig, "epoch=3", "did you mean epochs? known are batch"),
        (AutoencoderConfig, "--epoch 3", "did you mean epochs?"),
        (AutoencoderConfig, "--no-epochs 3", "unknown keys no_epochs"),
        (AutoencoderConfig, "kind=prior", "`kind` must be one of autoencoder, got 'prior'"),
        (AutoencoderConfig, "epochs=2.5", "`epochs` must be a whole number at least 1, got '2.5'"),
        (AutoencoderConfig, "masked=", "`masked` must be a number from 0 to 1, got ''"),
        (AutoencoderConfig, "mirror=2", "`mirror` must be true or false, got '2'"),
        (AutoencoderConfig, "schedule=step", "`schedule` must be one of cosine, constant"),
        (AutoencoderConfig, "epochs=3 --epochs 4", "`epochs` is given twice"),
        (AutoencoderConfig, "epochs", "'epochs' is no override"),
        (AutoencoderConfig, "--batch", "--batch: its value is missing; it must be a whole number"),
        (PriorConfig, "epochs=3", "unknown keys epochs"),
        (DictionaryConfig, "method=mean", "one of kmeans, gradient"),
    ],
)
def test_overrides_that_cannot_be(kind: type[Config], arguments: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        read_overrides(kind, without_dashes(kind, arguments.split()))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_one_line_for_what_cannot_be_read(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, run_yaml: str
) -> None:
    assert "none.yaml" in refused(capsys, str(tmp_path / "none.yaml"))
    no_skies = refused(capsys, run_yaml)
    assert "no index of skies there" in no_skies
    assert no_skies.count("\n") == 1
    assert "`batch` must be at least 1" in refused(capsys, run_yaml, "--batch", "0")


@pytest.mark.parametrize(
    "override", [("--epoch", "3"), ("epochs=many",), ("coding=gamma",), ("--epochs",)]
)
def test_overrides_are_checked(
    capsys: pytest.CaptureFixture[str], run_yaml: str, override: tuple[str, ...]
) -> None:
    assert override[0] in refused(capsys, run_yaml, *override)


def test_an_interrupted_run_says_how_to_go_on(
    capsys: pytest.CaptureFixture[str], run_yaml: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("skylight.training._run.train", interrupted)
    with pytest.raises(SystemExit) as caught:
        main([run_yaml])
    assert caught.value.code == 1
    assert "goes on from here" in capsys.readouterr().err


def test_an_output_folder_that_cannot_be(
    capsys: pytest.CaptureFixture[str], run_yaml: str, sky_folder: Path, tmp_path: Path
) -> None:
    (tmp_path / "out").write_text("a file stands in the way")
    with pytest.raises(SystemExit) as caught:
        main([run_yaml, "--data", str(sky_folder)])
    assert caught.value.code == 1
    said = capsys.readouterr().err
    assert said.startswith("train.py: ")
    assert said.count("\n") == 1


def test_the_script(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["train.py"])
    with pytest.raises(SystemExit) as caught:
        runpy.run_path(str(ROOT / "train.py"), run_name="__main__")
    assert caught.value.code == 2
    assert capsys.readouterr().err.startswith("train.py: usage")
