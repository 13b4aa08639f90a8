"""A user's network is tried on two skies before hours of training: what does not fit is told."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.models._network import CENTRE_AZIMUTH_RAD, HEIGHT, WIDTH, SkyNetwork
from skylight.models._network_names import network_name, require_network
from skylight.models._sun_head import COORDINATES

_TOLERANCE = 0.01  # relative, above a radiance of 0.1: rounding is far below, other formulas above


def made_network(network: type[SkyNetwork], latents: int) -> SkyNetwork:
    """``network(latents)``; :class:`InputError` where that is not how it is made."""
    require_network(network)
    try:
        made = network(latents)
    except Exception as error:
        raise InputError(
            f"{network_name(network)}({latents}) cannot be made ({_told(error)}): a network takes "
            "the number of latents alone"
        ) from error
    if getattr(made, "latents", None) != latents:
        raise InputError(
            f"{network_name(network)}({latents}) does not hand its latents on to "
            "SkyNetwork.__init__"
        )
    return made


def example_skies() -> Float[Tensor, "2 h w 3"]:
    """A grey sky, and one with a gradient and a sun."""
    rows = torch.linspace(1.5, 0.3, HEIGHT)[:, None, None] * torch.tensor([0.7, 1.0, 1.5])
    skies = torch.stack([torch.ones(HEIGHT, WIDTH, 3), rows.expand(HEIGHT, WIDTH, 3)])
    skies[1, HEIGHT // 2, WIDTH // 2] = 2000.0
    return skies


def check_network(network: SkyNetwork) -> None:
    """:class:`InputError` unless it does what :class:`SkyNetwork` asks of a user's class.

    Shapes of all members, for one sky and two; that values are finite, ``uncode`` undoes ``code``,
    latents end with the sun's coordinates, radiance is at least 0, ``decode_at_azimuth`` without a
    turn is ``decode``, and that decoding has a gradient.
    """
    name, latents = network_name(type(network)), network.latents
    if not any(each.requires_grad for each in network.parameters()):
        raise InputError(f"{name} has no parameters to train")
    trains = network.training
    network.eval()
    # members may draw numbers, which must change nobody else's
    with torch.random.fork_rng(devices=[]), torch.no_grad():
        for count in (2, 1):
            _check_count(network, name, example_skies()[-count:])
        z = torch.zeros(2, latents).requires_grad_()
        with torch.enable_grad():
            coded = _tried(f"{name}.decode_coded", (2, 3, HEIGHT, WIDTH), network.decode_coded, z)
            (gradient,) = (
                torch.autograd.grad(coded.sum(), z, allow_unused=True)
                if coded.requires_grad
                else (None,)
            )
        if gradient is None:
            raise InputError(f"{name}.decode_coded has no gradient in the latents")
    network.train(trains)


def _check_count(network: SkyNetwork, name: str, skies: Float[Tensor, "b h w 3"]) -> None:
    count = len(skies)
    planes, maps = (count, 3, HEIGHT, WIDTH), (count, HEIGHT, WIDTH, 3)
    sun, rest = network.split(skies)
    coded = _tried(f"{name}.code", planes, network.code, rest)
    again = _tried(f"{name}.uncode", maps, network.uncode, coded)
    if _differ(again, rest):
        raise InputError(f"{name}.uncode is not the inverse of its code")
    z = _tried(f"{name}.encode_coded", (count, network.latents), network.encode_coded, sun, coded)
    if network.sun and not torch.allclose(z[:, -COORDINATES:], sun.to(z)):
        raise InputError(
            f"{name}.encode_coded must give latents whose last {COORDINATES} are `sun`, unchanged: "
            "torch.cat([..., sun], 1)"
        )
    _tried(f"{name}.decode_coded", planes, network.decode_coded, z)
    sky = _tried(f"{name}.decode", maps, network.decode, z)
    if bool((sky < 0).any()):
        raise InputError(f"{name}.uncode gives negative radiance")
    ahead = torch.full((1,), CENTRE_AZIMUTH_RAD)
    for height in (HEIGHT, HEIGHT // 4, 2 * HEIGHT):

        def turned(z: Tensor, height: int = height) -> Tensor:
            return network.decode_at_azimuth(z, ahead, 0.0, height)

        found = _tried(f"{name}.decode_at_azimuth", (count, height, 4 * height, 3), turned, z)
        if height == HEIGHT and _differ(found, sky):
            raise InputError(
                f"{name}.decode_at_azimuth without a turn is not {name}.decode: define both alike"
            )


def _tried(
    what: str, shape: tuple[int, ...], member: Callable[..., Tensor], *arguments: Tensor
) -> Tensor:
    """What the member gives, if it is finite and of that shape."""
    try:
        found = member(*arguments)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{what} fails ({_told(error)})") from error
    if not isinstance(found, Tensor) or tuple(found.shape) != shape:
        got = tuple(found.shape) if isinstance(found, Tensor) else type(found).__name__
        raise InputError(f"{what} must give a tensor of shape {shape}, got {got}")
    if not bool(found.isfinite().all()):
        raise InputError(f"{what} gives numbers that are not finite")
    return found


def _differ(found: Tensor, wanted: Tensor) -> bool:
    return not float(((found - wanted).abs() / wanted.abs().clamp(min=0.1)).max()) <= _TOLERANCE


def _told(error: Exception) -> str:
    return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
