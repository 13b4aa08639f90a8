"""Networks in safetensors files."""

from pathlib import Path

import torch
from torch import Tensor

from skylight.errors import AssetError
from skylight.io.tensors import read_tensors, write_tensors
from skylight.models.networks.base import Coding, SkyNetwork
from skylight.models.networks.convolutional import LATENT, ConvolutionalAutoencoder
from skylight.models.networks.splines import SplineAutoencoder
from skylight.models.networks.sun_head import COORDINATES

LATENTS_MAX = 1024  # a network has memory for as many before it can refuse its weights


def network_state(network: SkyNetwork) -> dict[str, Tensor]:
    """The weights as :func:`save_network` writes them.

    Those of splines have half precision: its eleven bits change a sky's radiance by less than
    0.5 %, and the file is half as large.
    """
    state = dict(network.state_dict())
    if isinstance(network, SplineAutoencoder):
        return {name: weight.half() for name, weight in state.items()}
    if network.coding == "linear":
        state["coding_linear"] = torch.ones(1)
    return state


def network_of(state: dict[str, Tensor]) -> SkyNetwork:
    """The network of the tensors that :func:`save_network` wrote.

    Raises
    ------
    KeyError, RuntimeError, ValueError
        They are of another network.
    """
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
        network = ConvolutionalAutoencoder(coding, sun=sun)
    network.load_state_dict(weights)
    return network.eval()


def load_network(path: Path) -> SkyNetwork:
    """The autoencoder of a checkpoint that training wrote (safetensors)."""
    if not path.is_file():
        raise AssetError(f"{path}: no checkpoint there; train one with train.py CONFIG")
    try:
        return network_of(read_tensors(path)[0])
    except (ValueError, RuntimeError, OSError, KeyError) as error:
        first = str(error).splitlines()[0]
        raise AssetError(
            f"{path}: not a sky autoencoder's checkpoint, or damaged ({first}); "
            "train one with train.py CONFIG"
        ) from error


def save_network(network: SkyNetwork, path: Path) -> None:
    """Write the weights as :func:`load_network` reads them."""
    write_tensors(path, network_state(network))
