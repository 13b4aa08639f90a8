"""A small decoder and a small scene, exported once."""

import pytest
import torch
import trimesh

from skylight.models._splines import SplineAutoencoder
from skylight.models.autoencoder import AutoencoderLight
from skylight.relight._export import export_decoder, precompute_scene


@pytest.fixture(scope="session")
def light() -> AutoencoderLight:
    """Random weights, scaled so that skies have contrast, of half precision as those that ship."""
    with torch.random.fork_rng():
        torch.manual_seed(3)
        network = SplineAutoencoder().eval()
    with torch.no_grad():
        network.linear.weight.mul_(2.0)
        network.linear.bias.sub_(0.5)
    network.load_state_dict({k: v.half().float() for k, v in network.state_dict().items()})
    return AutoencoderLight(
        network,
        latent_mean=torch.zeros(64),
        latent_scale=torch.eye(64) * 2,
        bank=torch.zeros(1, 64),
        bank_zenith_rad=torch.zeros(1),
        white_centroids=torch.zeros(1, 64),
    )


@pytest.fixture(scope="session")
def decoder_path(light, tmp_path_factory):
    path = tmp_path_factory.mktemp("decoder") / "sky_decoder.onnx"
    export_decoder(light, path)
    return path


@pytest.fixture(scope="session")
def scene_path(tmp_path_factory):
    """A ball of albedo 0.7 on the ground."""
    path = tmp_path_factory.mktemp("scene") / "ball.npz"
    precompute_scene(trimesh.creation.icosphere(subdivisions=4), path, height=48)
    return path
