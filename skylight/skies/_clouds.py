"""Cloud layers: procedural density, ray marched, and the diffuse light within.

A layer lies between two spherical shells. Its density is periodic noise, tabulated and
interpolated, cut at a threshold, so that a given fraction of it is cloud, advected and changed with
time. Ray marching along each view ray accumulates

- single scattering of sunlight: the beam attenuated in the layer, two-lobe phase function;
- multiple scattering of light from the sun, the sky above and the ground below: the Eddington
  solution of a slab (:func:`slab_light`) as deep as the cloud is, at the point, towards the sun
  and away from it. Exact in a homogeneous layer to what that solution is; on the flank of a tower,
  where light also enters sideways, an approximation (no error bound is known: Monte Carlo in three
  dimensions would have to give it);
- sunlight in the droplets' forward peak: the aureole and the silver lining.

Layers shadow those below them (:func:`shadow`). Droplets and ice absorb nothing. Not modelled:
haloes, and the angle between the cloud's sides and the sun.

A slab is a plane-parallel, non-absorbing cloud in Eddington's approximation. Droplets scatter
sharply forward. By delta scaling (Joseph, Wiscombe & Weinman 1976) a part f = g^2 of what they
scatter is treated as transmitted, the rest as scattered with the asymmetry g' = g / (1 + g) at
optical depths tau' = (1 - f) tau. All depths here are scaled ones.

With mean diffuse radiance J and net diffuse flux F (downwards), the beam E on top at the cosine
mu0, light without absorption obeys (Eddington's closure)::

    F(tau) + mu0 E e^(-tau/mu0) = C           (conservation)
    (4 pi / 3) dJ/dtau = -(1 - g') C + mu0 E e^(-tau/mu0)

with pi J + F/2 = D on top (D: irradiance from the sky above), and at the bottom
pi J - F/2 = A (all light going down) over ground of albedo A.

Against Monte Carlo photons in homogeneous slabs the transmitted flux is wrong by at most 0.14 of
the incident flux, 0.05 for suns above 30 degrees (see the tests).
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight._modes import constant
from skylight.skies._atmosphere import EARTH_RADIUS_KM
from skylight.skies._scattering import henyey_greenstein

CLOUD_G = 0.85  # asymmetry of water droplets in visible light (Liou 2002, table 4.4)
FORWARD = CLOUD_G**2  # f: counts as not scattered
SCALED_G = CLOUD_G / (1 + CLOUD_G)
CELLS = 16  # period of the tile, in cells of the coarser octave
_SIZE = 96  # samples a side: 3 in a cell of the finer octave
_OCTAVES = 2
_TILE_SEED = 20150101
STEPS = 12  # along a ray of view, within the layer
LIGHT_STEPS = 4  # towards the sun, and away from it
FORWARD_PEAK_G = 0.96  # width of the aureole: about 5 degrees
_LONGEST_KM = 60.0  # of a ray within the layer, near the horizon
_LOWEST_SUN = 0.05  # cosine of the sun's zenith angle in the march
_PROFILE_MEAN = 1 - 0.08 / 2 - 0.25 / 2  # of floor times ceiling over the thickness


@dataclass(frozen=True, kw_only=True)
class SlabLight:
    """Mean diffuse radiance J and net downward diffuse flux F, per unit beam and unit sky.

    ``J = E beam_mean + D sky_mean``, and the same for the flux.
    """

    beam_mean: Float[Tensor, "*s"]
    beam_flux: Float[Tensor, "*s"]
    sky_mean: Float[Tensor, "*s"]
    sky_flux: Float[Tensor, "*s"]


def slab_light(
    above: Float[Tensor, "*s"], below: Float[Tensor, "*s"], mu0: float, albedo: float
) -> SlabLight:
    """The diffuse light at scaled depth ``above`` in a slab of depth ``above + below``."""
    total = above + below
    through = torch.exp(-total / mu0)
    here = torch.exp(-above / mu0)
    reflected = 1 - albedo
    resistance = 1 + reflected * 0.75 * (1 - SCALED_G) * total
    net_beam = reflected * mu0 * (0.5 * (1 + through) + 0.75 * mu0 * (1 - through)) / resistance
    net_sky = reflected / resistance
    # on top: pi J = D - F / 2 with F = C - mu0 E
    beam_top = (mu0 - net_beam) / 2
    sky_top = 1 - net_sky / 2
    descent = 0.75 * (1 - SCALED_G) * above
    beam = beam_top - descent * net_beam + 0.75 * mu0**2 * (1 - here)
    return SlabLight(
        beam_mean=beam / math.pi,
        beam_flux=net_beam - mu0 * here,
        sky_mean=(sky_top - descent * net_sky) / math.pi,
        sky_flux=net_sky,
    )


def two_lobes(cos_angle: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """Phase function of the scaled droplets: mean cosine 0.46 = g', integral 1 over the sphere."""
    return 0.8 * henyey_greenstein(cos_angle, 0.65) + 0.2 * henyey_greenstein(cos_angle, -0.3)


