from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from skylight.errors import AssetError
from skylight.io._tensors import read_tensors, write_tensors
from skylight.models._bundle import load_network, save_network
from skylight.models._convolutional import ConvolutionalAutoencoder
from skylight.models._network import SkyNetwork
from skylight.models._splines import SplineAutoencoder


@pytest.mark.parametrize("sun", [True, False])
@pytest.mark.parametrize("coding", ["log", "linear"])
def test_saved_and_loaded(tmp_path: Path, coding: str, sun: bool) -> None:
    network = ConvolutionalAutoencoder(coding, sun=sun).eval()  # type: ignore[arg-type]
    save_network(network, tmp_path / "model.safetensors")
    loaded = load_network(tmp_path / "model.safetensors")
    assert (loaded.kind, loaded.coding, loaded.sun) == ("convolutions", coding, sun)
    assert not loaded.training
    z = torch.randn(2, 64)
    assert torch.equal(loaded.decode(z), network.decode(z))


@pytest.mark.parametrize("latents", [32, 64])
def test_splines_are_saved_in_half_precision(tmp_path: Path, latents: int) -> None:
    """Saved again they are the same, and as they were but for 0.5 % of radiance."""
    network = SplineAutoencoder(latents).eval()
    path = tmp_path / "model.safetensors"
    save_network(network, path)
    loaded = load_network(path)
    assert loaded.latents == latents
    assert path.stat().st_size < 2.01 * sum(p.numel() for p in network.parameters())
    z = torch.randn(4, latents, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        torch.testing.assert_close(loaded.decode(z), network.decode(z), rtol=5e-3, atol=1e-4)
    content = path.read_bytes()
    save_network(loaded, path)
    assert path.read_bytes() == content


def _truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _last(state: dict[str, torch.Tensor]) -> str:
    """The output's weight."""
    return "output.weight" if "output.weight" in state else "decoder.4.weight"


def _drop_one(path: Path) -> None:
    state, _ = read_tensors(path)
    state.pop(_last(state))
    write_tensors(path, state)


def _misshape(path: Path) -> None:
    state, _ = read_tensors(path)
    write_tensors(path, state | {_last(state): torch.zeros(2, 2)})


def _not_finite(path: Path) -> None:
    state, _ = read_tensors(path)
    write_tensors(path, state | {_last(state): torch.full_like(state[_last(state)], torch.nan)})


def _flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[-100] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize(
    "damage",
    [
        Path.unlink,
        _truncate,
        _drop_one,
        _misshape,
        lambda path: path.write_bytes(b""),
        lambda path: path.write_text("not a checkpoint"),
        _flip,
        lambda path: write_tensors(path, {"x": torch.zeros(1)}),
        lambda path: save_file({"x": torch.zeros(1)}, path),
        lambda path: write_tensors(path, {"linear.weight": torch.zeros(4920)}),
        lambda path: write_tensors(path, {"linear.weight": torch.zeros(4920, 2)}),
        lambda path: write_tensors(path, {"to_latent.bias": torch.zeros(())}),
        lambda path: write_tensors(path, {"linear.weight": torch.zeros(0, 2**40)}),
        _not_finite,
    ],
)
@pytest.mark.parametrize("network", [ConvolutionalAutoencoder(), SplineAutoencoder()])
def test_unusable_checkpoints(tmp_path: Path, damage, network: SkyNetwork) -> None:
    path = tmp_path / "model.safetensors"
    save_network(network, path)
    damage(path)
    with pytest.raises(AssetError) as caught:
        load_network(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    assert "train.py" in message
