from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.skies._index import normalise
from skylight.training import _skies as prepared
from skylight.training._checkpoint import initial_network
from skylight.training._config import AutoencoderConfig
from skylight.training._skies import augment, coded_skies, open_prepared, prepare

CONFIG = AutoencoderConfig(surroundings=0.5, tint=0.1)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Nine skies with a sun."""
    skies = torch.rand(9, 32, 128, 3, generator=torch.Generator().manual_seed(0))
    skies[:, 9, 64] = 3000.0
    np.save(tmp_path / "skies.npy", normalise(skies).numpy())
    return tmp_path / "skies.npy"


def silent(_: str) -> None:
    pass


def test_they_are_what_the_network_makes_of_varied_skies(path: Path, tmp_path: Path) -> None:
    prepare(path, CONFIG, tmp_path / "out", [0, 2], silent)
    found = [open_prepared(path, CONFIG, tmp_path / "out", copy) for copy in (0, 2)]
    network = initial_network(CONFIG)
    for copy, skies in zip((0, 2), found, strict=True):
        varied = augment(
            torch.from_numpy(np.load(path)),
            torch.Generator().manual_seed(copy * 1_000_003),
            CONFIG,
        )
        sun, rest = network.split(varied)
        np.testing.assert_allclose(skies.sun, sun.numpy(), rtol=1e-6)
        # half precision
        np.testing.assert_allclose(skies.coded, network.code(rest).numpy(), rtol=1e-3, atol=1e-4)
        one, coded = skies.batch([3])
        assert one.dtype == coded.dtype == torch.float32
        assert np.array_equal(coded.numpy()[0], skies.coded[3].astype(np.float32))
    assert not np.array_equal(found[0].coded, found[1].coded)


def test_they_are_made_once(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    prepare(path, CONFIG, tmp_path / "out", [0], said.append)
    assert said == ["9 skies prepared, copy 1"]
    prepare(path, replace(CONFIG, seed=1), tmp_path / "out", [0], silent)
    monkeypatch.setattr(prepared, "in_order", None)
    prepare(path, CONFIG, tmp_path / "out", [0], said.append)
    assert len(said) == 1
    one, other = (
        open_prepared(path, config, tmp_path / "out", 0)
        for config in (CONFIG, replace(CONFIG, seed=1))
    )
    assert not np.array_equal(one.coded, other.coded)


def test_what_was_interrupted_is_made_again(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(prepared, "_CHUNK", 4)

    def broken(*_: object) -> object:
        yield coded_skies(initial_network(CONFIG), torch.from_numpy(np.load(path)[:4]))
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(prepared, "in_order", broken)
        with pytest.raises(KeyboardInterrupt):
            prepare(path, CONFIG, tmp_path / "out", [0], silent)
    assert not list((tmp_path / "out").iterdir())
    prepare(path, CONFIG, tmp_path / "out", [0], silent)
    assert len(open_prepared(path, CONFIG, tmp_path / "out", 0)) == 9


def test_a_sun_in_linear_code_stays_finite(path: Path) -> None:
    """A network without a sun head sees it; half precision ends at 65,504."""
    config = AutoencoderConfig(network="convolutions", coding="linear", sun=False)
    skies = torch.from_numpy(np.load(path)) * 1e3
    found = coded_skies(initial_network(config), skies)
    assert found.sun.shape == (9, 0)
    assert np.isfinite(found.coded).all()
    assert found.coded.max() > 5e4
