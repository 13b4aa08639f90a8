"""Networks by name: skylight's two, those that a user registers, and ``module:Class``.

A file names the class of its network. Reading compares that name with the classes that the user
has registered or gives, and imports nothing: a file must not choose which code runs.
"""

import importlib
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, overload

from skylight.errors import InputError
from skylight.models._convolutional import ConvolutionalAutoencoder
from skylight.models._network import SkyNetwork
from skylight.models._splines import SplineAutoencoder

Network = TypeVar("Network", bound=type[SkyNetwork])
BUILTIN: dict[str, type[SkyNetwork]] = {
    "splines": SplineAutoencoder,
    "convolutions": ConvolutionalAutoencoder,
}
_registered = dict(BUILTIN)


@overload
def register_network(name: str, network: Network) -> Network: ...
@overload
def register_network(name: str) -> Callable[[Network], Network]: ...
def register_network(
    name: str, network: Network | None = None
) -> Network | Callable[[Network], Network]:
    """Let configurations and files call a class of yours by ``name``; returns the class.

    ``@register_network("mine")`` above the class does the same. Commands, which run none of your
    code but what ``--network module:Class`` names, take the class by that.

    Raises
    ------
    InputError
        A name that another class has, or with a colon; a class that is no :class:`SkyNetwork` or
        lacks one of its abstract members.
    """
    if network is None:
        return lambda decorated: register_network(name, decorated)
    require_network(network)
    if not re.fullmatch(r"[\w.-]+", name):
        raise InputError(f"{name!r} is no name for a network: take letters, digits, _, - and .")
    other = _registered.get(name, network)
    if _place(other) != _place(network):  # a cell that is run again may register its class anew
        raise InputError(f"the name {name} is that of {_place(other)}: choose another")
    _registered[name] = network
    return network


def network_class(named: str | type[SkyNetwork]) -> type[SkyNetwork]:
    """The class that a user gives: itself, by its registered name, or as ``module:Class``.

    A module is looked for in the current folder first, as ``python -m`` does.
    """
    if not isinstance(named, str):
        return require_network(named)
    check_network_name(named)
    return require_network(_registered.get(named) or _imported(named), named)


def check_network_name(name: str) -> None:
    """:class:`InputError` for what is neither a registered name nor ``module:Class``."""
    if name not in _registered and not re.fullmatch(r"[^:]+:[^:]+", name):
        raise InputError(
            f"unknown network {name!r}: choose one of {', '.join(_registered)}, or give a class "
            "of your own as module:Class (registered ones: skylight.models.register_network)"
        )


def require_network(found: object, named: str | None = None) -> type[SkyNetwork]:
    """It; :class:`InputError` for what is no class of a network, or lacks members."""
    if not (isinstance(found, type) and issubclass(found, SkyNetwork)):
        named = named or getattr(found, "__qualname__", repr(found))
        raise InputError(f"{named} is no class derived from skylight.models.SkyNetwork")
    if lacking := sorted(found.__abstractmethods__):
        raise InputError(
            f"{network_name(found)} lacks {' and '.join(lacking)}: define what "
            "skylight.models.SkyNetwork asks for"
        )
    return found


def network_name(network: type[SkyNetwork]) -> str:
    """What files call it: its registered name, or its place."""
    names = (name for name, each in _registered.items() if each is network)
    return next(names, _place(network))


def network_option(network: type[SkyNetwork]) -> str:
    """What commands are given for it, behind a blank; nothing for one of skylight's networks."""
    return "" if network in BUILTIN.values() else f" --network {_place(network)}"


def is_builtin(name: str) -> bool:
    """Whether that is the name of one of skylight's networks."""
    return name in BUILTIN


def class_of_file(
    told: str | None, given: str | type[SkyNetwork] | None
) -> type[SkyNetwork] | None:
    """The user's class where a file tells the name of one, None for skylight's networks.

    ``given`` is what the user said, if anything. Only names are compared.
    """
    found = None if given is None else network_class(given)
    if told is None:
        if found is None or found in BUILTIN.values():
            return None
        raise InputError(
            f"its network is one of skylight's, not {network_name(found)}: leave --network out"
        )
    option = f"--network {told}"
    if ":" not in told:  # a class in another process has that name only where its module says so
        option = f"--network module:Class, where @register_network('{told}') stands above the class"
    if found is None:
        for network in _registered.values():
            if told in _names(network):
                return network
        raise InputError(
            f"its network is {told}, a class that is not skylight's: give {option} "
            f"(in Python network= or skylight.models.register_network)"
        )
    if told not in _names(found):
        raise InputError(f"its network is {told}, not {network_name(found)}: give {option}")
    return found


def is_importable(network: type[SkyNetwork]) -> bool:
    """Whether other processes find it: not so what a notebook or a function defines."""
    found: object = sys.modules.get(network.__module__)
    if (
        network.__module__ == "__main__"
        and not Path(getattr(found, "__file__", None) or "").is_file()
    ):
        return False
    for part in network.__qualname__.split("."):
        found = getattr(found, part, None)
    return found is network


def _names(network: type[SkyNetwork]) -> set[str]:
    return {name for name, each in _registered.items() if each is network} | {_place(network)}


def _place(network: type[SkyNetwork]) -> str:
    """``module:Class``; of a script the name that others import it by."""
    module = network.__module__
    if module in ("__main__", "__mp_main__"):
        main = sys.modules["__main__"]
        spec, file = getattr(main, "__spec__", None), getattr(main, "__file__", None)
        module = spec.name if spec else Path(file).stem if file else module
    return f"{module}:{network.__qualname__}"


def _imported(name: str) -> object:
    module, _, inner = name.partition(":")
    if module.endswith(".py") or "/" in module:
        raise InputError(f"{name}: name the module as Python does, {Path(module).stem}:{inner}")
    if os.getcwd() not in sys.path and "" not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        found: object = importlib.import_module(module)
        for part in inner.split("."):
            found = getattr(found, part)
    except AttributeError as error:
        raise InputError(f"{name} cannot be imported: {error}") from error
    except (Exception, SystemExit) as error:  # it may do anything
        raise InputError(
            f"{name} cannot be imported ({type(error).__name__}: {error}): run the command in the "
            f"folder of {module.partition('.')[0]}.py, or install its package"
        ) from error
    return found
