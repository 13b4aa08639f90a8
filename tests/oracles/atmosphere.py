"""The clear sky by brute force, in float64: line integrals, and photons one by one.

The medium is restated from its sources at three wavelengths: heights by Bruneton & Neyret (2008),
air by Bodhaine et al. (1999), ozone by Serdyuchenko et al. (2014).
"""

import math

import numpy as np

GROUND, TOP = 6360.0, 6460.0
LAMBDA = np.array([450.0, 550.0, 650.0])


def _air(um):
    """Optical depth of the air over its height of 8 km."""
    top = 1.0455996 - 341.29061 * um**-2 - 0.90230850 * um**2
    return 0.0021520 * top / (1 + 0.0027059889 * um**-2 - 85.968563 * um**2) / 8.0


RAYLEIGH = _air(LAMBDA / 1000)
# 300 Dobson units of 2.687e20 molecules/m2 in a tent of 15 km, by cross sections in m2
OZONE = 300 * 2.687e20 / 15 * np.array([2.55e-26, 3.33e-25, 2.56e-25])


def coefficients(height, aerosol_depth, alpha):
    """(rayleigh, aerosol extinction, ozone) per km at heights (...), each (..., 3)."""
    height = np.maximum(height, 0)[..., None]
    rayleigh = RAYLEIGH * np.exp(-height / 8.0)
    aerosol = aerosol_depth / 1.2 * (LAMBDA / 550) ** -alpha * np.exp(-height / 1.2)
    ozone = OZONE * np.maximum(0, 1 - np.abs(height - 25) / 15)
    return rayleigh, aerosol, ozone


def optical_depth(height, mu, aerosol_depth, alpha=1.3, ozone=1.0, steps=2000):
    """Optical depth (..., 3) from heights (...) to the top along zenith cosines mu (...)."""
    r = (GROUND + np.asarray(height, float))[..., None]
    mu = np.asarray(mu, float)[..., None]
    length = -r * mu + np.sqrt((r * mu) ** 2 + TOP**2 - r**2)
    edges = np.linspace(0, 1, steps + 1) ** 2  # fine where the air is dense
    t = (edges[1:] + edges[:-1]) / 2 * length
    along = np.sqrt(r**2 + t**2 + 2 * r * t * mu) - GROUND
    rayleigh, aerosol, o3 = coefficients(along, aerosol_depth, alpha)
    total = rayleigh + aerosol + ozone * o3
    return (total * (np.diff(edges) * length)[..., None]).sum(-2)


def single_scattering(
    direction, sun, *, height, aerosol_depth, alpha=1.3, albedo=0.92, g=0.76, ozone=1.0, steps=300
):
    """Sunlight (irradiance 1 in each channel) scattered exactly once into one direction, (3,)."""
    r0, mu = GROUND + height, direction[1]
    length = -r0 * mu + math.sqrt((r0 * mu) ** 2 + TOP**2 - r0**2)
    edges = np.linspace(0, 1, steps + 1) ** 2
    t, dt = (edges[1:] + edges[:-1]) / 2 * length, np.diff(edges) * length
    points = np.array([0, r0, 0]) + t[:, None] * direction
    r = np.linalg.norm(points, axis=1)
    rayleigh, aerosol, o3 = coefficients(r - GROUND, aerosol_depth, alpha)
    extinction = rayleigh + aerosol + ozone * o3
    before = np.cumsum(extinction * dt[:, None], 0) - extinction * dt[:, None] / 2
    toward = optical_depth(r - GROUND, points @ sun / r, aerosol_depth, alpha, ozone, steps)
    c = float(direction @ sun)
    phase_r = 3 / (16 * math.pi) * (1 + c * c)
    phase_m = (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * c) ** 1.5)
    scattered = rayleigh * phase_r + albedo * aerosol * phase_m
    return (scattered * np.exp(-before - toward) * dt[:, None]).sum(0)


def diffuse_light(air, mu_sun, ground_albedo, photons, haze=0.0, albedo=0.92, g=0.76, seed=0):
    """Diffuse irradiance at the ground per unit *horizontal* sunlight, all orders: photons.

    Plane-parallel layers over Lambertian ground: air of vertical optical depth ``air`` and scale
    height 8 km (Rayleigh, scalar, nothing absorbed), haze of depth ``haze`` and 1.2 km (Henyey &
    Greenstein, single-scattering albedo ``albedo``). Also returned: its standard error.
    """
    rng = np.random.default_rng(seed)
    height = np.linspace(100, 0, 20001)
    both = air * np.exp(-height / 8) + haze * np.exp(-height / 1.2)
    part = haze / 1.2 * np.exp(-height / 1.2)
    part = part / (part + air / 8 * np.exp(-height / 8))  # of the extinction, the haze's
    depth = air + haze
    down = np.tile([math.sqrt(1 - mu_sun**2), 0.0, -mu_sun], (photons, 1))
    tau, weight, number = np.zeros(photons), np.ones(photons), np.arange(photons)
    direct, received = np.ones(photons, bool), np.zeros(photons)
    for _ in range(200):
        tau = tau - down[:, 2] * rng.exponential(size=len(tau))  # tau grows downwards
        landed, lost = tau >= depth, tau <= 0
        received[number[landed & ~direct]] += weight[landed & ~direct]
        hazy = ~landed & (rng.random(len(tau)) < np.interp(tau, both, part))
        weight = weight * np.where(landed, ground_albedo, np.where(hazy, albedo, 1.0))
        tau = np.minimum(tau, depth)
        keep = ~lost & (weight > 1e-3)
        down, tau, weight, number = down[keep], tau[keep], weight[keep], number[keep]
        landed, hazy = landed[keep], hazy[keep]
        direct = np.zeros(len(tau), bool)
        if not len(tau):
            break
        c = np.where(hazy, _haze_cosine(rng, len(tau), g), _air_cosine(rng, len(tau)))
        down = np.where(landed[:, None], _cosine_up(rng, len(tau)), _turned(rng, down, c))
    return received.mean(), received.std() / math.sqrt(photons)


