"""A trained light model as a folder, as training writes it and everything else reads it.

=============================  ==================================================================
``bundle.json``                format version, name, number of training skies, SHA-256 of the
                               training data and of all tensors together; the name of the
                               network's class where it is not skylight's
``network.safetensors``        weights of the :class:`SkyNetwork`
``latent_prior.safetensors``   :class:`GaussianMixture` over whitened latents
``bank.safetensors``           mean and scale of the latents, latents of training skies
``sunsky_prior.safetensors``   :class:`GaussianMixture` over the free parameters of
                               :class:`SunSky` but the azimuth, of the same skies
``card.md``                    the model card
=============================  ==================================================================

The model that comes with skylight is such a folder too. A model of places is one file instead
(:class:`~skylight.models._sphere.Places`). Checkpoints of training are the network's
file alone (:func:`save_network`). The class that a file names is only compared with those that the
user has registered or gives.
"""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

import torch
from jaxtyping import UInt8
from numpy import ndarray
from torch import Tensor

from skylight._modes import constant
from skylight.errors import AssetError, InputError
from skylight.io._bounded import write_json
from skylight.io._files import write_png
from skylight.io._tensors import read_tensors, tensors_sha256, write_tensors
from skylight.models._convolutional import LATENT, ConvolutionalAutoencoder
from skylight.models._manifest import (
    MAKE_ONE,
    MANIFEST,
    BundleManifest,
    places_file,
    read_manifest,
)
from skylight.models._network import Coding, SkyNetwork
from skylight.models._network_check import made_network
from skylight.models._network_names import class_of_file, is_builtin, network_name
from skylight.models._prior import GaussianMixture
from skylight.models._sphere import Places
from skylight.models._splines import SplineAutoencoder
from skylight.models._sun_head import COORDINATES
from skylight.models.autoencoder import AutoencoderLight
from skylight.work._resumable import results_folder

CARD = "card.md"
NETWORK, BANK = "network.safetensors", "bank.safetensors"
LATENT_PRIOR, SUNSKY_PRIOR = "latent_prior.safetensors", "sunsky_prior.safetensors"
SHIPPED = Path(str(files("skylight.models") / "data" / "sky_autoencoder"))
LATENTS_MAX = 1024  # a network has memory for as many before it can refuse its weights
Part = TypeVar("Part")


def network_state(network: SkyNetwork) -> dict[str, Tensor]:
    """The weights as :func:`save_network` writes them.

    Those of splines have half precision: its eleven bits change a sky's radiance by less than
    0.5 %, and the file is half as large.
    """
    state = dict(network.state_dict())
    if own_name(network):  # whose tensors may share memory, as those of a file must not
        return {name: weight.clone() for name, weight in state.items()}
    if isinstance(network, SplineAutoencoder):
        return {name: weight.half() for name, weight in state.items()}
    if network.coding == "linear":
        state["coding_linear"] = torch.ones(1)
    return state


def own_name(network: SkyNetwork) -> str | None:
    """What files call the class of a network that is not skylight's."""
    name = network_name(type(network))
    return None if is_builtin(name) else name


def network_of(
    state: dict[str, Tensor], own: type[SkyNetwork] | None = None, latents: int = 0
) -> SkyNetwork:
    """The network of these tensors, ``own(latents)`` of a user's class.

    KeyError, RuntimeError or ValueError for tensors of no sky's.
    """
    if own is not None:
        return _own_network(state, own, latents)
    weights = {name: weight.float() for name, weight in state.items()}
    named = weights.get("linear.weight", weights.get("to_latent.bias", torch.zeros(LATENT)))
    if named.ndim == 0 or not COORDINATES < named.shape[-1] <= LATENTS_MAX:
        raise ValueError(f"weights of shape {tuple(named.shape)} are of no sky's latents")
    if not all(bool(weight.isfinite().all()) for weight in weights.values()):
        raise ValueError("its weights are not finite")
    if "linear.weight" in weights:
        network = SplineAutoencoder(named.shape[-1])
    else:
        coding: Coding = "linear" if weights.pop("coding_linear", None) is not None else "log"
        sun = len(weights["to_latent.bias"]) < LATENT
        network = ConvolutionalAutoencoder(coding=coding, sun=sun)
    network.load_state_dict(weights)
    return network.eval()


def _own_network(state: dict[str, Tensor], own: type[SkyNetwork], latents: int) -> SkyNetwork:
    if not 0 < latents <= LATENTS_MAX:
        raise ValueError(f"{latents} latents are no sky's")
    network = made_network(own, latents)
    wanted = {name: tuple(each.shape) for name, each in network.state_dict().items()}
    found = {name: tuple(each.shape) for name, each in state.items()}
    for name in sorted(wanted.keys() | found.keys()):
        if wanted.get(name) != found.get(name):
            raise ValueError(
                f"{network_name(own)} has changed since: {name} of shape {found.get(name)} in the "
                f"file, {wanted.get(name)} in the class"
            )
    if not all(bool(each.isfinite().all()) for each in state.values()):
        raise ValueError("its weights are not finite")
    network.load_state_dict(state)
    return network.eval()


