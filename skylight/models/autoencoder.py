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
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from skylight.errors import AssetError
from skylight.imaging.tensors import read_tensors
from skylight.models.sun_head import COORDINATES, SunHead
from skylight.sphere.envmap import shift_columns
from skylight.sphere.frame import angles_from_direction
from skylight.sphere.grid import DirectionGrid

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


class FrozenDecoder(nn.Module):
    """What ``decode_coded`` of a trained network computes, with less to compute.

    In evaluation batch normalisation is an affine map per channel; here it is part of the weights
    before it, and so is the folding of :class:`UpConv`'s kernel. Equal to rounding.
    """

    def __init__(self, network: SkyAutoencoder) -> None:
        super().__init__()
        linear, norm, _ = network.from_latent
        assert isinstance(linear, nn.Linear)
        assert isinstance(norm, nn.BatchNorm1d)
        scale, shift = _affine(norm)
        self.first = nn.Linear(linear.in_features, linear.out_features)
        self.first.weight.data = linear.weight.detach() * scale[:, None]
        self.first.bias.data = linear.bias.detach() * scale + shift
        self.phases = nn.ModuleList()
        for up, norm, _ in network.decoder:  # pyright: ignore[reportGeneralTypeIssues]
            scale, shift = (x.repeat_interleave(4) for x in _affine(norm))
            kernel = up.phases().detach() * scale[:, None, None, None]
            out, channels, size, _ = kernel.shape
            layer = nn.Conv2d(channels, out, size, padding=(up.reach, 0))
            layer.weight.data = kernel.contiguous(memory_format=torch.channels_last)
            layer.bias.data = shift  # pyright: ignore[reportOptionalMemberAccess]
            self.phases.append(layer)
        self.output = network.output
        self.requires_grad_(False)

    def forward(self, z: Float[Tensor, "b z"]) -> Float[Tensor, "b 3 h w"]:
        x = functional.relu(self.first(z)).reshape(-1, 64, 2, 8)
        x = x.contiguous(memory_format=torch.channels_last)
        for layer in self.phases:
            reach = layer.padding[0]  # pyright: ignore
            x = functional.pad(x, (reach, reach, 0, 0), mode="circular")  # pyright: ignore
            x = functional.pixel_shuffle(functional.relu(layer(x)), 2)
        return self.output(x)


def _affine(norm: nn.BatchNorm1d | nn.BatchNorm2d) -> tuple[Tensor, Tensor]:
    """(scale, shift) of a batch normalisation in evaluation."""
    assert norm.running_mean is not None
    assert norm.running_var is not None
    scale = norm.weight.detach() / torch.sqrt(norm.running_var + norm.eps)
    return scale, norm.bias.detach() - scale * norm.running_mean


class AutoencoderLight(nn.Module):
    """The light model R(azimuth) f(z): 64 latents and the azimuth of the sun, 65 parameters.

    ``latent_mean`` and ``latent_scale`` (lower triangular) whiten the latents for optimisers;
    ``bank`` holds latents of training skies with the zenith angle of their sun, from which
    :meth:`starts_towards` takes those whose sun is at the right height.

    ``sun_spread_rad`` widens the sun's lobe and turns it apart from the sky. A sun much sharper
    than a pixel jumps from one to the next, and a turn by part of a pixel blurs it: between, the
    objective is flat or has a kink, and an optimiser stops there, up to 10 degrees from the sun.
    Half a pixel, 1.4 degrees, is smooth, and no face can tell it from a point.
    """

    name = "autoencoder"
    parameter_count = LATENT + 1
    azimuth_index: int | None = LATENT
    candidates = 6  # starts per direction

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
        self.decoder = FrozenDecoder(self.network)
        self.latent_mean: Tensor
        self.latent_scale: Tensor
        self.bank: Tensor
        self.bank_zenith_rad: Tensor
        self.white_centroids: Tensor
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

    def radiance(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b n 3"]:
        z, azimuth = params[:, :LATENT], params[:, LATENT]
        head = self.network.sun_head
        if head is None or self.sun_spread_rad == 0:
            sky = self.network.finish(self.decoder(z), z)
            return shift_columns(sky, azimuth - CENTRE_AZIMUTH_RAD).flatten(1, 2)
        sky = self.network.uncode(self.decoder(z))
        turned = shift_columns(sky, azimuth - CENTRE_AZIMUTH_RAD)
        lobe = head.lobe(z[:, -COORDINATES:], azimuth, self.sun_spread_rad)
        return (turned + lobe).flatten(1, 2)

    def to_free(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b p"]:
        """Whitened latents; the azimuth as it is."""
        centred = (params[:, :LATENT] - self.latent_mean).T
        white = torch.linalg.solve_triangular(self.latent_scale, centred, upper=False).T
        return torch.cat([white, params[:, LATENT:]], 1)

    def from_free(self, free: Float[Tensor, "b p"]) -> Float[Tensor, "b p"]:
        latents = free[:, :LATENT] @ self.latent_scale.T + self.latent_mean
        return torch.cat([latents, free[:, LATENT:]], 1)

    def starts(self) -> Float[Tensor, "s p"]:
        """The centroids of the mixture, the sun straight ahead."""
        ahead = self.white_centroids.new_zeros(len(self.white_centroids), 1)
        return self.from_free(torch.cat([self.white_centroids, ahead], 1))

    def starts_towards(self, directions: Float[Tensor, "d 3"]) -> Float[Tensor, "d k p"]:
        """The bank's skies whose suns are nearest to each direction in height, turned there."""
        azimuth, zenith = angles_from_direction(directions.to(self.bank))
        distance = (self.bank_zenith_rad[None] - zenith[:, None]).abs()
        nearest = distance.topk(self.candidates, largest=False).indices
        turn = azimuth[:, None, None].expand(-1, self.candidates, 1)
        return torch.cat([self.bank[nearest], turn], -1)


def load_network(path: Path) -> SkyAutoencoder:
    """The autoencoder of a checkpoint that training wrote (safetensors)."""
    if not path.is_file():
        raise AssetError(f"{path}: no checkpoint there; reinstall skylight or train one (train.py)")
    try:
        state, _ = read_tensors(path)
        coding: Coding = "linear" if state.pop("coding_linear", None) is not None else "log"
        network = SkyAutoencoder(coding, sun=len(state["to_latent.bias"]) < LATENT)
        network.load_state_dict(state)
    except (ValueError, RuntimeError, OSError, KeyError) as error:
        first = str(error).splitlines()[0]
        raise AssetError(
            f"{path}: not a sky autoencoder's checkpoint, or damaged ({first}); "
            "reinstall skylight or train one (train.py)"
        ) from error
    return network.eval()
