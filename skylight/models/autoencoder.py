"""The denoising convolutional autoencoder of outdoor skies (thesis, Fig. 5.2), and its light.

Skies are 32 x 128 upper hemispheres of relative radiance (mean luminance 1) with the sun in the
centre column. The network sees *coded* radiance, log(1 + L): a clear sky spans five orders of
magnitude, and in linear values the L1 loss of the thesis leaves the sun to one pixel's gradient.

With ``sun=True`` the last five of the 64 latents are the sun's own coordinates
(:mod:`sun_head`): the convolutions code the sky without its sun, knowing where and how strong
it is, and decoding adds the sun's lobe. Its height, energy and sharpness then vary smoothly and
independently of the sky, whereas a network that paints the sun on pixels has to be told of every
height that a sun may have.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from skylight.errors import AssetError
from skylight.io.tensors import read_tensors, write_tensors
from skylight.models.sun_head import COORDINATES, SunHead
from skylight.sphere.envmap import shift_columns
from skylight.sphere.frame import angles_from_direction
from skylight.sphere.grid import DirectionGrid
from skylight.work.derived import Derived

LATENT = 64
HEIGHT, WIDTH = 32, 128
# The middle of column 64, where training skies have their sun.
CENTRE_AZIMUTH_RAD = math.pi / WIDTH
# log1p(L) up to here; exp(13) is 20 times the brightest pixel of 440 simulated days
_CODE_LIMIT = 13.0

Coding = Literal["log", "linear"]


class WrapConv(nn.Module):
    """Convolution with wrapped columns (azimuth) and zero rows beyond zenith and horizon."""

    def __init__(self, channels_in: int, channels_out: int, size: int) -> None:
        super().__init__()
        self.pad = size // 2
        self.conv = nn.Conv2d(channels_in, channels_out, size, padding=(self.pad, 0), bias=False)

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d h w"]:
        return self.conv(functional.pad(x, (self.pad, self.pad, 0, 0), mode="circular"))


class UpConv(nn.Module):
    """2x nearest upsampling, then a wrapped convolution, without computing anything twice.

    After nearest upsampling several taps of the kernel read the same source pixel. Summing them
    first gives, for each of the four output phases, one small kernel on the *source* grid: for
    5 x 5 that is 3 x 3, 2.8 times fewer operations and the same result.
    """

    def __init__(self, channels_in: int, channels_out: int, size: int) -> None:
        super().__init__()
        self.reference = WrapConv(channels_in, channels_out, size)
        pad = size // 2
        reach = (pad + 1) // 2
        # fold[phase, t, k] = 1 where tap k of the kernel reads source offset t - reach
        fold = torch.zeros(2, 2 * reach + 1, size)
        for phase in range(2):
            for k in range(size):
                fold[phase, (phase + k - pad) // 2 + reach, k] = 1
        self.register_buffer("fold", fold, persistent=False)
        self.reach = reach

    def phases(self) -> Float[Tensor, "d4 c t u"]:
        """The four small kernels of each output channel, in pixel_shuffle's order."""
        weight = self.reference.conv.weight
        fold = self.get_buffer("fold").to(weight)
        phases = torch.einsum("ptk,qul,oikl->opqitu", fold, fold, weight)
        return phases.reshape(-1, *phases.shape[3:])

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d h2 w2"]:
        x = functional.pad(x, (self.reach, self.reach, 0, 0), mode="circular")
        x = functional.conv2d(x, self.phases(), padding=(self.reach, 0))
        return functional.pixel_shuffle(x, 2)


