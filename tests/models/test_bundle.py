"""Light models as folders: what is written is read, and what does not fit is refused in a line."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from skylight.errors import AssetError, InputError
from skylight.io._tensors import read_tensors, write_tensors
from skylight.models._bundle import (
    BANK,
    CARD,
    LATENT_PRIOR,
    NETWORK,
    SUNSKY_PRIOR,
    LightBundle,
    load_bundle,
    load_network,
    save_network,
)
from skylight.models._convolutional import LATENT, ConvolutionalAutoencoder
from skylight.models._manifest import MANIFEST
from skylight.models._network import SkyNetwork
from skylight.models._prior import GaussianMixture
from skylight.models._splines import SplineAutoencoder


def mixture(size: int, seed: int = 0) -> GaussianMixture:
    generator = torch.Generator().manual_seed(seed)
    return GaussianMixture(
        torch.tensor([0.75, 0.25]),
        torch.randn(2, size, generator=generator),
        torch.eye(size).expand(2, -1, -1).clone(),
    )


@pytest.fixture(scope="module")
def bundle() -> LightBundle:
    generator = torch.Generator().manual_seed(1)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = ConvolutionalAutoencoder(coding="linear", sun=False).eval()
    return LightBundle(
        name="small",
        skies=12,
        data_sha256="0" * 64,
        network=network,
        latent_prior=mixture(LATENT),
        latents={
            "latent_mean": torch.randn(LATENT, generator=generator),
            "latent_scale": torch.rand(LATENT, LATENT, generator=generator).tril()
            + torch.eye(LATENT),
            "bank": torch.randn(8, LATENT, generator=generator),
            "bank_zenith_rad": torch.linspace(0.1, 1.5, 8),
        },
        sunsky_prior=mixture(9),
    )


@pytest.fixture
def folder(bundle: LightBundle, tmp_path: Path) -> Path:
    black = np.zeros((2, 2, 3), np.uint8)
    bundle.save(tmp_path / "model", card="# small\n", pictures={"black.png": black})
    return tmp_path / "model"


def test_what_is_saved_is_loaded(bundle: LightBundle, folder: Path) -> None:
    again = load_bundle(str(folder))
    assert (again.name, again.skies, again.data_sha256) == ("small", 12, "0" * 64)
    assert again.fingerprint == bundle.fingerprint
    assert again.network.coding == "linear"
    params = bundle.light().starts_towards(torch.tensor([[0.4, 0.6, -0.7]]))[0]
    torch.testing.assert_close(again.light()(params), bundle.light()(params), rtol=0, atol=0)
    x = torch.randn(3, LATENT, generator=torch.Generator().manual_seed(2))
    assert torch.equal(again.prior().log_prob(x), bundle.prior().log_prob(x))
    assert (folder / CARD).read_text() == "# small\n"
    assert (folder / "black.png").is_file()


def test_every_light_and_prior_is_a_fresh_object() -> None:
    bundle = load_bundle()
    light, prior = bundle.light(), bundle.prior()
    before = light.starts()
    with torch.no_grad():
        for tensor in (*light.state_dict().values(), *prior.state_dict().values()):
            tensor.zero_()
    assert torch.equal(bundle.light().starts(), before)
    assert torch.equal(bundle.prior().weights, load_bundle().prior().weights)
    assert bundle.fingerprint == load_bundle().fingerprint


def test_the_shipped_model_goes_through_the_same_door(tmp_path: Path) -> None:
    shipped = load_bundle()
    shipped.save(tmp_path, card="", pictures={})
    again = load_bundle(tmp_path)
    assert again.fingerprint == shipped.fingerprint
    start = shipped.light().starts()[:1]
    assert torch.equal(again.light()(start), shipped.light()(start))


def rewrite(**entries: object) -> Callable[[Path], object]:
    def change(folder: Path) -> None:
        manifest = json.loads((folder / MANIFEST).read_text()) | entries
        (folder / MANIFEST).write_text(json.dumps(manifest))

    return change


def other_bank(**entries: torch.Tensor) -> Callable[[Path], object]:
    def change(folder: Path) -> None:
        tensors, _ = read_tensors(folder / BANK)
        write_tensors(folder / BANK, tensors | entries)

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (shutil.rmtree, "no folder is there"),
        (lambda folder: (folder / MANIFEST).unlink(), f"no {MANIFEST}"),
        (lambda folder: (folder / MANIFEST).write_text("{"), "no JSON"),
        (rewrite(kind="scene"), "kind"),
        (rewrite(version=3), "upgrade"),
        (lambda folder: (folder / MANIFEST).write_text('{"kind": "light model", "version": 3}'),
         "upgrade"),
        (rewrite(version="1"), "whole number"),
        (rewrite(skies="many"), "whole number"),
        (rewrite(fingerprint="0" * 64), MANIFEST),
        *((lambda folder, n=n: (folder / n).unlink(), f"{n} is missing")
          for n in (NETWORK, LATENT_PRIOR, BANK, SUNSKY_PRIOR)),
        *((lambda folder, n=n: (folder / n).write_bytes(b"\x10" * 1000), n)
          for n in (NETWORK, LATENT_PRIOR, BANK, SUNSKY_PRIOR)),
        (lambda folder: save_network(ConvolutionalAutoencoder(), folder / NETWORK), MANIFEST),
        (lambda folder: write_tensors(folder / NETWORK, {"x": torch.ones(1)}), NETWORK),
        (lambda folder: mixture(9).save(folder / LATENT_PRIOR), "64 latents"),
        (other_bank(bank=torch.zeros(8, 32)), BANK),
        (other_bank(bank=torch.zeros(2, LATENT), bank_zenith_rad=torch.zeros(2)), BANK),
        (other_bank(latent_mean=torch.full((LATENT,), torch.nan)), "finite"),
        (other_bank(latent_scale=torch.ones(LATENT, LATENT)), "triangle"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(
    folder: Path, change: Callable[[Path], object], said: str
) -> None:
    change(folder)
    with pytest.raises(InputError) as caught:
        load_bundle(folder)
    message = str(caught.value)
    assert said in message
    assert str(folder) in message
    assert "\n" not in message
    assert ("skylight train" in message) != ("upgrade" in message)


@pytest.mark.parametrize("sun", [True, False])
@pytest.mark.parametrize("coding", ["log", "linear"])
def test_saved_and_loaded(tmp_path: Path, coding: str, sun: bool) -> None:
    network = ConvolutionalAutoencoder(coding=coding, sun=sun).eval()  # type: ignore[arg-type]
    save_network(network, tmp_path / "model.safetensors")
    loaded = load_network(tmp_path / "model.safetensors")
    assert (type(loaded), loaded.coding, loaded.sun) == (ConvolutionalAutoencoder, coding, sun)
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