def fractal_noise(points: Float[Tensor, "*s 3"]) -> Float[Tensor, "*s"]:
    """Smooth random values, uniform on [0, 1], at positions in cells (period ``CELLS``).

    Two octaves of Perlin's (2002) gradient noise, summed with amplitudes 1 and 1/2 and brought
    to a uniform distribution by rank. Trilinear between the table's nodes, which draws values
    a little to the middle: P(fractal_noise < q) is within 0.03 of q.
    """
    table = _tile(str(points.device))
    # align_corners puts -1 and 1 on the first node and on its repetition at the end
    grid = torch.remainder(points * (2 / CELLS), 2.0).sub_(1).reshape(1, 1, 1, -1, 3)
    value = torch.nn.functional.grid_sample(table, grid, align_corners=True)
    return value.reshape(points.shape[:-1])


@constant()
def _tile(device: str) -> Float[Tensor, "1 1 n n n"]:
    """The table, (z, y, x) as grid_sample wants it, its first nodes repeated at the end."""
    axis = torch.arange(_SIZE, dtype=torch.float64) * (CELLS / _SIZE)
    z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
    total = torch.zeros_like(x)
    generator = torch.Generator().manual_seed(_TILE_SEED)
    for octave in range(_OCTAVES):
        lattice = CELLS * 2**octave
        # the finer octaves keep off the nodes of the table, where gradient noise is zero
        shift = 0.37 * octave
        gradients = torch.randn(lattice, lattice, lattice, 3, generator=generator).double()
        gradients = gradients / gradients.norm(dim=-1, keepdim=True)
        scaled = [c * 2**octave + shift for c in (x, y, z)]
        total += 0.5**octave * _gradient_noise(scaled, gradients)
    rank = total.reshape(-1).argsort().argsort().double()
    uniform = ((rank + 0.5) / rank.numel()).float().reshape(total.shape)
    padded = torch.nn.functional.pad(uniform[None, None], (0, 1, 0, 1, 0, 1), mode="circular")
    return padded.to(device)


def _gradient_noise(
    position: list[Float[Tensor, "n n n"]], gradients: Float[Tensor, "l l l 3"]
) -> Float[Tensor, "n n n"]:
    """Perlin's improved noise with one unit gradient per node of a periodic lattice."""
    size = len(gradients)
    cell = [torch.floor(p) for p in position]
    part = [p - c for p, c in zip(position, cell, strict=True)]
    fade = [p**3 * (p * (p * 6 - 15) + 10) for p in part]
    total = torch.zeros_like(position[0])
    for corner in range(8):
        offset = [(corner >> axis) & 1 for axis in range(3)]
        node = [(c.long() + o) % size for c, o in zip(cell, offset, strict=True)]
        weight = math.prod(f if o else 1 - f for f, o in zip(fade, offset, strict=True))
        slope = gradients[node[2], node[1], node[0]]
        away = torch.stack([p - o for p, o in zip(part, offset, strict=True)], -1)
        total = total + weight * (slope * away).sum(-1)
    return total


@dataclass(frozen=True, kw_only=True)
class CloudLayer:
    """One layer.

    ``coverage`` is the share of its floor under cloud (1 and more: no gaps); ``depth`` the
    vertical optical depth of a column of full density; ``softness`` how far from an edge the
    density is full, as a share of the noise's range; ``towering`` how much of the noise's range
    the threshold rises from floor to ceiling (0 a sheet, 0.5 heaps); ``erosion`` how much finer
    noise eats away; ``stretch`` draws the clouds out along the wind.
    """

    coverage: float
    depth: float
    base_km: float = 2.0
    thickness_km: float = 0.6
    cell_km: float = 3.0
    softness: float = 0.2
    towering: float = 0.0
    erosion: float = 0.15
    stretch: float = 1.0
    seed: int = 0


@dataclass(frozen=True, kw_only=True)
class Wind:
    """Where a layer has drifted to (km east and south of where it was) and how far it changed."""

    east_km: float
    south_km: float
    change: float  # cells along the noise's vertical axis


