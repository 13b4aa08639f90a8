"""Networks of users: named, given, and never imported because a file says so."""

import json
import pickle
import sys
from dataclasses import replace
from multiprocessing.reduction import ForkingPickler
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from skylight.errors import InputError
from skylight.models import SkyNetwork, SplineAutoencoder
from skylight.models._bundle import LightBundle, load_bundle, load_network, own_model, save_network
from skylight.models._convolutional import ConvolutionalAutoencoder
from skylight.models._manifest import MANIFEST
from skylight.models._network_check import check_network, made_network
from skylight.models._network_names import (
    _registered,
    check_network_name,
    is_importable,
    network_class,
    network_name,
    network_option,
    register_network,
)
from tests.models.test_bundle import mixture
from tests.own_network import OtherNetwork, TinyNetwork

LATENTS = 12
PLACE = "tests.own_network:TinyNetwork"
TINY_IN_FOLDER = """
from pathlib import Path
from tests.own_network import TinyNetwork as Base
Path("imported").touch()
class Mine(Base):
    class Inner(Base):
        pass
"""


@pytest.fixture(autouse=True)
def as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test registers or imports is its own."""
    before = dict(_registered)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr("skylight.models._network_names._registered", before)


@pytest.fixture(scope="module")
def bundle() -> LightBundle:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = TinyNetwork(LATENTS)
        network.norm(torch.randn(4, 192))  # whose statistics are then not those of the start
    return LightBundle(
        name="own",
        skies=12,
        data_sha256="0" * 64,
        network=network.eval(),
        latent_prior=mixture(LATENTS),
        latents={
            "latent_mean": torch.zeros(LATENTS),
            "latent_scale": torch.eye(LATENTS),
            "bank": torch.randn(8, LATENTS, generator=torch.Generator().manual_seed(0)),
            "bank_zenith_rad": torch.linspace(0.1, 1.5, 8),
        },
        sunsky_prior=mixture(9),
    )


@pytest.fixture
def folder(bundle: LightBundle, tmp_path: Path) -> Path:
    bundle.save(tmp_path / "own", card="", pictures={})
    return tmp_path / "own"


def test_a_class_has_its_place_or_the_name_that_it_is_registered_by() -> None:
    assert network_name(TinyNetwork) == PLACE
    assert network_class(PLACE) is TinyNetwork
    assert register_network("mine", TinyNetwork) is TinyNetwork
    assert network_name(TinyNetwork) == "mine"
    assert network_class("mine") is network_class(PLACE) is TinyNetwork
    register_network("other")(OtherNetwork)
    assert network_class("other") is OtherNetwork
    assert network_name(SplineAutoencoder) == "splines"


def test_a_script_goes_by_the_name_that_others_import_it_by(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    main = sys.modules["__main__"]
    monkeypatch.setattr(main, "__spec__", None)
    monkeypatch.setattr(main, "__file__", "/somewhere/my_script.py", raising=False)
    monkeypatch.setattr(OtherNetwork, "__module__", "__main__")
    assert network_name(OtherNetwork) == "my_script:OtherNetwork"


def test_what_functions_and_notebooks_define_is_of_this_process_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Local(TinyNetwork):
        pass

    assert is_importable(TinyNetwork)
    assert not is_importable(Local)
    monkeypatch.setattr(sys.modules["__main__"], "TinyNetwork", TinyNetwork, raising=False)
    monkeypatch.setattr(TinyNetwork, "__module__", "__main__")
    for file, is_script in ((__file__, True), ("<stdin>", False), (None, False)):
        monkeypatch.setattr(sys.modules["__main__"], "__file__", file, raising=False)
        assert is_importable(TinyNetwork) == is_script
    check_network_name(network_name(Local))


def test_a_module_is_found_in_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_own_sky.py").write_text(TINY_IN_FOLDER)
    assert network_name(network_class("my_own_sky:Mine")) == "my_own_sky:Mine"
    assert network_name(network_class("my_own_sky:Mine.Inner")) == "my_own_sky:Mine.Inner"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("spline", "choose one of splines, convolutions"),
        ("", "choose one of splines"),
        ("a:b:c", "module:Class"),
        (":Mine", "module:Class"),
        ("my_file.py:Mine", "name the module as Python does, my_file:Mine"),
        ("folder/my_file:Mine", "my_file:Mine"),
        ("nowhere_at_all:Mine", "No module named"),
        (
            "tests.own_network:Nothing",
            "imported: module 'tests.own_network' has no attribute 'Nothing'",
        ),
        ("..relative:Mine", "cannot be imported"),
        ("json:dumps", "json:dumps is no class derived from skylight.models.SkyNetwork"),
        ("torch.nn:Linear", "no class derived"),
        ("skylight.models:SkyNetwork", "lacks decode_coded and encode_coded"),
    ],
)
def test_names_that_lead_to_no_network(name: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        network_class(name)
    assert said in str(caught.value)


def test_a_module_that_fails_or_ends_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, line in {"fails_here": "1 / 0", "ends_here": "raise SystemExit(3)"}.items():
        (tmp_path / f"{name}.py").write_text(line)
        with pytest.raises(InputError, match=f"{name}:Mine cannot be imported"):
            network_class(f"{name}:Mine")


def test_names_that_cannot_be_registered() -> None:
    for name, network, said in (
        ("splines", TinyNetwork, "is that of skylight.models._splines:SplineAutoencoder"),
        ("a:b", TinyNetwork, "is no name"),
        ("", TinyNetwork, "is no name"),
        ("mine", SkyNetwork, "lacks"),
    ):
        with pytest.raises(InputError, match=said):
            register_network(name, network)
    register_network("mine", TinyNetwork)
    register_network("mine", TinyNetwork)
    with pytest.raises(InputError, match="choose another"):
        register_network("mine", OtherNetwork)


def test_a_bundle_names_its_class_and_is_read_with_it(bundle: LightBundle, folder: Path) -> None:
    manifest = json.loads((folder / MANIFEST).read_text())
    assert (manifest["version"], manifest["network"]) == (2, PLACE)
    start = bundle.light().starts()
    for given in (TinyNetwork, PLACE):
        again = load_bundle(folder, given)
        assert torch.equal(again.light()(start), bundle.light()(start))
        assert again.fingerprint == bundle.fingerprint
    with pytest.raises(InputError) as caught:
        load_bundle(folder)
    assert f"{folder}: its network is {PLACE}" in str(caught.value)
    assert f"give --network {PLACE}" in str(caught.value)
    register_network("mine", TinyNetwork)  # after the name was written
    assert load_bundle(folder).fingerprint == bundle.fingerprint


def test_a_registered_name_says_how_commands_find_its_class(
    bundle: LightBundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is known in the process that registered it, or by a module that does."""
    assert network_option(SplineAutoencoder) == ""
    with monkeypatch.context() as training:
        training.setattr("skylight.models._network_names._registered", dict(_registered))
        register_network("mine", TinyNetwork)
        bundle.save(tmp_path / "own", card="", pictures={})
        assert network_option(TinyNetwork) == f" --network {PLACE}"
    for given in (None, PLACE):
        with pytest.raises(InputError, match=r"its network is mine, .*@register_network\('mine'\)"):
            load_bundle(tmp_path / "own", given)
    register_network("mine", TinyNetwork)
    assert load_bundle(tmp_path / "own", PLACE).fingerprint == bundle.fingerprint


