"""The network that a run begins with."""

import torch

from skylight.errors import InputError
from skylight.models.networks.base import SkyNetwork
from skylight.models.networks.convolutional import ConvolutionalAutoencoder
from skylight.models.networks.files import load_network
from skylight.models.networks.splines import SplineAutoencoder
from skylight.training.config import AutoencoderConfig


def initial_network(config: AutoencoderConfig) -> SkyNetwork:
    """A network with weights of ``config.seed``, or those of ``config.starts_from``.

    Raises
    ------
    InputError
        The latter are of a network of another kind.
    """
    if config.starts_from:
        network = load_network(config.starts_from)
        found = (network.kind, network.latents, network.coding, network.sun)
        wanted = (config.network, config.latents, config.coding, config.sun)
        if found != wanted:
            told = "network: {}, latents: {}, coding: {}, sun: {}"
            raise InputError(
                f"{config.starts_from}: made with {told.format(*found)}; the configuration says "
                f"{told.format(*wanted)}"
            )
        return network
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        if config.network == "splines":
            return SplineAutoencoder(config.latents)
        return ConvolutionalAutoencoder(config.coding, sun=config.sun)
