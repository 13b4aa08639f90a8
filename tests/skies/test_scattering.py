"""Light scattered between layers, and the colours of seven wavelengths."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.skies import _scattering as spectrum
from skylight.skies._scattering import LayeredScattering, _modes, henyey_greenstein, rayleigh

DEPTH = torch.tensor([[0.05, 0.3, 2.0, 1e-9], [0.5, 0.01, 0.1, 0.2]])
VIEWS = torch.tensor([0.0, 0.3, 1.0])


def layers(ground_albedo: float) -> LayeredScattering:
    """Half air, half haze, which absorb nothing."""
    return LayeredScattering(
        DEPTH / 2, DEPTH / 2, DEPTH, haze_g=0.76, ground_albedo=ground_albedo, views=VIEWS
    )


@pytest.mark.parametrize("g", [-0.2, 0.0, 0.7, 0.96])
def test_phase_function_integrates_to_one(g: float) -> None:
    node, weight = np.polynomial.legendre.leggauss(400)
    value = henyey_greenstein(torch.tensor(node), g).numpy()
    assert 2 * math.pi * (weight @ value) == pytest.approx(1, rel=1e-9)
    assert 2 * math.pi * (weight @ (value * node)) == pytest.approx(g, abs=1e-9)  # asymmetry


def test_modes_add_up_to_the_phase_function() -> None:
    """1 + cos^2 has three of them; of Henyey & Greenstein's at g = 0.3 eight leave g^8 = 7e-5."""
    a, b = torch.tensor([0.2, -0.9]).double(), torch.tensor([0.7]).double()
    for phase in (rayleigh, lambda c: henyey_greenstein(c, 0.3)):
        for phi in (0.0, 1.1, 3.0):
            c = a * b + torch.sqrt((1 - a**2) * (1 - b**2)) * math.cos(phi)
            modes = _modes(a, b, phase)[..., 0]
            summed = sum(m * math.cos(i * phi) for i, m in enumerate(modes))
            torch.testing.assert_close(summed, phase(c), rtol=1e-3, atol=0)


def test_even_light_is_scattered_evenly() -> None:
    """Radiance 1 from all sides gives J = 1 where nothing is absorbed: no energy is made."""
    scattering = layers(0.0)
    for phases in (scattering._between, scattering._to_views):
        for phase in phases:
            torch.testing.assert_close(
                phase[0].sum(1), torch.ones(1, phase.shape[-1]), rtol=1e-5, atol=0
            )


def test_all_is_alike_in_an_evenly_glowing_enclosure() -> None:
    """Layers and ground of radiance 1, and above them what a sky of 1 would add: 1 everywhere."""
    scattering = layers(1.0)
    ones = torch.ones(8, *DEPTH.shape, 16)
    light = scattering._light(ones, torch.full((2,), math.pi))[0]
    torch.testing.assert_close(light[..., 8:], torch.ones_like(light[..., 8:]), rtol=1e-5, atol=0)
    slant = DEPTH[..., None] / scattering._cosines[:8]
    above = slant.flip(1).cumsum(1).flip(1) - slant
    from_sky = torch.exp(-above) * -torch.expm1(-slant) / slant
    torch.testing.assert_close(light[..., :8] + from_sky, torch.ones_like(from_sky))


def test_light_on_the_ground_in_an_evenly_glowing_air() -> None:
    """pi under layers too thick to see through, 2 pi times the depth times J under thin ones."""
    thick = torch.tensor([[50.0]])
    thin = torch.tensor([[1e-4]])
    for depth, expected in ((thick, math.pi), (thin, 2 * math.pi * 1e-4)):
        scattering = LayeredScattering(
            depth, 0 * depth, depth, haze_g=0.0, ground_albedo=0.0, views=VIEWS
        )
        onto = scattering._onto_ground(torch.ones(8, 1, 1, 16))
        assert float(onto) == pytest.approx(expected, rel=2e-3)


def test_linear_in_sunlight() -> None:
    scattering = layers(0.3)
    cos_sun = torch.tensor(0.4)
    seeded = torch.Generator().manual_seed(0)
    light, ground = torch.rand(2, 4, generator=seeded), torch.rand(2, generator=seeded)
    once = scattering.towards_views(cos_sun, light, ground)
    assert once.shape == (8, 2, 4, 3)
    torch.testing.assert_close(scattering.towards_views(cos_sun, 3 * light, 3 * ground), 3 * once)


@pytest.mark.parametrize("ground_albedo", [0.0, 0.3, 1.0])
def test_later_orders_are_added(ground_albedo: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Many more orders, one by one, change less than 1e-3 where nothing is absorbed in the air."""
    scattering = layers(ground_albedo)
    sun = torch.tensor(0.4), torch.ones(2, 4), torch.ones(2)
    ours = scattering.towards_views(*sun)
    monkeypatch.setattr("skylight.skies._scattering.ORDERS", 300)
    more = scattering.towards_views(*sun)
    assert ((ours - more).abs() < 1e-3 * more[0]).all()


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
