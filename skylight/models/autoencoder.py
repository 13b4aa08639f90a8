"""The light model over a sky autoencoder's latents."""

import copy
import math

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._modes import full_precision, single
from skylight._module import Module
from skylight.errors import InputError, check_shape
from skylight.models._centring import centred
from skylight.models._network import COARSE_HEIGHTS, HEIGHT, SkyNetwork
from skylight.models._sun_head import COORDINATES
from skylight.sphere._envmap import EnvironmentMap, shift_columns
from skylight.sphere._frame import DirectionGrid, angles_from_direction


class AutoencoderLight(Module):
    """The light model ``L(w) = R(azimuth) f(z)``: z latents and the sun's azimuth, 65 parameters
    for the network's usual 64 latents.

    ``forward`` maps parameters ``(..., z + 1)`` to radiance ``(..., n, 3)`` on the n pixels
    of ``grid``, as the network decodes in evaluation mode. The network's weights are frozen;
    ``requires_grad_(True)`` makes them trainable through the light.

    Its prior is that of the :class:`~skylight.models.LightBundle` which it comes from,
    ``bundle.prior()``, over free parameters without the azimuth::

        bundle = skylight.models.load_bundle()
        light, prior = bundle.light(), bundle.prior()
        prior.log_prob(without_azimuth(light, light.to_free(params)))
        light.from_free(torch.cat([prior.sample(8), azimuth], -1))  # azimuth (8, 1)

    Parameters
    ----------
    network
        A trained autoencoder; it is put into evaluation mode.
    latent_mean, latent_scale
        Mean and lower-triangular Cholesky factor of the latents' covariance, which whiten the
        latents for optimisers.
    bank, bank_zenith_rad
        Latents of training skies and the zenith angles of their suns, from which
        :meth:`starts_towards` takes those whose sun is at the right height.
    white_centroids
        Whitened latents to start an optimisation from.
    sun_spread_rad
        Standard deviation of a Gaussian by which the sun's lobe is blurred. A sun much sharper
        than a pixel jumps from one to the next: in between, the objective is flat, and an
        optimiser stops there, up to 10 degrees from the sun. Half a pixel, 1.4 degrees, is
        smooth, and no face can tell it from a point.
    """

    name = "autoencoder"
    candidates = 6  # starts per direction

    latent_mean: Tensor
    latent_scale: Tensor
    bank: Tensor
    bank_zenith_rad: Tensor
    white_centroids: Tensor

    def __init__(
        self,
        network: SkyNetwork,
        *,
        latent_mean: Float[Tensor, " z"],
        latent_scale: Float[Tensor, "z z"],
        bank: Float[Tensor, "k z"],
        bank_zenith_rad: Float[Tensor, " k"],
        white_centroids: Float[Tensor, "c z"],
        sun_spread_rad: float = 0.0,
    ) -> None:
        super().__init__()
        self.height = HEIGHT
        self.sun_spread_rad = sun_spread_rad
        self.network = network.eval().requires_grad_(False)
        self.latents = network.latents
        self.parameter_count = network.latents + 1
        self.azimuth_index: int | None = network.latents
        self.register_buffer("latent_mean", latent_mean)
        self.register_buffer("latent_scale", latent_scale)
        self.register_buffer("bank", bank)
        self.register_buffer("bank_zenith_rad", bank_zenith_rad)
        self.register_buffer("white_centroids", white_centroids)

    @property
    def grid(self) -> DirectionGrid:
        return DirectionGrid.sky(self.height)

    @property
    def bounds(self) -> tuple[Float[Tensor, " p"], Float[Tensor, " p"]]:
        limit = self.latent_mean.new_full((self.parameter_count,), math.inf)
        return -limit, limit

    def forward(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch n 3"]:
        """``R(azimuth) f(z)``: radiance ``(..., n, 3)`` of latents and azimuth ``(..., z + 1)``.

        Linear Rec.709, relative (mean luminance about 1), in the order of ``grid.directions``.
        Differentiable.

        Raises
        ------
        InputError
            Another number of parameters.
        """
        z, azimuth = self._parts(params)
        sky = self.network.decode_at_azimuth(z, azimuth, self.sun_spread_rad, self.height)
        return sky.reshape(*params.shape[:-1], 4 * self.height**2, 3).to(single(params).dtype)

    def encode(
        self, maps: EnvironmentMap | Float[Tensor, "*batch h w 3"]
    ) -> tuple[Float[Tensor, "*batch p"], Float[Tensor, "*batch"]]:
        """(params, scale) with ``scale * light(params)`` about the maps' skies: the reverse.

        ``scale`` is the mean luminance of a map's upper half, in its units. The sun is where the
        most light within 6 degrees exceeds that round it; the azimuth is its own, to a part of a
        pixel, so that a map that is turned has another azimuth alone. On overcast skies it is
        that of their brightest place. The network is given the sky turned to there.

        Parameters
        ----------
        maps
            Linear Rec.709, full lat-long maps (w = 2h), whose upper halves count, or skies
            (w = 4h), of any height; on any device. Differentiable in their values, but for which
            column of theirs is nearest to the sun.

        Raises
        ------
        InputError
            Tensors of another shape or of integers; negative, infinite or no light above the
            horizon.
        """
        radiance = maps.radiance if isinstance(maps, EnvironmentMap) else maps
        if radiance.dim() < 3 or not radiance.is_floating_point():
            raise InputError(
                f"maps of shape {tuple(radiance.shape)} and {radiance.dtype}: give linear radiance "
                "(..., h, w, 3) in floating point"
            )
        batch = radiance.shape[:-3]
        if batch.numel() == 0:
            return self.bank.new_zeros(*batch, self.parameter_count), self.bank.new_zeros(batch)
        found = centred(radiance.to(self.bank.device).reshape(-1, *radiance.shape[-3:]))
        network = self.network
        with full_precision(radiance):
            sun, rest = network.split(found.skies.to(self.bank))
            rest = shift_columns(rest, -found.beside_rad.to(rest))
            latents = network.encode_coded(sun, network.code(rest))
        params = torch.cat([latents, found.azimuth_rad.to(latents)[:, None]], 1)
        return params.reshape(*batch, -1), found.scale.to(latents).reshape(batch)

    def sun_direction(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch 3"] | None:
        """That of the sun's lobe; None of a network without."""
        head = self.network.sun_head
        if head is None:
            return None
        z, azimuth = self._parts(params)
        sun = head.direction(z[:, -COORDINATES:], azimuth).reshape(*params.shape[:-1], 3)
        return sun.to(single(params).dtype)

    def on_rows(self, height: int) -> "AutoencoderLight":
        """The model on 4, 8, 16 or 32 rows or a multiple of it, its weights shared; the sun keeps
        its spread in pixels."""
        if height % HEIGHT and height not in COARSE_HEIGHTS:
            raise ValueError(
                f"skies have {', '.join(map(str, COARSE_HEIGHTS))} rows, {HEIGHT} or a multiple of "
                f"it, not {height}"
            )
        light = copy.copy(self)
        light.height = height
        light.sun_spread_rad = self.sun_spread_rad * self.height / height
        return light

    def _parts(
        self, params: Float[Tensor, "*batch p"]
    ) -> tuple[Float[Tensor, "b z"], Float[Tensor, " b"]]:
        # in the network's precision, which is a part of what it learnt
        own = self._checked(params).to(self.latent_mean.dtype)
        flat = own.reshape(-1, self.parameter_count)
        return flat[:, :-1], flat[:, -1]

    def _checked(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        what = "AutoencoderLight's parameters"
        names = f"{self.latents} latents, azimuth in rad"
        check_shape(what, params.shape, self.parameter_count, names=names)
        return single(params)

    def to_free(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        """Whitened latents; the azimuth as it is."""
        params = self._checked(params)
        latents, azimuth = params[..., :-1], params[..., -1:]
        centred = (latents - self.latent_mean.to(latents.dtype)).reshape(-1, self.latents)
        scale = self.latent_scale.to(latents.dtype)
        white = torch.linalg.solve_triangular(scale, centred.T, upper=False).T
        return torch.cat([white.reshape(latents.shape), azimuth], -1)

    def from_free(self, free: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        """Inverse of :meth:`to_free`."""
        free = self._checked(free)
        with full_precision(free):
            scale, mean = self.latent_scale.to(free.dtype), self.latent_mean.to(free.dtype)
            latents = free[..., :-1] @ scale.T + mean
        return torch.cat([latents, free[..., -1:]], -1)

    def starts(self) -> Float[Tensor, "s p"]:
        """The centroids, with the sun straight ahead."""
        ahead = self.white_centroids.new_zeros(len(self.white_centroids), 1)
        return self.from_free(torch.cat([self.white_centroids, ahead], 1))

    def starts_towards(self, directions: Float[Tensor, "d 3"]) -> Float[Tensor, "d k p"]:
        """The bank's skies whose suns are nearest to each direction in height, turned there."""
        azimuth, zenith = angles_from_direction(directions.to(self.bank))
        distance = (self.bank_zenith_rad[None] - zenith[:, None]).abs()
        nearest = distance.topk(self.candidates, largest=False).indices
        turn = azimuth[:, None, None].expand(-1, self.candidates, 1)
        return torch.cat([self.bank[nearest], turn], -1)
