"""Names of light models on the command line and in results."""

from typing import Literal, get_args

from skylight.errors import InputError

LightName = Literal["auto", "autoencoder", "sunsky", "lamps", "sh9", "sh25"]
# Not "auto": without exposures that takes half of the photographs under an open sky for lamps
DEFAULT_LIGHT: LightName = "autoencoder"
LIGHT_NAMES: tuple[LightName, ...] = get_args(LightName)


def check_light_name(name: str) -> LightName:
    """``name`` where a light model has it; :class:`InputError` names those there are."""
    if name not in LIGHT_NAMES:
        raise InputError(f"unknown light model {name!r}: choose one of {', '.join(LIGHT_NAMES)}")
    return name  # type: ignore[return-value]


def is_trained(light: LightName) -> bool:
    """Whether a light model's folder has anything for this light: a network, or a prior."""
    return light in ("auto", "autoencoder", "sunsky")


def check_is_trained(light: LightName) -> None:
    """:class:`InputError` for a light that takes no model's folder."""
    if not is_trained(light):
        raise InputError(f"{light} has no trained model: leave --model out")