def load_network(path: Path, network: type[SkyNetwork] | str | None = None) -> SkyNetwork:
    """The autoencoder of a checkpoint that training wrote (safetensors).

    ``network`` is the class, or its name, where that is not skylight's and not registered: see
    :func:`load_bundle`.
    """
    if not path.is_file():
        raise AssetError(f"{path}: no checkpoint there; train one with train.py CONFIG")
    try:
        state, told = read_tensors(path)
        own = _class_of_file(path, told.get("network"), network)
        return network_of(state, own, int(told.get("latents", 0)))
    except (ValueError, RuntimeError, OSError, KeyError) as error:
        first = str(error).splitlines()[0]
        raise AssetError(
            f"{path}: not a sky autoencoder's checkpoint, or damaged ({first}); "
            "train one with train.py CONFIG"
        ) from error


def save_network(network: SkyNetwork, path: Path) -> None:
    """Write the weights as :func:`load_network` reads them."""
    name = own_name(network)
    told = {} if name is None else {"network": name, "latents": str(network.latents)}
    write_tensors(path, network_state(network), told)


@dataclass(frozen=True, kw_only=True, eq=False)
class LightBundle:
    """A trained :class:`AutoencoderLight` with its priors, and where it comes from.

    ``latents`` holds ``latent_mean``, ``latent_scale``, ``bank`` and ``bank_zenith_rad`` of
    :class:`AutoencoderLight`. ``skies`` is the number of training skies, ``data_sha256`` the hash
    of their index and maps.
    """

    name: str
    skies: int
    data_sha256: str
    network: SkyNetwork
    latent_prior: GaussianMixture
    latents: Mapping[str, Tensor] = field(repr=False)
    sunsky_prior: GaussianMixture

    def light(self, *, sun_spread_rad: float = 0.0) -> AutoencoderLight:
        """A light model with its own copy of everything; see :class:`AutoencoderLight`."""
        return AutoencoderLight(
            copy.deepcopy(self.network),
            **{name: tensor.clone() for name, tensor in self.latents.items()},
            white_centroids=self.latent_prior.means.clone(),
            sun_spread_rad=sun_spread_rad,
        )

    def prior(self) -> GaussianMixture:
        """A copy of the mixture over whitened latents."""
        return copy.deepcopy(self.latent_prior)

    def __getstate__(self) -> dict[str, Any]:
        """For other processes; of a user's network its weights, as not all layers are pickled."""
        network = self.network
        made = (type(network), network.latents, network.state_dict())
        return {**self.__dict__, "network": made if own_name(network) else network}

    def __setstate__(self, state: dict[str, Any]) -> None:
        if isinstance(state["network"], tuple):
            kind, latents, weights = state["network"]
            state = {**state, "network": network_of(weights, kind, latents)}
        self.__dict__.update(state)

    @property
    def fingerprint(self) -> str:
        """SHA-256 over all tensors: equal for models that give equal results."""
        parts = {
            "network": network_state(self.network),
            "prior": self.latent_prior.state_dict(),
            "latents": self.latents,
            "sunsky": self.sunsky_prior.state_dict(),
        }
        tensors = {f"{part}.{n}": t for part, named in parts.items() for n, t in named.items()}
        return tensors_sha256(tensors, {"coding": self.network.coding})

    def save(
        self, folder: Path, *, card: str, pictures: Mapping[str, UInt8[ndarray, "_ _ 3"]]
    ) -> None:
        """Write the folder; ``pictures`` are those that the card shows, by file name.

        A process that is killed meanwhile leaves a folder that :func:`load_bundle` refuses or one
        that is whole: the manifest's hash is that of all tensors.

        Raises
        ------
        OutputError
            The disk does not take it.
        """
        with results_folder(folder) as unfinished:
            save_network(self.network, unfinished / NETWORK)
            self.latent_prior.save(unfinished / LATENT_PRIOR)
            self.sunsky_prior.save(unfinished / SUNSKY_PRIOR)
            write_tensors(unfinished / BANK, self.latents)
            (unfinished / CARD).write_text(card, encoding="utf-8")
            for name, picture in pictures.items():
                write_png(unfinished / name, picture)
            manifest = BundleManifest(
                name=self.name,
                skies=self.skies,
                data_sha256=self.data_sha256,
                fingerprint=self.fingerprint,
                network=own_name(self.network),
            )
            write_json(unfinished / MANIFEST, manifest.entries())


Model = str | Path | LightBundle | Places  # a trained model, or its folder


