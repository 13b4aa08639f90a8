"""Names of light models on the command line and in results."""

from typing import Literal, get_args

from skylight.errors import InputError

LightName = Literal["autoencoder", "sunsky", "sh9", "sh25"]
LIGHT_NAMES: tuple[LightName, ...] = get_args(LightName)


def check_light_name(name: str) -> LightName:
    """``name`` where a light model has it; :class:`InputError` names those there are."""
    if name not in LIGHT_NAMES:
        raise InputError(f"unknown light model {name!r}: choose one of {', '.join(LIGHT_NAMES)}")
    return name  # type: ignore[return-value]
