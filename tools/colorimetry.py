"""Chromaticities and luminances, for comparisons with spectra."""

import numpy as np

XYZ_FROM_RGB = np.array(  # IEC 61966-2-1
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)


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


def colour_matching(nm: np.ndarray) -> np.ndarray:
    """CIE 1931 2-degree functions (n, 3), fitted by lobes (Wyman, Sloan & Shirley 2013)."""

    def lobe(middle: float, left: float, right: float) -> np.ndarray:
        t = (nm - middle) * np.where(nm < middle, left, right)
        return np.exp(-0.5 * t * t)

    x = 0.362 * lobe(442.0, 0.0624, 0.0374) + 1.056 * lobe(599.8, 0.0264, 0.0323)
    x = x - 0.065 * lobe(501.1, 0.0490, 0.0382)
    y = 0.821 * lobe(568.8, 0.0213, 0.0247) + 0.286 * lobe(530.9, 0.0613, 0.0322)
    z = 1.217 * lobe(437.0, 0.0845, 0.0278) + 0.681 * lobe(459.0, 0.0385, 0.0725)
    return np.stack([x, y, z], -1)