def load_bundle(
    folder: str | Path | None = None, network: type[SkyNetwork] | str | None = None
) -> LightBundle:
    """The trained light model in ``folder``; by default the one that comes with skylight.

    ``network`` is the class of its network, or ``"module:Class"``, where that is not skylight's
    and not registered (:func:`~skylight.models._network_names.register_network`). The folder's
    name of it is compared, never imported.

    Raises
    ------
    InputError
        The folder is no such model, lacks a part, is damaged or of a newer version; its network
        is of a class that was not given, or of another one.
    AssetError
        The same of the model that comes with skylight.
    """
    if folder is not None:
        return _read(Path(folder), network)
    try:
        # a copy: a network that is moved to a GPU or made trainable must not be another's
        return copy.deepcopy(_shipped(SHIPPED))
    except InputError as error:
        reason = str(error).removesuffix(f"; {MAKE_ONE}")
        raise AssetError(f"{reason}; reinstall skylight") from error


def load_model(model: Model) -> LightBundle | Places:
    """A trained model of skies or of places that is given, or read from its folder.

    Raises
    ------
    InputError
        There is none, or it cannot be used.
    """
    if isinstance(model, LightBundle | Places):
        return model
    file = places_file(Path(model))
    return load_bundle(model) if file is None else Places.load(file)


def is_of_places(model: Model) -> bool:
    """Whether a model is one of places, not of skies."""
    if isinstance(model, LightBundle | Places):
        return isinstance(model, Places)
    return places_file(Path(model)) is not None


def own_model(folder: Path | None, network: str | None) -> Path | LightBundle | None:
    """What the options --model and --network of a command give."""
    if network is None:
        return folder
    if folder is None:
        raise InputError("--network names the class of a model of your own: give --model DIR too")
    return load_bundle(folder, network)


@constant()
def _shipped(folder: Path) -> LightBundle:
    return _read(folder)


def _read(folder: Path, network: type[SkyNetwork] | str | None = None) -> LightBundle:
    manifest = read_manifest(folder)
    own = _class_of_file(folder, manifest.network, network)
    latents = _part(folder / BANK, _latents)
    count = len(latents["latent_mean"])
    bundle = LightBundle(
        name=manifest.name,
        skies=manifest.skies,
        data_sha256=manifest.data_sha256,
        latents=latents,
        latent_prior=_part(folder / LATENT_PRIOR, partial(_latent_prior, count)),
        sunsky_prior=_part(folder / SUNSKY_PRIOR, GaussianMixture.of),
        # last: it takes the longest
        network=_part(folder / NETWORK, partial(_network, count, own)),
    )
    if bundle.fingerprint != manifest.fingerprint:
        raise InputError(
            f"{folder}: its tensors are not those that {MANIFEST} was written for; {MAKE_ONE}"
        )
    return bundle


def _part(path: Path, make: Callable[[dict[str, Tensor]], Part]) -> Part:
    try:
        return make(read_tensors(path)[0])
    except FileNotFoundError as error:
        raise InputError(f"{path.parent}: {path.name} is missing; {MAKE_ONE}") from error
    except (OSError, ValueError, RuntimeError, KeyError, IndexError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(f"{path}: cannot be used ({reason}); {MAKE_ONE}") from error


def _latent_prior(latents: int, tensors: dict[str, Tensor]) -> GaussianMixture:
    mixture = GaussianMixture.of(tensors)
    if mixture.means.shape[1] != latents:
        raise ValueError(f"it is over {mixture.means.shape[1]} numbers, not {latents} latents")
    return mixture


def _class_of_file(
    path: Path, told: str | None, given: type[SkyNetwork] | str | None
) -> type[SkyNetwork] | None:
    try:
        return class_of_file(told, given)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _network(latents: int, own: type[SkyNetwork] | None, tensors: dict[str, Tensor]) -> SkyNetwork:
    network = network_of(tensors, own, latents)
    if network.latents != latents:
        raise ValueError(f"it has {network.latents} latents, not {latents}")
    return network


def _latents(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The tensors; ValueError for any but those that :class:`AutoencoderLight` takes."""
    count, latents = tensors["bank"].shape
    shapes = {
        "latent_mean": (latents,),
        "latent_scale": (latents, latents),
        "bank": (count, latents),
        "bank_zenith_rad": (count,),
    }
    found = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    if found != shapes or count < AutoencoderLight.candidates:
        raise ValueError(f"it holds {found}")
    if not all(t.dtype == torch.float32 and bool(t.isfinite().all()) for t in tensors.values()):
        raise ValueError("its values are no finite float32 numbers")
    scale = tensors["latent_scale"]
    if not torch.equal(scale, scale.tril()) or not bool((scale.diagonal() > 0).all()):
        raise ValueError("latent_scale is no lower triangle with a positive diagonal")
    return tensors
