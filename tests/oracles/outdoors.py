"""Unshadowed surfaces out of doors, in float64: sums over directions plus a point sun."""

import numpy as np

F0, ALPHA = 0.028, 0.16  # reflectance at normal incidence and GGX width of skin


def clear_sky(directions, sun):
    """CIE standard clear sky (ISO 15469, type 12), up to scale; 0 below the horizon."""
    up = directions[:, 1]
    angle = np.arccos(np.clip(directions @ sun, -1, 1))
    gradation = 1 - np.exp(-0.32 / np.maximum(up, 1e-3))
    scattering = 1 + 10 * (np.exp(-3 * angle) - np.exp(-1.5 * np.pi)) + 0.45 * np.cos(angle) ** 2
    return np.where(up > 0, gradation * scattering, 0.0)


class Outdoors:
    """Sky of mean radiance ``sky`` (3,), sun of normal irradiance ``sun_irradiance`` (3,), and
    Lambertian ground. World frame: +Y up."""

    def __init__(self, sun, sky, sun_irradiance, ground, rows=64):
        # Gauss-Legendre in the height of each hemisphere, even steps of azimuth
        y, weight = np.polynomial.legendre.leggauss(rows)
        y = np.concatenate([(y + 1) / 2, -(y + 1) / 2])
        turn = 2 * np.pi * (np.arange(4 * rows) + 0.5) / (4 * rows)
        y, turn = (part.ravel() for part in np.meshgrid(y, turn, indexing="ij"))
        flat = np.sqrt(1 - y**2)
        self.directions = np.stack([flat * np.sin(turn), y, -flat * np.cos(turn)], 1)
        self.solid_angles = np.repeat(np.tile(weight / 2, 2), 4 * rows) * 2 * np.pi / (4 * rows)
        self.sun, self.sun_irradiance = np.asarray(sun), np.asarray(sun_irradiance)
        shape = clear_sky(self.directions, self.sun)
        radiance = shape / (shape @ self.solid_angles / (2 * np.pi))
        self.radiance = radiance[:, None] * np.asarray(sky)
        horizontal = self.irradiance(np.array([[0.0, 1.0, 0.0]]))
        self.radiance[y < 0] = np.asarray(ground) / np.pi * horizontal

    def reflected(self, normals, reflectance):
        """Radiance (n, 3) by ``reflectance(w)`` (n, k) times cosine, light from ``w`` (k, 3)."""
        light = self.radiance * self.solid_angles[:, None]
        cosine = np.clip(normals @ self.directions.T, 0, None)
        direct = np.clip(normals @ self.sun, 0, None)[:, None] * reflectance(self.sun[None])
        return (cosine * reflectance(self.directions)) @ light + direct * self.sun_irradiance

    def irradiance(self, normals):
        """Irradiance (n, 3) of planes that see everything above them."""
        return self.reflected(normals, lambda w: np.ones((len(normals), len(w))))

    def specular(self, normals, view):
        """Radiance towards ``view`` by a GGX surface (Walter et al. 2007; masking and shadowing of
        Heitz 2014, eq. 99; Schlick 1994)."""

        def masking(cosine):
            return (np.sqrt(1 + ALPHA**2 * (1 / cosine**2 - 1)) - 1) / 2

        def brdf(w):
            half = w + view
            half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
            n_l, n_v = np.clip(normals @ w.T, 1e-6, None), (normals @ view)[:, None]
            facets = ALPHA**2 / (np.pi * ((normals @ half.T) ** 2 * (ALPHA**2 - 1) + 1) ** 2)
            fresnel = F0 + (1 - F0) * (1 - np.clip(half @ view, 0, 1)) ** 5
            return facets * fresnel / (1 + masking(n_l) + masking(n_v)) / (4 * n_l * n_v)

        return self.reflected(normals, brdf)
