"""The wavelengths at which clear skies are computed, and the Rec.709 colour of light at them.

Light is known at seven wavelengths and taken as linear between them; weighted by the sun's
spectrum and the CIE 1931 colour matching functions, each of the seven has a colour. Before what
Rec.709 cannot say is cut off, light that has passed air and haze in equal parts, and up to a fifth
of ozone, is thus within 0.003 in x and y and 1 % in luminance of steps of 1 nm up to an optical
depth of 2 at 550 nm; at a depth of 5 within 0.01 and 5 %, at 10 within 0.014 and 25 %.
"""

import numpy as np
from jaxtyping import Float

BANDS_NM = (400.0, 450.0, 500.0, 550.0, 600.0, 650.0, 700.0)

# The sun's spectrum outside the air, W/m2/nm: ASTM G173, means of 20 nm about every 20th nm.
SUNLIGHT_NM = np.arange(360.0, 781.0, 20.0)
SUNLIGHT = (
    *(1.052, 1.078, 1.436, 1.706, 1.773, 2.026, 1.979, 1.936, 1.849, 1.872, 1.842),
    *(1.823, 1.767, 1.688, 1.624, 1.539, 1.492, 1.428, 1.354, 1.298, 1.251, 1.197),
)
# m2 a molecule at 233 K: Gorshelev et al. and Serdyuchenko et al. (2014), "High spectral
# resolution ozone absorption cross-sections", parts 1 and 2. Means about each wavelength, weights
# falling linearly to nothing at the next ones.
OZONE_CROSS_SECTION = (2.34e-27, 2.55e-26, 1.28e-25, 3.33e-25, 4.38e-25, 2.56e-25, 9.99e-26)

XYZ_FROM_RGB = np.array(  # IEC 61966-2-1
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)


def rayleigh_depth(nm: Float[np.ndarray, "*s"]) -> Float[np.ndarray, "*s"]:
    """Optical depth of all the air above the sea: Bodhaine et al. (1999), eq. 30.

    "On Rayleigh optical depth calculations"; 1013.25 mbar, 45 degrees of latitude.
    """
    square = (nm / 1000) ** 2
    above = 1.0455996 - 341.29061 / square - 0.90230850 * square
    return 0.0021520 * above / (1 + 0.0027059889 / square - 85.968563 * square)


def colour_matching(nm: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """CIE 1931 2-degree functions, fitted by lobes (Wyman, Sloan & Shirley 2013)."""

    def lobe(middle: float, left: float, right: float) -> np.ndarray:
        t = (nm - middle) * np.where(nm < middle, left, right)
        return np.exp(-0.5 * t * t)

    x = 0.362 * lobe(442.0, 0.0624, 0.0374) + 1.056 * lobe(599.8, 0.0264, 0.0323)
    x = x - 0.065 * lobe(501.1, 0.0490, 0.0382)
    y = 0.821 * lobe(568.8, 0.0213, 0.0247) + 0.286 * lobe(530.9, 0.0613, 0.0322)
    z = 1.217 * lobe(437.0, 0.0845, 0.0278) + 0.681 * lobe(459.0, 0.0385, 0.0725)
    return np.stack([x, y, z], -1)


def sunlight_colours() -> Float[np.ndarray, "k 3"]:
    """Rec.709 colours of the sun's light about each wavelength; their sum has luminance 1."""
    nm = np.arange(360.0, 781.0)
    shares = np.stack([np.interp(nm, BANDS_NM, one) for one in np.eye(len(BANDS_NM))])
    xyz = (shares * np.interp(nm, SUNLIGHT_NM, SUNLIGHT)) @ colour_matching(nm)
    return xyz @ np.linalg.inv(XYZ_FROM_RGB).T / xyz[:, 1].sum()
