"""The denoising convolutional autoencoder of the thesis (Fig. 5.2), its sun apart.

It paints 32 x 128 pixels of log(1 + L), or of L itself. Its convolutions know columns and rows:
near the zenith, where a row is a small circle, they smear and streak.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from skylight._modes import Derived, full_precision, single
from skylight.errors import check_shape
from skylight.models._network import CENTRE_AZIMUTH_RAD, CODE_LIMIT, HEIGHT, Coding, SkyNetwork
from skylight.models._sun_head import COORDINATES
from skylight.sphere._envmap import shift_columns

LATENT = 64


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

    def phases(self, dtype: torch.dtype | None = None) -> Float[Tensor, "d4 c t u"]:
        """The four small kernels of each output channel, in pixel_shuffle's order."""
        weight = self.reference.conv.weight.to(dtype or self.reference.conv.weight.dtype)
        fold = self.get_buffer("fold").to(weight)
        phases = torch.einsum("ptk,qul,oikl->opqitu", fold, fold, weight)
        phases = phases.reshape(-1, *phases.shape[3:])
        return phases.contiguous(memory_format=torch.channels_last)

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d h2 w2"]:
        x = functional.pad(x, (self.reach, self.reach, 0, 0), mode="circular")
        x = functional.conv2d(x, self.phases(), padding=(self.reach, 0))
        return functional.pixel_shuffle(x, 2)


class ConvolutionalAutoencoder(SkyNetwork):
    """Fig. 5.2: four convolutions with pooling, 64 latents, and the mirror image of it."""

    kind = "convolutions"

    def __init__(self, coding: Coding = "log", *, sun: bool = True) -> None:
        super().__init__(LATENT, coding=coding, sun=sun)
        self._folded: Derived[FoldedDecoder] = Derived()

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

    def code(self, radiance: Float[Tensor, "b h w 3"]) -> Float[Tensor, "b 3 h w"]:
        """Radiance as the network sees it: log(1 + L), or L itself for ``coding="linear"``."""
        planes = radiance.permute(0, 3, 1, 2)
        return torch.log1p(planes) if self.coding == "log" else planes

    def uncode(self, coded: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b h w 3"]:
        planes = coded.clamp(min=0)
        if self.coding == "log":
            planes = torch.expm1(planes.clamp(max=CODE_LIMIT))
        return planes.permute(0, 2, 3, 1)

    def encode_coded(
        self, sun: Float[Tensor, "b s"], coded: Float[Tensor, "b 3 h w"]
    ) -> Float[Tensor, "b z"]:
        return torch.cat([self.to_latent(self.encoder(coded)), sun], 1)

    def decode_coded(self, z: Float[Tensor, "b z"]) -> Float[Tensor, "b 3 h w"]:
        check_shape("latents", z.shape, self.latents)
        x = self.decoder(self.from_latent(z).reshape(-1, 64, 2, 8))
        with full_precision(x):  # eight bits would round the brightness of the sky itself
            return self.output(single(x))

    def decode_at_azimuth(
        self,
        z: Float[Tensor, "b z"],
        azimuth_rad: Float[Tensor, " t"],
        sun_spread_rad: float,
        height: int = HEIGHT,
    ) -> Float[Tensor, "b h w 3"]:
        """:meth:`decode` in evaluation mode, its columns resampled; on more rows pixels are
        repeated, on fewer those of the mean.

        With a spread the sun's lobe is evaluated at its azimuth and only the rest is resampled: a
        sun much sharper than a pixel jumps from one to the next, and a turn by part of a pixel
        blurs it.
        """
        check_shape("latents", z.shape, self.latents)
        decoder = self._folded.of(
            [*self.parameters(), *self.buffers()], lambda: FoldedDecoder.of(self)
        )
        sky = self.uncode(decoder(z))
        turn = (azimuth_rad - CENTRE_AZIMUTH_RAD).expand(z.shape[0])
        if self.sun_head is not None and sun_spread_rad == 0 and height == HEIGHT:
            return shift_columns(sky + self.sun_head.lobe(z[:, -COORDINATES:]), turn)
        sky = shift_columns(sky, turn)
        if height < HEIGHT:
            sky = sky.unflatten(1, (height, -1)).unflatten(3, (4 * height, -1)).mean((2, 4))
        elif height > HEIGHT:
            times = height // HEIGHT
            sky = sky.repeat_interleave(times, 1).repeat_interleave(times, 2)
        if self.sun_head is None:
            return sky
        rows = None if height == HEIGHT else height
        return sky + self.sun_head.lobe(z[:, -COORDINATES:], azimuth_rad, sun_spread_rad, rows)


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
    def of(network: ConvolutionalAutoencoder) -> "FoldedDecoder":
        linear, norm, _ = network.from_latent
        assert isinstance(linear, nn.Linear)
        scale, shift = _affine(norm)
        layers = [(linear.weight * scale[:, None], linear.bias * scale + shift)]
        for up, norm, _ in network.decoder:  # pyright: ignore[reportGeneralTypeIssues]
            scale, shift = (x.repeat_interleave(4) for x in _affine(norm))
            # float64, for TF32 would stay in what is kept
            kernel = up.phases(torch.float64) * scale[:, None, None, None]
            layers.append((kernel.to(shift), shift))
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
        with full_precision(x):
            return functional.conv2d(single(x), *output)


def _affine(norm: nn.Module) -> tuple[Tensor, Tensor]:
    """(scale, shift) of a batch normalisation in evaluation mode."""
    assert isinstance(norm, nn.BatchNorm1d | nn.BatchNorm2d)
    assert norm.running_mean is not None
    assert norm.running_var is not None
    scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    return scale, norm.bias - scale * norm.running_mean
