from dataclasses import replace
from pathlib import Path

import pytest

from skylight.errors import InputError
from skylight.training._config import (
    AutoencoderConfig,
    DictionaryConfig,
    PriorConfig,
    config_yaml,
    read_config,
)

CONFIGS = Path(__file__).parents[2] / "configs"


def written(folder: Path, text: str) -> Path:
    path = folder / "run.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda p: p.name)
def test_shipped_configurations_are_read(path: Path) -> None:
    assert read_config(path).kind in ("autoencoder", "prior", "dictionary", "places")


@pytest.mark.parametrize(
    "config",
    [
        AutoencoderConfig(),
        AutoencoderConfig(weight_decay=1e-5, learning_rate=3e-7, latents=32, mirror=False),
        AutoencoderConfig(starts_from=Path("runs/a b/model.safetensors"), schedule="constant"),
        PriorConfig(data=Path("a/b c"), bank=48),
    ],
)
def test_written_and_read(tmp_path: Path, config: AutoencoderConfig | PriorConfig) -> None:
    assert read_config(written(tmp_path, config_yaml(config))) == config


def test_numbers_as_people_write_them(tmp_path: Path) -> None:
    config = read_config(
        written(tmp_path, "kind: autoencoder\nweight_decay: 1e-5\nlearning_rate: 1\n")
    )
    assert config == replace(AutoencoderConfig(), weight_decay=1e-5, learning_rate=1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("kind: autoencoder\nepoch: 3\n1: 2\n", "1, epoch; did you mean epochs. known are batch"),
        ("kind: autoencoder\nobstacles: 0.4\n", "unknown keys obstacles; .* surroundings"),
        ("kind: diffusion\n", "`kind` .* autoencoder, prior"),
        ("epochs: 3\n", "`kind`"),
        ("kind: {autoencoder: 1}\n", "`kind`"),
        ("- 1\n", "`kind`"),
        ("", "`kind`"),
        ("kind: [autoencoder\n", "YAML"),
        ("kind: autoencoder\ncoding: gamma\n", "`coding` .* log, linear"),
        ("kind: autoencoder\nepochs: many\n", "`epochs` .* whole number at least 1, got 'many'"),
        ("kind: autoencoder\nepochs: 2.5\n", "`epochs` .* whole number"),
        ("kind: autoencoder\nmirror: 1\n", "`mirror` .* true or false"),
        ("kind: autoencoder\nlearning_rate: true\n", "`learning_rate` .* a number at least 0"),
        ("kind: autoencoder\nlearning_rate: [1]\n", "`learning_rate` .* a number"),
        ("kind: autoencoder\ndata: 3\n", "`data` .* a path"),
        ("kind: autoencoder\nbatch: 0\n", "`batch` .* 1"),
        ("kind: autoencoder\nsurroundings: 1.5\n", "`surroundings` .* 1.5"),
        ("kind: autoencoder\noptimiser: sgd\nmomentum: 0\n", "`nesterov` .* `momentum`"),
        ("kind: autoencoder\nnoise_sigma: -1\n", "`noise_sigma` .* 0"),
        ("kind: autoencoder\nschedule: step\n", "`schedule` .* cosine, constant"),
        ("kind: autoencoder\nstarts_from: 3\n", "`starts_from`"),
        ("kind: prior\nbank: 3\n", "`bank` .* at least 24"),
        (f"kind: autoencoder\nlearning_rate: {'9' * 400}\n", "out of all bounds"),
        (f"kind: autoencoder\nepochs: -0x{'f' * 5000}\n", "out of all bounds"),
        ('kind: prior\n"a\\nb": 1\n', "unknown keys a b"),
    ],
)
def test_unusable_configurations(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message.replace("[", r"\[")) as caught:
        read_config(written(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_a_configuration_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.yaml"):
        read_config(tmp_path / "none.yaml")


def test_a_choice_that_is_none_is_refused() -> None:
    """Also where nothing checks annotations: "adam" would be SGD."""
    for config, key in (
        (AutoencoderConfig(), "optimiser"),
        (AutoencoderConfig(), "schedule"),
        (DictionaryConfig(), "method"),
    ):
        object.__setattr__(config, key, "adam")
        with pytest.raises(InputError, match=f"`{key}` must be one of .*, got 'adam'"):
            config.__post_init__()