@dataclass(frozen=True, kw_only=True)
class LayerLight:
    """What a layer does to each ray.

    ``depth`` is the optical depth along the ray, unscaled; ``passed`` the transmittance that
    counts the forward peak as passed, right for a smooth background. The layer's own radiance is
    ``E beam + D sky`` for a beam E facing the sun and an irradiance D of the sky above it.
    """

    depth: Float[Tensor, " n"]
    passed: Float[Tensor, " n"]
    beam: Float[Tensor, " n"]
    sky: Float[Tensor, " n"]


def march(
    layer: CloudLayer,
    directions: Float[Tensor, "n 3"],
    sun: Float[Tensor, "3"],
    wind: Wind,
    *,
    footprint_rad: float,
    ground_albedo: float,
) -> LayerLight:
    """March ``directions`` (east, up, south; all above the horizon) through the layer.

    Detail finer than ``footprint_rad`` seen from the observer fades out instead of aliasing.
    The samples stand at hashed offsets within their steps, so that too few of them show as grain.
    """
    mu = directions[:, 1].clamp(min=2e-3)
    near = _distance(mu, layer.base_km)
    far = torch.minimum(_distance(mu, layer.base_km + layer.thickness_km), near + _LONGEST_KM)
    index = torch.arange(len(mu), device=mu.device, dtype=torch.float64)
    offset = 0.25 + 0.5 * torch.remainder(index * 0.6180339887498949, 1.0).float()[:, None]
    # thick cloud is seen only to a small depth: the steps grow from its floor on
    edges = torch.linspace(0, 1, STEPS + 1, device=mu.device) ** 1.5
    length = (far - near)[:, None] * torch.diff(edges)
    t = near[:, None] + (far - near)[:, None] * edges[:-1] + length * offset
    height = _height(mu[:, None], t)
    matrix, origin = _noise_space(layer, wind, directions)
    flat = directions * torch.tensor([1.0, 0.0, 1.0]).to(directions)
    cells = t[..., None] * (flat @ matrix.T)[:, None] + origin
    cells = cells + height[..., None] * matrix[:, 1]
    density = _density(layer, cells, height, footprint_rad * t)

    depth = density * length
    scaled = (1 - FORWARD) * depth
    before = torch.cumsum(scaled, 1) - scaled
    shown = torch.exp(-before) * -torch.expm1(-scaled)
    inside = shown > 1e-4
    mu0 = max(float(sun[1]), _LOWEST_SUN)
    heading = torch.stack([sun[0], sun.new_tensor(mu0), sun[2]])
    start, level = cells[inside], height[inside]
    sunward, leeward = (
        (1 - FORWARD) * _depth_along(layer, start, level, sign * heading, sign * matrix @ heading)
        for sign in (1, -1)
    )
    light = slab_light(mu0 * sunward, mu0 * leeward, mu0, ground_albedo)
    phase = two_lobes(directions @ sun)[:, None].expand_as(shown)[inside]
    # I(mu) = J + (3 / 4 pi) mu F, and of what meets a droplet the part g' F goes on
    slope = (3 / (4 * math.pi)) * SCALED_G * mu[:, None].expand_as(shown)[inside]
    beam = torch.exp(-sunward) * phase + light.beam_mean + slope * light.beam_flux
    sky = light.sky_mean + slope * light.sky_flux
    total = depth.sum(1)
    passed = torch.exp(-(1 - FORWARD) * total)
    peak = henyey_greenstein(directions @ sun, FORWARD_PEAK_G)
    aureole = passed * -torch.expm1(-FORWARD * total) * peak
    return LayerLight(
        depth=total,
        passed=passed,
        beam=_gather(shown, inside, beam) + aureole,
        sky=_gather(shown, inside, sky),
    )


def shadow(
    layer: CloudLayer,
    wind: Wind,
    directions: Float[Tensor, "n 3"],
    height_km: float,
    sun: Float[Tensor, "3"],
) -> Float[Tensor, " n"]:
    """Share of the sun's beam that passes ``layer`` to where rays reach a height below it.

    The forward peak counts as passed. The layer is taken as flat between that place and the sun;
    its depth is within a tenth of that of a uniform one.
    """
    mu = directions[:, 1].clamp(min=2e-3)
    mu0 = max(float(sun[1]), _LOWEST_SUN)
    heading = torch.stack([sun[0], sun.new_tensor(mu0), sun[2]])
    matrix, origin = _noise_space(layer, wind, directions)
    level = torch.tensor([1.0, 0.0, 1.0]).to(directions)
    towards = max(layer.base_km - height_km, 0.0) / mu0 * heading
    floor = (_distance(mu, height_km)[:, None] * directions + towards) * level
    cells = floor @ matrix.T + origin + layer.base_km * matrix[:, 1]
    at_floor = torch.full_like(mu, layer.base_km)
    depth = _depth_along(layer, cells, at_floor, heading, matrix @ heading)
    return torch.exp(-(1 - FORWARD) * depth)


