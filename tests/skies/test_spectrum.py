"""Bands, air and colours of clear skies against other formulas and finer steps."""

from pathlib import Path

import numpy as np
import pytest

from skylight.skies import _scattering as spectrum


def test_rayleigh_depth() -> None:
    """Within 0.5 % of Hansen & Travis (1974), eq. 2.30, another fit to measured refraction."""
    um = np.array(spectrum.BANDS_NM) / 1000
    other = 0.008569 * um**-4 * (1 + 0.0113 * um**-2 + 0.00013 * um**-4)
    np.testing.assert_allclose(spectrum.rayleigh_depth(1000 * um), other, rtol=0.005)


def test_colour_matching() -> None:
    """CIE 1931 (ISO 11664-1) at 450, 550 and 600 nm, within the fits' 2 % of the peak."""
    table = [[0.3362, 0.0380, 1.7721], [0.4334, 0.9950, 0.0087], [1.0622, 0.6310, 0.0008]]
    found = spectrum.colour_matching(np.array([450.0, 550.0, 600.0]))
    np.testing.assert_allclose(found, table, atol=0.02 * 1.78)


def test_sunlight_has_luminance_one_and_the_suns_chromaticity() -> None:
    """(0.3232, 0.3329): ASTM G173's spectrum outside the air in steps of 1 nm."""
    xyz = spectrum.XYZ_FROM_RGB @ spectrum.sunlight_colours().sum(0)
    assert xyz[1] == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(xyz[:2] / xyz.sum(), [0.3232, 0.3329], atol=0.001)


def test_sunlight_is_that_of_astm_g173(shared_data: Path) -> None:
    path = shared_data / "reference" / "astm_g173.txt"
    if not path.is_file():
        pytest.skip(f"{path.name} is not among the collected data")
    lines = [line for line in path.read_text().splitlines() if line[:1].isdigit()]
    nm, light = np.loadtxt(lines, usecols=(0, 1)).T
    fine = np.arange(350.0, 790.0, 0.5)
    means = [
        np.interp(fine, nm, light)[(fine >= at - 10) & (fine < at + 10)].mean()
        for at in spectrum.SUNLIGHT_NM
    ]
    np.testing.assert_allclose(spectrum.SUNLIGHT, means, atol=0.001)


@pytest.mark.parametrize("ozone", [0.0, 0.2])
@pytest.mark.parametrize(
    ("depth", "chromaticity", "luminance"),
    [
        *((0.0, 0.003, 0.01), (0.5, 0.003, 0.01), (1.0, 0.003, 0.01), (2.0, 0.003, 0.01)),
        *((5.0, 0.01, 0.05), (10.0, 0.014, 0.25)),
    ],
)
def test_seven_wavelengths_see_the_colour_of_a_spectrum(
    depth: float, chromaticity: float, luminance: float, ozone: float
) -> None:
    """Light through air of a depth at 550 nm, of which ``ozone`` is a share; steps of 1 nm."""

    def through(nm: np.ndarray) -> np.ndarray:
        air = ((nm / 550) ** -4 + (nm / 550) ** -1.3) / 2
        absorbed = np.interp(nm, spectrum.BANDS_NM, spectrum.OZONE_CROSS_SECTION)
        absorbed /= np.interp(550, spectrum.BANDS_NM, spectrum.OZONE_CROSS_SECTION)
        return np.exp(-depth * ((1 - ozone) * air + ozone * absorbed))

    nm = np.arange(360.0, 781.0)
    light = np.interp(nm, spectrum.SUNLIGHT_NM, spectrum.SUNLIGHT)
    true = (light * through(nm)) @ spectrum.colour_matching(nm)
    true /= light @ spectrum.colour_matching(nm)[:, 1]
    rgb = through(np.array(spectrum.BANDS_NM)) @ spectrum.sunlight_colours()
    ours = spectrum.XYZ_FROM_RGB @ rgb
    np.testing.assert_allclose(ours[:2] / ours.sum(), true[:2] / true.sum(), atol=chromaticity)
    assert ours[1] == pytest.approx(true[1], rel=luminance)
