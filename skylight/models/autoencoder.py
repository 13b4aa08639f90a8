"""The light model over a sky autoencoder's latents."""

import copy
import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from skylight._modes import full_precision, single
from skylight.errors import check_shape
from skylight.models._network import COARSE_HEIGHTS, HEIGHT, SkyNetwork
from skylight.models._sun_head import COORDINATES
from skylight.sphere._frame import DirectionGrid, angles_from_direction


class AutoencoderLight(nn.Module):
    """The light model ``L(w) = R(azimuth) f(z)``: z latents and the sun's azimuth, 65 parameters
    for the network's usual 64 latents.

    ``forward`` maps parameters ``(..., z + 1)`` to radiance ``(..., n, 3)`` on the n pixels
    of ``grid``, as the network decodes in evaluation mode. The network's weights are frozen;
    ``requires_grad_(True)`` makes them trainable through the light.

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
        z, azimuth = self._parts(params)
        sky = self.network.decode_at_azimuth(z, azimuth, self.sun_spread_rad, self.height)
        return sky.reshape(*params.shape[:-1], 4 * self.height**2, 3)

    def sun_direction(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch 3"] | None:
        """That of the sun's lobe; None of a network without."""
        head = self.network.sun_head
        if head is None:
            return None
        z, azimuth = self._parts(params)
        return head.direction(z[:, -COORDINATES:], azimuth).reshape(*params.shape[:-1], 3)

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
        check_shape("parameters", params.shape, self.parameter_count)
        flat = single(params).reshape(-1, self.parameter_count)
        return flat[:, :-1], flat[:, -1]

    def to_free(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        """Whitened latents; the azimuth as it is."""
        latents, azimuth = params[..., :-1], params[..., -1:]
        check_shape("parameters", params.shape, self.parameter_count)
        centred = (latents - self.latent_mean).reshape(-1, self.latents)
        white = torch.linalg.solve_triangular(self.latent_scale, centred.T, upper=False).T
        return torch.cat([white.reshape(latents.shape), azimuth], -1)

    def from_free(self, free: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        """Inverse of :meth:`to_free`."""
        check_shape("parameters", free.shape, self.parameter_count)
        with full_precision(free):
            latents = single(free[..., :-1]) @ self.latent_scale.T + self.latent_mean
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