def test_another_class_is_refused_by_its_name(folder: Path) -> None:
    register_network("other", OtherNetwork)
    for given in (OtherNetwork, "other", "tests.own_network:OtherNetwork", SplineAutoencoder):
        with pytest.raises(InputError, match=f"its network is {PLACE}, not "):
            load_bundle(folder, given)
    with pytest.raises(InputError, match="leave --network out"):
        load_bundle(Path(__file__).parents[2] / "skylight/models/data/sky_autoencoder", PLACE)
    with pytest.raises(InputError, match="give --model"):
        own_model(None, PLACE)
    assert own_model(folder, None) == folder


def test_nothing_is_imported_because_a_bundle_says_so(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "of_the_bundle.py").write_text(TINY_IN_FOLDER)
    entries = json.loads((folder / MANIFEST).read_text())
    for name in ("of_the_bundle:Mine", "of_the_bundle", "a\nb", 3, ["of_the_bundle:Mine"]):
        (folder / MANIFEST).write_text(json.dumps(entries | {"network": name}))
        for given in (None, TinyNetwork):
            with pytest.raises(InputError, match=r"give --network|names no class"):
                load_bundle(folder, given)
    assert not (tmp_path / "imported").exists()
    assert "of_the_bundle" not in sys.modules


def test_a_checkpoint_names_its_class_too(tmp_path: Path) -> None:
    path = tmp_path / "model.safetensors"
    network = TinyNetwork(LATENTS).eval()
    save_network(network, path)
    with pytest.raises(InputError, match=f"give --network {PLACE}"):
        load_network(path)
    with pytest.raises(InputError, match=f"{PLACE}, not tests.own_network:OtherNetwork"):
        load_network(path, OtherNetwork)
    again = load_network(path, PLACE)
    assert not again.training
    for name, tensor in network.state_dict().items():
        assert torch.equal(again.state_dict()[name], tensor)
        assert again.state_dict()[name].dtype == tensor.dtype
    save_network(ConvolutionalAutoencoder(), path)
    with pytest.raises(InputError, match="leave --network out"):
        load_network(path, PLACE)


class Tied(TinyNetwork):
    """A layer with two names."""

    def __init__(self, latents: int) -> None:
        super().__init__(latents)
        self.again = self.encoder


def test_shared_weights_are_written(tmp_path: Path) -> None:
    network = Tied(LATENTS)
    save_network(network, tmp_path / "tied.safetensors")
    again = load_network(tmp_path / "tied.safetensors", Tied)
    assert torch.equal(again.get_parameter("again.weight"), network.encoder.weight)
    assert again.get_parameter("again.weight") is again.get_parameter("encoder.weight")


