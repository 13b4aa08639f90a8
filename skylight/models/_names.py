"""Names of light models on the command line and in results."""

from typing import Literal, get_args

from skylight.errors import InputError

LightName = Literal["auto", "autoencoder", "sunsky", "lamps", "sh9", "sh25"]
# Not "auto": without exposures that takes half of the photographs under an open sky for lamps
DEFAULT_LIGHT: LightName = "autoencoder"
LIGHT_NAMES: tuple[LightName, ...] = get_args(LightName)
# Skies above a ground ("auto" may choose one)
SKY_LIGHTS: tuple[LightName, ...] = ("auto", "autoencoder", "sunsky")

# Of skies: from where a scan finds the sun, or as in the thesis, B.1
SolverName = Literal["scan", "thesis"]
DEFAULT_SOLVER: SolverName = "scan"
SOLVER_NAMES: tuple[SolverName, ...] = get_args(SolverName)


def check_light_name(name: str) -> LightName:
    """``name`` where a light model has it; :class:`InputError` names those there are."""
    if name not in LIGHT_NAMES:
        raise InputError(f"unknown light model {name!r}: choose one of {', '.join(LIGHT_NAMES)}")
    return name  # type: ignore[return-value]


def check_solver_name(name: str, light: LightName) -> SolverName:
    """``name`` where it searches for that light; :class:`InputError` names those that do."""
    if name not in SOLVER_NAMES:
        raise InputError(f"unknown solver {name!r}: choose one of {', '.join(SOLVER_NAMES)}")
    if name != DEFAULT_SOLVER and light != "autoencoder":
        raise InputError(f"the solver {name} is for the light autoencoder, not for {light}")
    return name  # type: ignore[return-value]


def is_trained(light: LightName) -> bool:
    """Whether a light model's folder has anything for this light: a network, or a prior."""
    return light in SKY_LIGHTS


def check_is_trained(light: LightName) -> None:
    """:class:`InputError` for a light that takes no model's folder."""
    if not is_trained(light):
        raise InputError(f"{light} has no trained model: leave --model out")
