"""Chromaticities and luminances, for comparisons with spectra."""

import numpy as np

from skylight.skies._scattering import XYZ_FROM_RGB


def bright(rgb: np.ndarray) -> np.ndarray:
    """Rec.709 luminance."""
    return rgb @ XYZ_FROM_RGB[1]


def chromaticity(rgb: np.ndarray) -> tuple[float, float]:
    xyz = XYZ_FROM_RGB @ rgb
    return float(xyz[0] / xyz.sum()), float(xyz[1] / xyz.sum())


def colour_temperature(x: float, y: float) -> float:
    """McCamy 1992: correlated colour temperature in K, good from 2000 to 12500."""
    n = (x - 0.3320) / (0.1858 - y)
    return 449 * n**3 + 3525 * n**2 + 6823.3 * n + 5520.33
