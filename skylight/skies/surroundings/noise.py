"""Random fields of a given roughness."""

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.skies.surroundings.draws import Draws


def rough_noise(
    draws: Draws, rows: int, columns: int, roughness: float
) -> Float[Tensor, "b rows columns"]:
    """Periodic noise of mean 0 and variance 1, amplitude ~ frequency^-roughness.

    One row is a profile. Frequencies are counted per ``columns`` in both directions.
    """
    along = torch.fft.rfftfreq(columns, 1 / columns)
    down = torch.fft.fftfreq(rows, 1 / columns)[:, None]
    gain = torch.hypot(along, down).clamp(min=1) ** -roughness
    gain[0, 0] = 0
    twice = torch.full((len(along),), 2.0)  # the other half of the spectrum mirrors this one
    twice[0] = twice[-1] = 1.0
    gain = gain / (gain.square() * twice).sum().div(rows * columns).sqrt()
    white = torch.fft.rfft2(draws.normal(rows, columns))
    return torch.fft.irfft2(white * gain, s=(rows, columns))
