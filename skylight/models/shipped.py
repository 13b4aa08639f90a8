"""The trained models that come with the package, loaded once a process."""

from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Literal, get_args

from skylight.errors import AssetError, InputError
from skylight.imaging.tensors import read_tensors
from skylight.models.autoencoder import AutoencoderLight, load_network
from skylight.models.prior import GaussianMixture
from skylight.models.sunsky import SunSky

LightName = Literal["autoencoder", "sunsky", "sh9", "sh25"]
LIGHT_NAMES: tuple[LightName, ...] = get_args(LightName)
CHECKPOINT, BANK = "sky_autoencoder.safetensors", "sky_bank.safetensors"


def data_folder() -> Path:
    """Where the package's model files lie."""
    return Path(str(files("skylight.models") / "data"))


@cache
def autoencoder_light(
    checkpoint: Path | None = None, *, sun_spread_rad: float = 0.0
) -> AutoencoderLight:
    """The sky autoencoder as a light model; ``checkpoint`` replaces the shipped network.

    ``sun_spread_rad`` is :class:`AutoencoderLight`'s.

    Another network has other latents: give it its own bank and prior in the same folder.
    """
    folder = data_folder() if checkpoint is None else checkpoint.parent
    network = load_network(folder / CHECKPOINT if checkpoint is None else checkpoint)
    bank_path = folder / BANK
    try:
        bank, _ = read_tensors(bank_path)
        prior = latent_prior(folder)
        return AutoencoderLight(
            network,
            latent_mean=bank["latent_mean"],
            latent_scale=bank["latent_scale"],
            bank=bank["bank"],
            bank_zenith_rad=bank["bank_zenith_rad"],
            white_centroids=prior.means.float(),
            sun_spread_rad=sun_spread_rad,
        )
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise AssetError(
            f"{bank_path}: the latents' bank is missing or damaged ({error}); "
            "reinstall skylight, or fit one with train.py configs/sky_prior.yaml"
        ) from error


@cache
def latent_prior(folder: Path | None = None) -> GaussianMixture:
    """Mixture over whitened latents."""
    return GaussianMixture.load((folder or data_folder()) / "latent_prior.safetensors").float()


@cache
def sunsky_light() -> SunSky:
    return SunSky()


@cache
def sunsky_prior() -> GaussianMixture:
    """Mixture over the free parameters of Sun+Sky, the azimuth left out."""
    return GaussianMixture.load(data_folder() / "sunsky_prior.safetensors").float()


def check_light_name(name: str) -> LightName:
    if name not in LIGHT_NAMES:
        raise InputError(f"unknown light model {name!r}: choose one of {', '.join(LIGHT_NAMES)}")
    return name  # type: ignore[return-value]
