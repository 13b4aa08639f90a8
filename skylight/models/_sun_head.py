"""The sun of a sky map as five explicit parameters.

A sun is a lobe ``E exp(kappa (<s, w> - 1))`` with an energy of exactly E over the map's pixels, at
the azimuth of the centre column. Its coordinates u are unbounded and of about unit spread over
outdoor skies::

    zenith angle = pi/2 sigmoid(1.5 u0)
    E (RGB)      = exp(2 u1 - 1), exp(2 u2 - 1), exp(2 u3 - 1)
    kappa        = 200 (30000 / 200)^sigmoid(u4)        (4 degrees .. 0.3 degrees)

What is broader belongs to the sky, and so do a broad lobe's tails beyond six degrees (a fifth of
the energy at kappa = 400, half at 200). The height of a sun that is found in a map is off by
half a row at most; if it is narrower than a pixel, up to 30 % of its energy is then in the pixel
beside.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._modes import constant, on_cpu, single
from skylight._module import Module
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import DirectionGrid, direction_from_angles, squared_chords

COORDINATES = 5
KAPPA_BOUNDS = (200.0, 30000.0)
NEAR_RAD, RING_RAD = math.radians(6.0), math.radians(10.0)
_LEAST_ENERGY = 1e-3  # of a sky of mean luminance 1: no sun
_COLUMNS_ASIDE = 2  # the brightest pixel is looked for so near the centre column


class SunHead(Module):
    """Suns on (height, 4 height) pixels of the upper hemisphere, all at one azimuth."""

    directions: Tensor
    solid_angles: Tensor

    @on_cpu
    def __init__(self, height: int, azimuth_rad: float) -> None:
        super().__init__()
        self.height, self.azimuth_rad = height, azimuth_rad
        grid = DirectionGrid.sky(height)
        self.register_buffer("directions", grid.directions, persistent=False)
        self.register_buffer("solid_angles", grid.solid_angles, persistent=False)
        width = 4 * height
        middle = round(azimuth_rad / (2 * math.pi) * width + (width - 1) / 2)
        offset = (torch.arange(width) - middle + width // 2) % width - width // 2
        aside = (offset.abs() > _COLUMNS_ASIDE).repeat(height)
        self.aside: Tensor
        self.register_buffer("aside", aside, persistent=False)

    def lobe(
        self,
        coordinates: Float[Tensor, "b 5"],
        azimuth_rad: Float[Tensor, " t"] | None = None,
        spread_rad: float = 0.0,
        height: int | None = None,
    ) -> Float[Tensor, "b h w 3"]:
        """Radiance of the suns alone, at the map's centre or at azimuths of their own.

        ``spread_rad`` is added to the lobe's width: 1 / kappa + spread^2 for 1 / kappa. ``height``
        is that of other maps than the head's.
        """
        directions, solid_angles = self.directions, self.solid_angles
        if height is not None:
            directions, solid_angles = _pixels(height, coordinates.device).split((3, 1), 1)
        zenith, energy, kappa = _parameters(coordinates)
        kappa = 1 / (1 / kappa + spread_rad**2)
        if azimuth_rad is None:
            azimuth_rad = torch.full_like(zenith, self.azimuth_rad)
        azimuth_rad = azimuth_rad.expand_as(zenith)  # of one for all
        sun = direction_from_angles(azimuth_rad, zenith)
        exponent = -0.5 * kappa[:, None] * squared_chords(sun, directions.to(sun.dtype))
        weight = solid_angles.flatten().log().to(sun.dtype)
        total = torch.logsumexp(exponent + weight, 1, keepdim=True)
        radiance = (exponent - total).exp()[:, None] * energy[..., None]
        return radiance.unflatten(2, (height or self.height, -1)).permute(0, 2, 3, 1)

    def direction(
        self, coordinates: Float[Tensor, "b 5"], azimuth_rad: Float[Tensor, " b"]
    ) -> Float[Tensor, "b 3"]:
        """Of the suns at those azimuths."""
        return direction_from_angles(azimuth_rad, _parameters(coordinates)[0])

    def split(
        self, skies: Float[Tensor, "b h w 3"]
    ) -> tuple[Float[Tensor, "b 5"], Float[Tensor, "b h w 3"]]:
        """(coordinates of the sun, the skies without it).

        Light within 6 degrees of the brightest place about the suns' azimuth that exceeds the
        mean of the ring from 6 to 10 degrees counts as the sun and is replaced by that mean.
        Its energy is kept (and counted as 0.001 at least, in each colour), its height is that of
        its centroid and its sharpness that of the nearest lobe there.
        """
        # float64: near-ties must not fall one way in a batch and another way alone
        flat = skies.flatten(1, 2).double()
        directions, solid = self.directions.double(), self.solid_angles.double()
        peak = directions[luminance(flat).masked_fill(self.aside, -math.inf).argmax(1)]
        cosine = peak @ directions.T
        near = (cosine > math.cos(NEAR_RAD)).to(flat)
        ring = (cosine > math.cos(RING_RAD)).to(flat) - near
        level = torch.einsum("bn,bnc->bc", ring * solid, flat) / (ring @ solid)[:, None]
        excess = (flat - level[:, None]).clamp(min=0) * near[..., None]
        energy = torch.einsum("n,bnc->bc", solid, excess)
        light = luminance(excess) * solid
        zenith, kappa = _fit_lobe(light, directions, solid, peak, self.azimuth_rad)
        coordinates = _coordinates(zenith, energy, kappa)
        return coordinates.to(skies), (flat - excess).reshape(skies.shape).to(skies)


@constant(4)
def _pixels(height: int, device: torch.device) -> Float[Tensor, "n 4"]:
    """Directions and solid angles of a sky of so many rows."""
    grid = DirectionGrid.sky(height)
    return torch.cat([grid.directions, grid.solid_angles[:, None]], 1).to(device)


def _fit_lobe(
    energy: Float[Tensor, "b n"],
    directions: Float[Tensor, "n 3"],
    solid: Float[Tensor, " n"],
    peak: Float[Tensor, "b 3"],
    azimuth_rad: float,
) -> tuple[Float[Tensor, " b"], Float[Tensor, " b"]]:
    """(zenith angle, kappa) of the lobe at the centroid of the energies of pixels.

    Its kappa is the one whose energies per pixel are nearest in L1, by search; only the 64 pixels
    nearest to ``peak`` are looked at.
    """
    # of equally near pixels the first, whatever rounding says
    order = 1e-9 * torch.arange(len(directions), device=peak.device)
    near = (peak @ directions.T - order).topk(_WINDOW).indices
    energy = energy.gather(1, near)
    total = energy.sum(1, keepdim=True)
    # without any excess anywhere near the peak will do
    weight = torch.where(total > 1e-9, energy, solid[near])
    weight = weight / weight.sum(1, keepdim=True)
    centroid = torch.einsum("bn,bnc->bc", weight, directions[near])
    angles = (centroid.new_full((), angle) for angle in (azimuth_rad, math.pi / 2))
    level = direction_from_angles(*angles)
    height = torch.atan2(centroid @ level, centroid[:, 1]).clamp(1e-3, math.pi / 2 - 1e-3)
    sun = direction_from_angles(torch.full_like(height, azimuth_rad), height)
    away = torch.einsum("bc,bnc->bn", sun, directions[near]) - 1
    low, high = (math.log(k) for k in KAPPA_BOUNDS)
    sharp = torch.linspace(low, high, _SHARPNESSES, dtype=height.dtype, device=height.device)
    lobe = sharp.exp()[:, None] * away[:, None] + solid[near].log()[:, None]
    error = (lobe.softmax(-1) - weight[:, None]).abs().sum(-1)
    return height, sharp[error.argmin(1)].exp()


_WINDOW = 64
_SHARPNESSES = 61  # log kappa, in steps of 0.08


def _parameters(
    coordinates: Float[Tensor, "b 5"],
) -> tuple[Float[Tensor, " b"], Float[Tensor, "b 3"], Float[Tensor, " b"]]:
    coordinates = single(coordinates)
    zenith = math.pi / 2 * torch.sigmoid(1.5 * coordinates[:, 0])
    # a line search may try anything: e^12 is absurd but finite
    energy = torch.exp((2 * coordinates[:, 1:4] - 1).clamp(max=12))
    low, high = (math.log(k) for k in KAPPA_BOUNDS)
    kappa = torch.exp(low + (high - low) * torch.sigmoid(coordinates[:, 4]))
    return zenith, energy, kappa


def _coordinates(
    zenith: Float[Tensor, " b"], energy: Float[Tensor, "b 3"], kappa: Float[Tensor, " b"]
) -> Float[Tensor, "b 5"]:
    low, high = (math.log(k) for k in KAPPA_BOUNDS)
    return torch.cat(
        [
            torch.logit(zenith / (math.pi / 2), eps=1e-3)[:, None] / 1.5,
            (energy.clamp(min=_LEAST_ENERGY).log() + 1) / 2,
            torch.logit((kappa.log() - low) / (high - low), eps=0.02)[:, None],
        ],
        1,
    )