def _gather(
    weight: Float[Tensor, "n k"], inside: Bool[Tensor, "n k"], value: Float[Tensor, " m"]
) -> Float[Tensor, " n"]:
    full = torch.zeros_like(weight)
    full[inside] = value.clamp(min=0)
    return (weight * full).sum(1)


def _density(
    layer: CloudLayer,
    cells: Float[Tensor, "*s 3"],
    height: Float[Tensor, "*s"],
    footprint_km: Float[Tensor, "*s"] | None,
) -> Float[Tensor, "*s"]:
    """Extinction per km at places in the noise; without a footprint its finer part is left out."""
    body = fractal_noise(cells)
    if footprint_km is not None and layer.erosion > 0:
        for octave, strength in ((3.7, 0.6), (9.3, 0.4)):
            resolved = (1.5 - 2 * footprint_km * octave / layer.cell_km).clamp(0, 1)
            finer = fractal_noise(cells * octave) - 0.5
            body = body + layer.erosion * strength * resolved * finer
    share = ((height - layer.base_km) / layer.thickness_km).clamp(0, 1)
    above = (body - (1 - layer.coverage) - layer.towering * share**2) / layer.softness
    # condensation starts at a level: the floor is sharp, the ceiling frays
    profile = (share / 0.08).clamp(max=1) * ((1 - share) / 0.25).clamp(max=1)
    full = layer.depth / layer.thickness_km / _PROFILE_MEAN
    return full * above.clamp(0, 1) * profile


def _noise_space(
    layer: CloudLayer, wind: Wind, like: Float[Tensor, "..."]
) -> tuple[Float[Tensor, "3 3"], Float[Tensor, "3"]]:
    """(M, o): a place p (east, up, south, km) has the noise's value at M p + o, in its cells.

    Turned, stretched and shifted by the layer's seed; drifted and changed by the wind.
    """
    generator = torch.Generator().manual_seed(layer.seed)
    *shift, turn = torch.rand(4, generator=generator, dtype=torch.float64).tolist()
    c, s = math.cos(2 * math.pi * turn), math.sin(2 * math.pi * turn)
    along = [c / layer.stretch, 0.0, s / layer.stretch]
    matrix = torch.tensor([along, [0.0, 1.0, 0.0], [-s, 0.0, c]], dtype=torch.float64)
    matrix = matrix / layer.cell_km
    moved = matrix @ torch.tensor([wind.east_km, 0.0, wind.south_km], dtype=torch.float64)
    origin = CELLS * torch.tensor(shift, dtype=torch.float64) - moved
    origin[1] += wind.change
    # not wrapped into the tile: the finer octaves have other periods and would jump
    return matrix.to(like), origin.to(like)


def _depth_along(
    layer: CloudLayer,
    cells: Float[Tensor, "m 3"],
    height: Float[Tensor, " m"],
    heading: Float[Tensor, "3"],
    heading_cells: Float[Tensor, "3"],
) -> Float[Tensor, " m"]:
    """Optical depth from places to the layer's ceiling (or floor, if ``heading`` goes down)."""
    climb = float(heading[1])
    end = layer.base_km + (layer.thickness_km if climb > 0 else 0.0)
    path = ((end - height) / climb).clamp(0, _LONGEST_KM)
    # quadratic spacing: the nearest cloud matters most
    edges = torch.linspace(0, 1, LIGHT_STEPS + 1, device=cells.device) ** 2
    t = path[:, None] * (edges[1:] + edges[:-1]) / 2
    along = cells[:, None] + t[..., None] * heading_cells
    density = _density(layer, along, height[:, None] + climb * t, None)
    return (density * torch.diff(edges)).sum(1) * path


def _distance(mu: Float[Tensor, " n"], height_km: float) -> Float[Tensor, " n"]:
    """From an observer at sea level to a shell of the given height."""
    outer = EARTH_RADIUS_KM + height_km
    return torch.sqrt((EARTH_RADIUS_KM * mu) ** 2 + outer**2 - EARTH_RADIUS_KM**2) - (
        EARTH_RADIUS_KM * mu
    )


def _height(mu: Float[Tensor, "*#s"], t: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """Height above sea level after a distance t: t mu + t^2 (1 - mu^2) / 2R, within 1e-3 of it."""
    return t * mu + t**2 * (1 - mu**2) / (2 * EARTH_RADIUS_KM)