def sky_radiance(
    directions,
    sun,
    *,
    channel,
    photons,
    aerosol_depth,
    ground_albedo,
    alpha=1.3,
    albedo=0.92,
    g=0.76,
    ozone=1.0,
    seed=0,
):
    """Radiance (n,) at sea level towards ``directions``, sunlight 1, all orders; its error, too.

    Followed backwards through round shells: wherever a path is scattered or meets the ground, it
    gathers the sunlight scattered there for the first time.
    """
    rng = np.random.default_rng(seed)
    number = np.repeat(np.arange(len(directions)), photons)
    seen = np.arange(len(number))
    d, at = directions[number], np.tile([0.0, GROUND + 1e-6, 0.0], (len(number), 1))
    weight, found = np.ones(len(number)), np.zeros(len(number))

    def parts(height):
        air, haze, o3 = coefficients(height, aerosol_depth, alpha)
        return air[..., channel], haze[..., channel], ozone * o3[..., channel]

    while len(weight):
        r = np.linalg.norm(at, axis=1)
        mu = (at * d).sum(1) / r
        inside = (r * mu) ** 2 - r**2 + GROUND**2
        falls = (mu < 0) & (inside > 0)
        top = -r * mu + np.sqrt((r * mu) ** 2 + TOP**2 - r**2)
        length = np.where(falls, -r * mu - np.sqrt(np.maximum(inside, 0)), top)
        edges = np.linspace(0, 1, 101) ** 2 * length[:, None]
        t = (edges[:, 1:] + edges[:, :-1]) / 2
        height = np.sqrt(r[:, None] ** 2 + t**2 + 2 * (r * mu)[:, None] * t) - GROUND
        tau = np.cumsum(sum(parts(height)) * np.diff(edges), 1)
        through = np.exp(-tau[:, -1])
        landed = falls & (rng.random(len(r)) < through)
        weight = weight * np.where(falls, 1, 1 - through)  # those towards the sky never leave
        goal = -np.log1p(-rng.random(len(r)) * (1 - through))
        step = np.minimum((tau < goal[:, None]).sum(1), 99)
        row = np.arange(len(r))
        t = np.where(
            landed, length, edges[row, step] + np.diff(edges)[row, step] * rng.random(len(r))
        )
        at = at + t[:, None] * d
        r = np.linalg.norm(at, axis=1)
        air, haze, o3 = parts(r - GROUND)
        cos_sun, c = at @ sun / r, d @ sun
        beam = np.exp(-optical_depth(r - GROUND, cos_sun, aerosol_depth, alpha, ozone, 60))
        scattered = air * 3 / (16 * math.pi) * (1 + c * c)
        scattered += albedo * haze * (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * c) ** 1.5)
        gathered = np.where(
            landed, ground_albedo / math.pi * cos_sun, scattered / (air + haze + o3)
        )
        found[seen] += weight * gathered * beam[:, channel] * (cos_sun > 0)
        kept = (air + albedo * haze) / (air + haze + o3)
        weight = weight * np.where(landed, ground_albedo, kept)
        lives = rng.random(len(weight)) < weight / 0.1  # the faint ones by lot
        weight = np.maximum(weight, 0.1)
        hazy = rng.random(len(weight)) < albedo * haze / (air + albedo * haze)
        at, d, weight, seen, landed = at[lives], d[lives], weight[lives], seen[lives], landed[lives]
        hazy, up = hazy[lives], at / np.linalg.norm(at, axis=1, keepdims=True)
        count = len(weight)
        c = np.where(hazy, _haze_cosine(rng, count, g), _air_cosine(rng, count))
        c = np.where(landed, np.sqrt(rng.random(count)), c)
        d = _turned(rng, np.where(landed[:, None], up, d), c)
    found = found.reshape(len(directions), photons)
    return found.mean(1), found.std(1) / math.sqrt(photons)


def _cosine_up(rng, count):
    mu, phi = np.sqrt(rng.random(count)), 2 * math.pi * rng.random(count)
    s = np.sqrt(1 - mu**2)
    return np.stack([s * np.cos(phi), s * np.sin(phi), mu], 1)


def _air_cosine(rng, count):
    """Cosines distributed as 3/8 (1 + c^2), inverted by Cardano's formula."""
    q = 4 * rng.random(count) - 2
    root = np.cbrt(q + np.sqrt(q * q + 1))
    return root - 1 / root


def _haze_cosine(rng, count, g):
    """Cosines distributed as Henyey & Greenstein's phase function."""
    return (1 + g * g - ((1 - g * g) / (1 - g + 2 * g * rng.random(count))) ** 2) / (2 * g)


def _turned(rng, direction, c):
    """Directions at angles of cosine ``c`` with the old ones, round them at random."""
    phi = 2 * math.pi * rng.random(len(direction))
    s = np.sqrt(np.maximum(0, 1 - c * c))
    helper = np.where(np.abs(direction[:, 2:3]) < 0.9, [[0.0, 0, 1]], [[1.0, 0, 0]])
    u = np.cross(direction, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(direction, u)
    return c[:, None] * direction + (s * np.cos(phi))[:, None] * u + (s * np.sin(phi))[:, None] * v
