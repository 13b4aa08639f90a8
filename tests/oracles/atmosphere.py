"""The clear sky by brute force, in float64: line integrals, and photons one by one.

The medium is restated from its sources (Bruneton & Neyret 2008; Hillaire 2020, table 1).
"""

import math

import numpy as np

GROUND, TOP = 6360.0, 6460.0
RAYLEIGH = np.array([5.802e-3, 13.558e-3, 33.1e-3])
OZONE = np.array([0.650e-3, 1.881e-3, 0.085e-3])
LAMBDA = np.array([680.0, 550.0, 440.0])


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


def rayleigh_slab(depth, mu_sun, ground_albedo, photons, seed=0):
    """Diffuse irradiance at the ground per unit *horizontal* sunlight, all orders: photons.

    A plane-parallel, conservative Rayleigh slab (scalar) over Lambertian ground.
    """
    rng = np.random.default_rng(seed)
    down = np.tile([math.sqrt(1 - mu_sun**2), 0.0, -mu_sun], (photons, 1))
    tau, weight = np.zeros(photons), np.ones(photons)  # tau grows downwards
    direct, received = np.ones(photons, bool), 0.0
    for _ in range(60):
        tau = tau - down[:, 2] * rng.exponential(size=len(tau))
        landed, lost = tau >= depth, tau <= 0
        received += weight[landed & ~direct].sum()
        weight = np.where(landed, weight * ground_albedo, weight)
        tau = np.minimum(tau, depth)
        keep = ~lost & (weight > 1e-3)
        down, tau, weight, landed = down[keep], tau[keep], weight[keep], landed[keep]
        direct = np.zeros(len(tau), bool)
        if not len(tau):
            break
        down = np.where(landed[:, None], _cosine_up(rng, len(tau)), _scatter(rng, down))
    return received / photons


def _cosine_up(rng, count):
    mu, phi = np.sqrt(rng.random(count)), 2 * math.pi * rng.random(count)
    s = np.sqrt(1 - mu**2)
    return np.stack([s * np.cos(phi), s * np.sin(phi), mu], 1)


def _scatter(rng, direction):
    """New directions, cos of the angle distributed as 3/8 (1 + c^2) (inverted by Cardano)."""
    q = 4 * rng.random(len(direction)) - 2
    root = np.cbrt(q + np.sqrt(q * q + 1))
    c, phi = root - 1 / root, 2 * math.pi * rng.random(len(direction))
    s = np.sqrt(np.maximum(0, 1 - c * c))
    helper = np.where(np.abs(direction[:, 2:3]) < 0.9, [[0.0, 0, 1]], [[1.0, 0, 0]])
    u = np.cross(direction, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(direction, u)
    return c[:, None] * direction + (s * np.cos(phi))[:, None] * u + (s * np.sin(phi))[:, None] * v