class SkyAutoencoder(nn.Module):
    """Fig. 5.2: four convolutions with pooling, 64 latents, and the mirror image of it."""

    def __init__(self, coding: Coding = "log", *, sun: bool = True) -> None:
        super().__init__()
        self.coding: Coding = coding
        self.sun_head = SunHead(HEIGHT, CENTRE_AZIMUTH_RAD) if sun else None

        def down(channels_in: int, channels_out: int, size: int) -> nn.Sequential:
            return nn.Sequential(
                WrapConv(channels_in, channels_out, size),
                nn.BatchNorm2d(channels_out),
                nn.ReLU(),
                nn.MaxPool2d(2),
            )

        def up(channels_in: int, channels_out: int, size: int) -> nn.Sequential:
            return nn.Sequential(
                UpConv(channels_in, channels_out, size), nn.BatchNorm2d(channels_out), nn.ReLU()
            )

        self.encoder = nn.Sequential(
            down(3, 64, 5), down(64, 96, 3), down(96, 96, 3), down(96, 64, 3), nn.Flatten()
        )
        self.to_latent = nn.Linear(64 * 2 * 8, LATENT - COORDINATES if sun else LATENT)
        self.from_latent = nn.Sequential(
            nn.Linear(LATENT, 64 * 2 * 8), nn.BatchNorm1d(64 * 2 * 8), nn.ReLU()
        )
        self.decoder = nn.Sequential(up(64, 64, 3), up(64, 96, 3), up(96, 96, 3), up(96, 64, 5))
        self.output = nn.Conv2d(64, 3, 1)

    @property
    def sun(self) -> bool:
        """Whether the sun has coordinates of its own."""
        return self.sun_head is not None

    def code(self, radiance: Float[Tensor, "b h w 3"]) -> Float[Tensor, "b 3 h w"]:
        """Radiance as the network sees it: log(1 + L), or L itself for ``coding="linear"``."""
        planes = radiance.permute(0, 3, 1, 2)
        return torch.log1p(planes) if self.coding == "log" else planes

    def uncode(self, coded: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b h w 3"]:
        """The inverse of :meth:`code`, negative radiance cut to zero."""
        planes = coded.clamp(min=0)
        if self.coding == "log":
            planes = torch.expm1(planes.clamp(max=_CODE_LIMIT))
        return planes.permute(0, 2, 3, 1)

    def split(
        self, radiance: Float[Tensor, "b h w 3"]
    ) -> tuple[Float[Tensor, "b s"], Float[Tensor, "b h w 3"]]:
        """(coordinates of the sun, none without a sun head; what the convolutions see)."""
        if self.sun_head is None:
            return radiance.new_zeros(len(radiance), 0), radiance
        return self.sun_head.split(radiance)

    def encode_coded(
        self, sun: Float[Tensor, "b s"], coded: Float[Tensor, "b 3 h w"]
    ) -> Float[Tensor, "b z"]:
        """Latents of the two parts that :meth:`split` gives, the second one coded."""
        return torch.cat([self.to_latent(self.encoder(coded)), sun], 1)

    def decode_coded(self, z: Float[Tensor, "b z"]) -> Float[Tensor, "b 3 h w"]:
        """Coded radiance, without the sun where it has its own head."""
        x = self.from_latent(z).reshape(-1, 64, 2, 8)
        x = self.decoder(x.contiguous(memory_format=torch.channels_last))
        if torch.is_autocast_enabled(x.device.type):
            # bfloat16's eight bits would round the brightness of the sky itself
            with torch.autocast(x.device.type, enabled=False):
                return self.output(x.float())
        return self.output(x)

    def encode(self, radiance: Float[Tensor, "b h w 3"]) -> Float[Tensor, "b z"]:
        """Latents of skies with the sun in the centre column and mean luminance 1."""
        sun, rest = self.split(radiance)
        return self.encode_coded(sun, self.code(rest))

    def decode(self, z: Float[Tensor, "b z"]) -> Float[Tensor, "b h w 3"]:
        """Relative radiance, >= 0."""
        return self.finish(self.decode_coded(z), z)

    def finish(
        self, coded: Float[Tensor, "b 3 h w"], z: Float[Tensor, "b z"]
    ) -> Float[Tensor, "b h w 3"]:
        """Radiance from what :meth:`decode_coded` gives: uncoded, the sun's lobe added."""
        sky = self.uncode(coded)
        if self.sun_head is None:
            return sky
        return sky + self.sun_head.lobe(z[:, -COORDINATES:])


@dataclass(frozen=True)
class FoldedDecoder:
    """``decode_coded`` of a network in evaluation mode, with less to compute.

    There batch normalisation is an affine map per channel; here it is part of the weights
    before it, and so is the folding of :class:`UpConv`'s kernel. Equal to rounding, and
    differentiable in the network's parameters.

    ``layers`` are (weight, bias) of the fully connected layer, of the four upsampling
    convolutions and of the output.
    """

    layers: tuple[tuple[Tensor, Tensor], ...]

    @staticmethod
    def of(network: SkyAutoencoder) -> "FoldedDecoder":
        linear, norm, _ = network.from_latent
        assert isinstance(linear, nn.Linear)
        scale, shift = _affine(norm)
        layers = [(linear.weight * scale[:, None], linear.bias * scale + shift)]
        for up, norm, _ in network.decoder:  # pyright: ignore[reportGeneralTypeIssues]
            scale, shift = (x.repeat_interleave(4) for x in _affine(norm))
            kernel = up.phases() * scale[:, None, None, None]
            layers.append((kernel.contiguous(memory_format=torch.channels_last), shift))
        assert network.output.bias is not None
        return FoldedDecoder((*layers, (network.output.weight, network.output.bias)))

    def __call__(self, z: Float[Tensor, "b z"]) -> Float[Tensor, "b 3 h w"]:
        first, *phases, output = self.layers
        x = functional.relu(functional.linear(z, *first)).reshape(-1, 64, 2, 8)
        for kernel, bias in phases:
            reach = kernel.shape[2] // 2
            x = functional.pad(x, (reach, reach, 0, 0), mode="circular")
            x = functional.relu(functional.conv2d(x, kernel, bias, padding=(reach, 0)))
            x = functional.pixel_shuffle(x, 2)
        return functional.conv2d(x, *output)


def _affine(norm: nn.Module) -> tuple[Tensor, Tensor]:
    """(scale, shift) of a batch normalisation in evaluation mode."""
    assert isinstance(norm, nn.BatchNorm1d | nn.BatchNorm2d)
    assert norm.running_mean is not None
    assert norm.running_var is not None
    scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    return scale, norm.bias - scale * norm.running_mean


class AutoencoderLight(nn.Module):
    """The light model ``L(w) = R(azimuth) f(z)``: 64 latents and the sun's azimuth, 65 parameters.

    ``forward`` maps parameters ``(..., 65)`` to radiance ``(..., 4096, 3)`` on the 32 x 128 pixels
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
        Standard deviation of a Gaussian by which the sun's lobe is blurred. Above 0 the lobe is
        evaluated at the sun's azimuth and only the rest of the sky is resampled. A sun much
        sharper than a pixel jumps from one to the next, and a rotation by part of a pixel blurs
        it: in between, the objective is flat or has a kink, and an optimiser stops there, up to
        10 degrees from the sun. Half a pixel, 1.4 degrees, is smooth, and no face can tell it
        from a point.
    """

    name = "autoencoder"
    parameter_count = LATENT + 1
    azimuth_index: int | None = LATENT
    candidates = 6  # starts per direction

    latent_mean: Tensor
    latent_scale: Tensor
    bank: Tensor
    bank_zenith_rad: Tensor
    white_centroids: Tensor

    def __init__(
        self,
        network: SkyAutoencoder,
        *,
        latent_mean: Float[Tensor, " z"],
        latent_scale: Float[Tensor, "z z"],
        bank: Float[Tensor, "k z"],
        bank_zenith_rad: Float[Tensor, " k"],
        white_centroids: Float[Tensor, "c z"],
        sun_spread_rad: float = 0.0,
    ) -> None:
        super().__init__()
        self.sun_spread_rad = sun_spread_rad
        self.network = network.eval().requires_grad_(False)
        self._decoder: Derived[FoldedDecoder] = Derived()
        self.register_buffer("latent_mean", latent_mean)
        self.register_buffer("latent_scale", latent_scale)
        self.register_buffer("bank", bank)
        self.register_buffer("bank_zenith_rad", bank_zenith_rad)
        self.register_buffer("white_centroids", white_centroids)

    @property
    def grid(self) -> DirectionGrid:
        return DirectionGrid.sky(HEIGHT)

    @property
    def bounds(self) -> tuple[Float[Tensor, " p"], Float[Tensor, " p"]]:
        limit = torch.full((self.parameter_count,), math.inf)
        return -limit, limit

    def forward(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch n 3"]:
        z, azimuth = params[..., :LATENT].reshape(-1, LATENT), params[..., LATENT].reshape(-1)
        sources = [*self.network.parameters(), *self.network.buffers()]
        decoder = self._decoder.of(sources, lambda: FoldedDecoder.of(self.network))
        head = self.network.sun_head
        if head is None or self.sun_spread_rad == 0:
            sky = self.network.finish(decoder(z), z)
            turned = shift_columns(sky, azimuth - CENTRE_AZIMUTH_RAD)
        else:
            sky = self.network.uncode(decoder(z))
            turned = shift_columns(sky, azimuth - CENTRE_AZIMUTH_RAD)
            turned = turned + head.lobe(z[:, -COORDINATES:], azimuth, self.sun_spread_rad)
        return turned.reshape(*params.shape[:-1], len(self.grid), 3)

    def sun_direction(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch 3"] | None:
        """That of the sun's lobe; None of a network without."""
        head = self.network.sun_head
        if head is None:
            return None
        z, azimuth = params[..., :LATENT].reshape(-1, LATENT), params[..., LATENT].reshape(-1)
        return head.direction(z[:, -COORDINATES:], azimuth).reshape(*params.shape[:-1], 3)

    def to_free(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        """Whitened latents; the azimuth as it is."""
        centred = (params[..., :LATENT] - self.latent_mean).reshape(-1, LATENT)
        white = torch.linalg.solve_triangular(self.latent_scale, centred.T, upper=False).T
        return torch.cat([white.reshape(params[..., :LATENT].shape), params[..., LATENT:]], -1)

    def from_free(self, free: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        """Inverse of :meth:`to_free`."""
        latents = free[..., :LATENT] @ self.latent_scale.T + self.latent_mean
        return torch.cat([latents, free[..., LATENT:]], -1)

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


def network_of(state: dict[str, Tensor]) -> SkyAutoencoder:
    """The network of the tensors that :func:`save_network` wrote.

    Raises
    ------
    KeyError, RuntimeError
        They are of another network.
    """
    weights = dict(state)
    coding: Coding = "linear" if weights.pop("coding_linear", None) is not None else "log"
    network = SkyAutoencoder(coding, sun=len(weights["to_latent.bias"]) < LATENT)
    network.load_state_dict(weights)
    return network.eval()


def load_network(path: Path) -> SkyAutoencoder:
    """The autoencoder of a checkpoint that training wrote (safetensors)."""
    if not path.is_file():
        raise AssetError(f"{path}: no checkpoint there; train one with train.py CONFIG")
    try:
        return network_of(read_tensors(path)[0])
    except (ValueError, RuntimeError, OSError, KeyError) as error:
        first = str(error).splitlines()[0]
        raise AssetError(
            f"{path}: not a sky autoencoder's checkpoint, or damaged ({first}); "
            "train one with train.py CONFIG"
        ) from error


def save_network(network: SkyAutoencoder, path: Path) -> None:
    """Write the weights as :func:`load_network` reads them."""
    state = dict(network.state_dict())
    if network.coding == "linear":
        state["coding_linear"] = torch.ones(1)
    write_tensors(path, state)