def test_a_class_that_has_changed_since_is_told(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = TinyNetwork.__init__

    def wider(self: TinyNetwork, latents: int) -> None:
        made(self, latents)
        self.decoder = nn.Linear(latents, 7)

    monkeypatch.setattr(TinyNetwork, "__init__", wider)
    with pytest.raises(InputError, match=r"changed since: decoder.bias of shape \(192,\)"):
        load_bundle(folder, TinyNetwork)


class Parametrised(TinyNetwork):
    """Such layers refuse to be pickled."""

    def __init__(self, latents: int) -> None:
        super().__init__(latents)
        nn.utils.parametrizations.weight_norm(self.decoder)


def test_a_bundle_travels_to_other_processes(bundle: LightBundle) -> None:
    sent = replace(bundle, network=Parametrised(LATENTS).eval())
    again = pickle.loads(ForkingPickler.dumps(sent))
    start = sent.light().starts()
    assert torch.equal(again.light()(start), sent.light()(start))
    assert type(again.network) is Parametrised


class Lacking(SkyNetwork):
    def encode_coded(self, sun: Tensor, coded: Tensor) -> Tensor:
        return sun


class SunFirst(TinyNetwork):
    def encode_coded(self, sun: Tensor, coded: Tensor) -> Tensor:
        return super().encode_coded(sun, coded).roll(5, 1)


class Transposed(TinyNetwork):
    def decode_coded(self, z: Tensor) -> Tensor:
        return super().decode_coded(z).permute(0, 2, 3, 1)


class Squeezed(TinyNetwork):
    def decode_coded(self, z: Tensor) -> Tensor:
        return super().decode_coded(z).squeeze(0)


class NoInverse(TinyNetwork):
    def uncode(self, coded: Tensor) -> Tensor:
        return coded.clamp(min=0).permute(0, 2, 3, 1)


class Turned(TinyNetwork):
    def decode_at_azimuth(
        self, z: Tensor, azimuth_rad: Tensor, sun_spread_rad: float, height: int = 32
    ) -> Tensor:
        return super().decode_at_azimuth(z, azimuth_rad + 1, sun_spread_rad, height)


class HalfReplaced(SplineAutoencoder):
    """The base evaluates its own splines for turned skies."""

    def decode_coded(self, z: Tensor) -> Tensor:
        return 1 + super().decode_coded(z)


class TwoArguments(TinyNetwork):
    def __init__(self, latents: int, width: int) -> None:
        super().__init__(latents)


class OneMore(TinyNetwork):
    def __init__(self, latents: int) -> None:
        super().__init__(latents + 1)


class Failing(TinyNetwork):
    def encode_coded(self, sun: Tensor, coded: Tensor) -> Tensor:
        return self.encoder(coded)


class Detached(TinyNetwork):
    def decode_coded(self, z: Tensor) -> Tensor:
        return super().decode_coded(z.detach())


class Infinite(TinyNetwork):
    def decode_coded(self, z: Tensor) -> Tensor:
        return super().decode_coded(z) / 0


class Frozen(TinyNetwork):
    def __init__(self, latents: int) -> None:
        super().__init__(latents)
        self.requires_grad_(False)


@pytest.mark.parametrize(
    ("network", "said"),
    [
        (Lacking, "lacks decode_coded"),
        (SunFirst, "encode_coded must give latents whose last 5 are `sun`"),
        (Transposed, r"decode_coded must give .* \(2, 3, 32, 128\), got \(2, 32, 128, 3\)"),
        (Squeezed, r"decode_coded must give .* \(1, 3, 32, 128\), got \(3, 32, 128\)"),
        (NoInverse, "uncode is not the inverse"),
        (Turned, "decode_at_azimuth without a turn is not"),
        (HalfReplaced, "decode_at_azimuth without a turn is not"),
        (TwoArguments, "takes the number of latents alone"),
        (OneMore, "does not hand its latents on"),
        (Failing, "encode_coded fails .*shapes cannot be multiplied"),
        (Detached, "no gradient in the latents"),
        (Infinite, "decode_coded gives numbers that are not finite"),
        (Frozen, "no parameters to train"),
    ],
)
def test_what_a_network_must_do(network: type[SkyNetwork], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        check_network(made_network(network, LATENTS))
    assert "\n" not in str(caught.value)


class OfSplines(SplineAutoencoder):
    pass


class OfConvolutions(ConvolutionalAutoencoder):
    """The base folds its own decoder for turned skies, but not another one."""

    def decode_coded(self, z: Tensor) -> Tensor:
        return 1 + super().decode_coded(z)


@pytest.mark.parametrize("network", [TinyNetwork, Tied, OfSplines, OfConvolutions])
def test_what_does_it_passes_and_is_left_as_it_was(network: type[SkyNetwork]) -> None:
    made = made_network(network, LATENTS)
    before = {name: tensor.clone() for name, tensor in made.state_dict().items()}
    state = torch.get_rng_state()
    check_network(made)
    assert made.training
    assert torch.equal(torch.get_rng_state(), state)
    for name, tensor in made.state_dict().items():
        assert torch.equal(tensor, before[name])
