"""The denoising convolutional autoencoder of the thesis (Fig. 5.2), its sun apart.

It paints 32 x 128 pixels of log(1 + L), or of L itself. Its convolutions know columns and rows:
near the zenith, where a row is a small circle, they smear and streak.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from skylight._modes import Derived, full_precision, on_cpu, single
from skylight._module import Module
from skylight.models._network import Coding, SkyNetwork
from skylight.models._sun_head import COORDINATES

LATENT = 64


class WrapConv(Module):
    """Convolution with wrapped columns (azimuth) and zero rows beyond zenith and horizon."""

    def __init__(self, channels_in: int, channels_out: int, size: int) -> None:
        super().__init__()
        self.pad = size // 2
        self.conv = nn.Conv2d(channels_in, channels_out, size, padding=(self.pad, 0), bias=False)

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d h w"]:
        return self.conv(functional.pad(x, (self.pad, self.pad, 0, 0), mode="circular"))


class UpConv(Module):
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
    """Fig. 5.2: four convolutions with pooling, the latents (64 there), and the mirror image."""

    @on_cpu
    def __init__(self, latents: int = LATENT, *, coding: Coding = "log", sun: bool = True) -> None:
        super().__init__(latents, coding=coding, sun=sun)
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
        self.to_latent = nn.Linear(64 * 2 * 8, latents - COORDINATES * sun)
        self.from_latent = nn.Sequential(
            nn.Linear(latents, 64 * 2 * 8), nn.BatchNorm1d(64 * 2 * 8), nn.ReLU()
        )
        self.decoder = nn.Sequential(up(64, 64, 3), up(64, 96, 3), up(96, 96, 3), up(96, 64, 5))
        self.output = nn.Conv2d(64, 3, 1)

    def encode_coded(
        self, sun: Float[Tensor, "b s"], coded: Float[Tensor, "b 3 h w"]
    ) -> Float[Tensor, "b z"]:
        return torch.cat([self.to_latent(self.encoder(coded)), sun], 1)

    def decode_coded(self, z: Float[Tensor, "b z"]) -> Float[Tensor, "b 3 h w"]:
        self.check_latents(z)
        x = self.decoder(self.from_latent(z).reshape(-1, 64, 2, 8))
        with full_precision(x):  # eight bits would round the brightness of the sky itself
            return self.output(single(x))

    def _decode_in_evaluation(self, z: Float[Tensor, "b z"]) -> Float[Tensor, "b 3 h w"]:
        if type(self).decode_coded is not ConvolutionalAutoencoder.decode_coded:
            return self.decode_coded(z)  # a user's, of which nothing is known
        decoder = self._folded.of(
            [*self.parameters(), *self.buffers()], lambda: FoldedDecoder.of(self)
        )
        return decoder(z)


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
