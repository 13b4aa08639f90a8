"""A procedural cloud layer: it hides the sun where it is thick and glows where it is thin.

The layer is a thin sheet at one height whose vertical optical depth tau varies like fractal
noise. Along a view ray it behaves as a plane-parallel slab: sunlight scattered once by a
two-lobe phase function (exact for a slab), everything scattered more often by the two-stream
diffuse transmittance, spread over the sky like the CIE overcast sky, (1 + 2 sin h) / 3. That
transmittance holds the light scattered once as well, so thin and middling cloud (tau up to about
10) sends down up to 40 % more diffuse light than a two-stream slab.
The sheet has no sides and casts no shadow on itself but through the depth of the neighbouring
sheet in the sun's direction: cumulus towers are out of its reach.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.skies.atmosphere import EARTH_RADIUS_KM, henyey_greenstein

CLOUD_G = 0.85  # asymmetry of water droplets in visible light (Liou 2002, table 4.4)


@dataclass(frozen=True, kw_only=True)
class CloudLayer:
    """``coverage`` is the fraction of the sky with tau > 0; ``depth`` its typical tau."""

    coverage: float
    depth: float
    height_km: float = 2.0
    cell_km: float = 3.0
    softness: float = 0.15
    seed: int = 0


def optical_depth(
    layer: CloudLayer,
    directions: Float[Tensor, "n 3"],
    drift_km: tuple[float, float],
    change: float,
    footprint_rad: float,
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """(vertical tau, cosine of incidence on the layer) where each direction meets the layer.

    ``drift_km`` moves the layer, ``change`` is the noise's third coordinate (time).
    Octaves finer than ``footprint_rad`` seen from the observer fade out instead of aliasing.
    """
    mu = directions[:, 1].clamp(min=1e-3)
    inner, outer = EARTH_RADIUS_KM, EARTH_RADIUS_KM + layer.height_km
    distance = torch.sqrt((inner * mu) ** 2 + outer**2 - inner**2) - inner * mu
    incidence = (outer**2 + distance**2 - inner**2) / (2 * outer * distance)
    x = (directions[:, 0] * distance + drift_km[0]) / layer.cell_km
    z = (directions[:, 2] * distance + drift_km[1]) / layer.cell_km
    footprint = footprint_rad * distance / incidence.clamp(min=0.05) / layer.cell_km
    noise = _fractal_noise(x, z, change, footprint, layer.seed)
    # noise is close to normal with mean 0 and deviation 1: coverage picks its quantile
    quantile = math.sqrt(2) * torch.erfinv(torch.tensor(1 - 2 * layer.coverage)).item()
    above = (noise - quantile) / layer.softness
    # 1 - exp(-x) rises at once at an edge and levels off; the noise also varies the inside
    body = -torch.expm1(-above.clamp(min=0) * 0.35) * (1 + 0.35 * noise).clamp(min=0.15)
    return layer.depth * body, incidence


def cloud_light(
    tau: Float[Tensor, " n"],
    tau_sunward: Float[Tensor, " n"],
    incidence: Float[Tensor, " n"],
    directions: Float[Tensor, "n 3"],
    sun: Float[Tensor, "3"],
    sun_irradiance: Float[Tensor, "3"],
    sky_irradiance: Float[Tensor, "3"],
) -> tuple[Float[Tensor, " n"], Float[Tensor, "n 3"]]:
    """(transmittance of what lies behind, radiance of the cloud itself) per direction.

    The transmittance counts light scattered into the forward peak as not scattered, which is
    right for a smooth background; for the sun's disc see :func:`unscattered`.

    Scattered once, with u the part of the view path from the cloud's base:
    E P(angle) int_0^1 t_v exp(-t_v u) exp(-t_s (1 - u)) du
    = E P t_v (exp(-t_s) - exp(-t_v)) / (t_v - t_s).
    """
    mu_sun = sun[1].clamp(min=0.03)
    # delta scaling: half of the forward peak counts as not scattered at all (Joseph et al. 1976)
    forward = CLOUD_G**2
    view = (1 - forward) * tau / incidence.clamp(min=0.05)
    path = (1 - forward) * tau_sunward / mu_sun
    difference = view - path
    close = difference.abs() < 1e-3
    ratio = torch.where(
        close,
        torch.exp(-view),
        (torch.exp(-path) - torch.exp(-view)) / torch.where(close, 1.0, difference),
    )
    cos_angle = directions @ sun
    phase = 0.85 * henyey_greenstein(cos_angle, 0.7) + 0.15 * henyey_greenstein(cos_angle, -0.2)
    once = (phase * view * ratio)[:, None] * sun_irradiance

    # two-stream: total transmittance of a conservative layer, less what is unscattered (what is
    # scattered once stays in it: see the top of this file)
    total = 1 / (1 + 0.75 * (1 - CLOUD_G) * tau_sunward)
    diffuse = (total - torch.exp(-path)).clamp(min=0)[:, None] * sun_irradiance * mu_sun
    down = diffuse + total[:, None] * sky_irradiance
    overcast = 9 / (7 * math.pi) * (1 + 2 * directions[:, 1:2]) / 3
    often = -torch.expm1(-view)[:, None] * down * overcast
    return torch.exp(-view), once + often


def unscattered(tau: Float[Tensor, " n"], incidence: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """exp(-tau / mu): light that meets no droplet at all, such as a sharp solar disc."""
    return torch.exp(-tau / incidence.clamp(min=0.05))


def _fractal_noise(
    x: Float[Tensor, " n"],
    z: Float[Tensor, " n"],
    change: float,
    footprint: Float[Tensor, " n"],
    seed: int,
    octaves: int = 6,
) -> Float[Tensor, " n"]:
    total, power = torch.zeros_like(x), 0.0
    for octave in range(octaves):
        frequency, amplitude = 2.03**octave, 0.55**octave
        resolved = (1.5 - 2 * footprint * frequency).clamp(0, 1)
        y = torch.full_like(x, change * 1.7**octave + 31.7 * octave)
        noise = _gradient_noise(x * frequency, y, z * frequency, seed + octave)
        total = total + amplitude * resolved * noise
        power += amplitude**2
    # gradient noise of this kind has a standard deviation of about 0.26
    return total / (0.26 * math.sqrt(power))


def _gradient_noise(
    x: Float[Tensor, " n"], y: Float[Tensor, " n"], z: Float[Tensor, " n"], seed: int
) -> Float[Tensor, " n"]:
    """Perlin's (2002) improved noise, gradients from a hash of the lattice point."""
    cell = [torch.floor(c) for c in (x, y, z)]
    part = [c - f for c, f in zip((x, y, z), cell, strict=True)]
    whole = [f.long() for f in cell]
    smooth = [p * p * p * (p * (p * 6 - 15) + 10) for p in part]
    total = torch.zeros_like(x)
    for corner in range(8):
        offset = [(corner >> axis) & 1 for axis in range(3)]
        weight = torch.ones_like(x)
        for axis in range(3):
            weight = weight * (smooth[axis] if offset[axis] else 1 - smooth[axis])
        h = _hash(whole[0] + offset[0], whole[1] + offset[1], whole[2] + offset[2], seed)
        d = [part[axis] - offset[axis] for axis in range(3)]
        # one of 12 edge midpoints of the cube: two axes, two signs
        missing = h % 3
        sign_a, sign_b = 1.0 - 2.0 * ((h >> 4) & 1), 1.0 - 2.0 * ((h >> 5) & 1)
        a = torch.where(missing == 0, d[1], d[0])
        b = torch.where(missing == 2, d[1], d[2])
        total = total + weight * (sign_a * a + sign_b * b)
    return total


def _hash(
    x: Int[Tensor, " n"], y: Int[Tensor, " n"], z: Int[Tensor, " n"], seed: int
) -> Int[Tensor, " n"]:
    """A well-mixed 30-bit integer per lattice point (int64 arithmetic, same on every device)."""
    mask = (1 << 31) - 1
    h = (x * 73856093 ^ y * 19349663 ^ z * 83492791 ^ (seed * 2654435761)) & mask
    h = ((h ^ (h >> 15)) * 0x2C1B3C6D) & mask
    h = ((h ^ (h >> 12)) * 0x297A2D39) & mask
    return (h ^ (h >> 15)) >> 1
