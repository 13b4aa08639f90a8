"""Networks and losses of users, trained, resumed and made into light models."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from skylight.cli import main
from skylight.errors import InputError
from skylight.models._bundle import load_bundle, load_network
from skylight.models._network import SkyNetwork
from skylight.models._network_names import BUILTIN, _registered, register_network
from skylight.training import _autoencoder as training
from skylight.training._autoencoder import reconstruction_loss, train
from skylight.training._checkpoint import initial_network
from skylight.training._config import AutoencoderConfig, config_yaml, read_config
from skylight.training._skies import Corruption
from tests.own_network import OtherNetwork, TinyNetwork

EXAMPLES = Path(__file__).parents[2] / "examples"
PLACE = "tests.own_network:TinyNetwork"
LATENTS = 8


@pytest.fixture
def config(sky_folder: Path, tmp_path: Path) -> AutoencoderConfig:
    """Two epochs of some steps."""
    return AutoencoderConfig(
        data=sky_folder,
        out=tmp_path / "run",
        latents=LATENTS,
        epochs=2,
        batch=8,
        warmup_steps=1,
        bfloat16=False,
        checkpoint_steps=1,
        device="cpu",
    )


def silent(_: str) -> None:
    pass


def same_weights(one: SkyNetwork, other: SkyNetwork) -> bool:
    ours, theirs = one.state_dict(), other.state_dict()
    return all(torch.equal(ours[name], theirs[name]) for name in ours | theirs)


def test_a_class_a_name_and_a_place_train_alike(
    config: AutoencoderConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skylight.models._network_names._registered", dict(_registered))
    of_class = load_network(train(config, silent, network=TinyNetwork), TinyNetwork)
    assert read_config(config.out / "config.yaml") == replace(config, network=PLACE)
    placed = replace(config, out=tmp_path / "placed")
    assert same_weights(of_class, load_network(train(placed, silent, network=PLACE), PLACE))
    register_network("tiny", TinyNetwork)
    named = replace(config, network="tiny", out=tmp_path / "named")
    assert same_weights(of_class, load_network(train(named, silent)))
    # as in a process that prepares skies, where nothing was registered
    monkeypatch.setattr("skylight.models._network_names._registered", dict(BUILTIN))
    assert isinstance(initial_network(named, TinyNetwork), TinyNetwork)


def test_an_interrupted_run_with_dropout_goes_on_bit_by_bit(
    config: AutoencoderConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = load_network(train(config, silent, network=TinyNetwork), TinyNetwork)
    cut, drawn, draw_batch = replace(config, out=tmp_path / "cut"), [], training.draw_batch

    def draw(*arguments: object) -> object:
        drawn.append(arguments)
        if len(drawn) == 2:
            raise KeyboardInterrupt
        return draw_batch(*arguments)  # type: ignore[arg-type]

    with monkeypatch.context() as patched:
        patched.setattr(training, "draw_batch", draw)
        with pytest.raises(KeyboardInterrupt):
            train(cut, silent, network=TinyNetwork)
    torch.rand(7)  # of the global generator, on which nothing depends
    said: list[str] = []
    resumed = load_network(train(cut, said.append, network=TinyNetwork), TinyNetwork)
    assert any(line.startswith("resuming at step 1") for line in said)
    assert same_weights(resumed, whole)


def test_the_global_generator_is_left_alone(config: AutoencoderConfig) -> None:
    before = torch.get_rng_state()
    train(replace(config, epochs=1), silent, network=TinyNetwork)
    assert torch.equal(torch.get_rng_state(), before)


def test_a_network_that_is_made_starts_with_its_weights(config: AutoencoderConfig) -> None:
    own = TinyNetwork(LATENTS)
    start = {name: tensor.clone() for name, tensor in own.state_dict().items()}
    named = replace(config, network=PLACE)
    assert initial_network(named, own) is own
    assert all(torch.equal(start[name], tensor) for name, tensor in own.state_dict().items())
    still = replace(config, epochs=1, learning_rate=0.0, optimiser="sgd", weight_decay=0.0)
    again = load_network(train(still, silent, network=own), TinyNetwork)
    assert torch.equal(again.get_parameter("decoder.weight"), start["decoder.weight"])
    wide = TinyNetwork(LATENTS)
    wide.decoder = torch.nn.Linear(LATENTS, 3)
    with pytest.raises(InputError, match="make it by its latents"):
        train(config, silent, network=wide)
    with pytest.raises(InputError, match="give one of them"):
        train(replace(config, starts_from=Path("x")), silent, network=own)


def test_weights_of_ones_own_to_start_from(config: AutoencoderConfig, tmp_path: Path) -> None:
    first = train(replace(config, epochs=1), silent, network=TinyNetwork)
    second = replace(config, network=PLACE, out=tmp_path / "second", starts_from=first)
    assert same_weights(initial_network(second), load_network(first, TinyNetwork))
    with pytest.raises(InputError, match=r"not tests\.own_network:OtherNetwork"):
        train(second, silent, network=OtherNetwork)
    with pytest.raises(InputError, match=f"its network is {PLACE}"):
        initial_network(replace(second, network="splines"))


def test_what_the_configuration_says_otherwise_is_refused(config: AutoencoderConfig) -> None:
    with pytest.raises(InputError, match=r"sun: True; the configuration says .* sun: False"):
        train(replace(config, network=PLACE, sun=False), silent)
    with pytest.raises(InputError, match="coding: linear"):
        train(replace(config, network=PLACE, coding="linear"), silent)
    for name, said in (("mine", "unknown network 'mine'"), ("", "unknown network")):
        with pytest.raises(InputError, match=said):
            AutoencoderConfig(network=name)
    with pytest.raises(InputError, match="or of a class of yours that `network` names"):
        AutoencoderConfig(sun=False)
    with pytest.raises(InputError, match="`latents` of network: a:B must be from 6 to 1024"):
        AutoencoderConfig(network="a:B", latents=5)


def squared(
    network: SkyNetwork,
    sun: Tensor,
    truth: Tensor,
    config: AutoencoderConfig,
    corruption: Corruption | None,
) -> Tensor:
    """The mean squared error of coded skies, times 7."""
    found = network.decode_coded(network.encode_coded(sun, truth))
    return 7 * (found - truth).square().mean((1, 2, 3))


def test_a_loss_of_ones_own_is_what_is_trained_and_validated(config: AutoencoderConfig) -> None:
    train(config, silent, network=TinyNetwork, loss=squared)
    curves = json.loads((config.out / "curves.json").read_text())["curves"]
    assert all(each["validation"] == each["denoising"] for each in curves)  # it is never corrupted
    network = load_network(config.out / "model.safetensors", TinyNetwork)
    data = training.load_data(config.data, silent)
    skies = torch.from_numpy(data.validation.copy())
    with torch.no_grad():
        sun, rest = network.split(skies)
        coded = network.code(rest).half().float()
        expected = float(squared(network, sun, coded, config, None).mean())
    assert min(each["validation"] for each in curves) == pytest.approx(expected, rel=0.05)
    with pytest.raises(InputError, match="another configuration"):
        train(config, silent, network=TinyNetwork)


@pytest.mark.parametrize(
    ("loss", "said"),
    [
        (lambda *parts: squared(*parts).mean(), r"\(b,\), got \(\) for b = 2"),
        (lambda *parts: squared(*parts).detach(), "no gradient"),
        (lambda *parts: 0.0, "got float"),
        (lambda network: network, "the loss fails"),
    ],
)
def test_what_a_loss_must_give(config: AutoencoderConfig, loss, said: str) -> None:
    with pytest.raises(InputError, match=said):
        train(config, silent, loss=loss, network=TinyNetwork)


def test_the_loss_of_training_is_the_default(config: AutoencoderConfig, tmp_path: Path) -> None:
    plain = load_network(train(config, silent, network=TinyNetwork), TinyNetwork)
    other = replace(config, out=tmp_path / "other")
    given = train(other, silent, network=TinyNetwork, loss=reconstruction_loss)
    assert same_weights(plain, load_network(given, TinyNetwork))
    assert train(other, silent, network=TinyNetwork) == given  # the same run


def test_the_example_becomes_a_light_model(
    sky_folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """By the command of its first lines, with fewer skies and epochs."""
    for name in ("own_network.py", "own_network.yaml"):
        shutil.copy(EXAMPLES / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    few = replace(
        read_config(Path("own_network.yaml")),  # type: ignore[type-var]
        data=sky_folder,
        epochs=1,
        copies=1,
        batch=8,
        surroundings=0.0,
        device="cpu",
    )
    Path("few.yaml").write_text(config_yaml(few))
    place = "own_network:PixelNetwork"
    assert main(["train", "--config", "few.yaml"]) == 0
    assert "a light model" in capsys.readouterr().out
    model = Path("runs/own_network")
    assert f"--model FOLDER --network {place}" in (model / "card.md").read_text()
    light = load_bundle(model, place).light()
    with torch.no_grad():
        sky = light(light.starts_towards(torch.tensor([[0.5, 0.5, -0.7]]))[0])
    assert bool(sky.isfinite().all())
    assert float(sky.min()) >= 0
    with pytest.raises(InputError, match=f"give --network {place}"):
        load_bundle(model)
