"""Against published matrices and points of the curves."""

import numpy as np
import pytest

from skylight.io._colour_spaces import (
    CHROMATICITIES,
    ColourSpace,
    colour_space_named,
    colour_space_of_cicp,
    converted,
    linear_light,
    to_rec709,
    to_xyz,
)

# BT.2087-0, 2020 to 709 (table 4's M2 inverted, 4 digits); ACES CTL AP1 and AP0 to Rec.709
# (ACESlib, D60 to D65 by Bradford); P3 and Adobe RGB of CSS Color 4's
# sample code; XYZ of IEC 61966-2-1, F.8
PUBLISHED = {
    "rec2020": [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]],
    "ap1": [
        [1.70505, -0.62179, -0.08326],
        [-0.13026, 1.14080, -0.01055],
        [-0.02400, -0.12897, 1.15297],
    ],
    "ap0": [
        [2.52169, -1.13413, -0.38756],
        [-0.27648, 1.37272, -0.09624],
        [-0.01538, -0.15298, 1.16835],
    ],
    "p3-d65": [
        [1.22494, -0.22494, 0.0],
        [-0.04206, 1.04206, 0.0],
        [-0.01964, -0.07864, 1.09827],
    ],
    "adobe-rgb": [[1.3984, -0.3984, 0.0], [0.0, 1.0, 0.0], [0.0, -0.0429, 1.0429]],
    "xyz-d65": [[3.2410, -1.5374, -0.4986], [-0.9692, 1.8760, 0.0416], [0.0556, -0.2040, 1.0570]],
}


@pytest.mark.parametrize("name", sorted(PUBLISHED))
def test_published_matrices(name) -> None:
    digits = 5 if name in ("ap0", "ap1", "p3-d65") else 4
    # they round to so many digits, and the standards' own inputs to the same
    np.testing.assert_allclose(to_rec709(name), PUBLISHED[name], atol=3 * 10.0**-digits)


@pytest.mark.parametrize("name", sorted(CHROMATICITIES))
def test_white_stays_white_and_chromaticities_say_the_same(name) -> None:
    np.testing.assert_allclose(to_rec709(name).sum(1), 1, atol=1e-12)
    told = tuple(float(np.float32(each)) for each in CHROMATICITIES[name])  # as files store them
    np.testing.assert_allclose(to_rec709(told), to_rec709(name), atol=1e-12)


def test_light_keeps_its_xyz_where_pictures_keep_their_white() -> None:
    """Equal AP1 values are the colour of D60: 0.32168, 0.33767 (S-2014-004)."""
    grey = np.full((1, 1, 3), 0.5, np.float32)
    light, said = converted(grey, ColourSpace(primaries="ap1"))
    x, y, z = to_xyz("rec709") @ light[0, 0].astype(np.float64)
    assert (x / (x + y + z), y / (x + y + z)) == pytest.approx((0.32168, 0.33767), abs=1e-6)
    assert y == pytest.approx(0.5, rel=1e-6)
    assert "white" in said[0]


def test_what_becomes_negative_is_cut_and_counted() -> None:
    values = np.zeros((2, 2, 3), np.float32)
    values[0, 0, 1] = 1  # a green that Rec.709 has not
    values[1, 1] = [0.2, -0.1, 0.3]  # no colour before either
    light, (said,) = converted(values, ColourSpace(primaries="rec2020"))
    assert light[0, 0].min() == 0
    assert light[1, 1].min() < 0
    assert "Rec.2020" in said
    assert "1 pixel(s)" in said
    white, said = converted(np.ones((1, 1, 3), np.float32), None)
    assert (said, white.max()) == ([], 1)


def test_own_primaries() -> None:
    """Primaries that have no name: P3's with the white of D50; the white is adapted."""
    own = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3457, 0.3585)
    space = ColourSpace(primaries=own)
    assert "own primaries" in str(space)
    got = space.linear_rec709(np.full((2, 2, 3), 0.5, np.float32))
    np.testing.assert_allclose(got, 0.5, rtol=1e-6)


def test_points_of_the_curves() -> None:
    # ST 2084: 100 cd/m2 is 0.5081 of the signal, 1000 is 0.7518, 10000 is 1 (BT.2408, annex 1)
    pq = linear_light(np.array([0.0, 0.508078, 0.751827, 1.0]), "pq") * 203
    np.testing.assert_allclose(pq, [0, 100, 1000, 10_000], rtol=1e-5)
    # BT.2408-7, table 1: HLG 75 % is reference white, which is 26.5 % of the scene's peak
    hlg = linear_light(np.array([0.0, 0.5, 0.75, 1.0]), "hlg")
    np.testing.assert_allclose(hlg, [0, 1 / 12 / 0.26496, 1, 1 / 0.26496], rtol=1e-4)
    # BT.709: 18 % of light is 40.9 % of the signal; sRGB: 46.1 %
    assert linear_light(np.array([0.4090]), "rec709") == pytest.approx(0.18, abs=2e-4)
    assert linear_light(np.array([0.4613]), "srgb") == pytest.approx(0.18, abs=2e-4)
    assert linear_light(np.array([0.5]), 2.2) == pytest.approx(0.5**2.2)
    assert linear_light(np.array([-0.5]), 2.2) == pytest.approx(-(0.5**2.2))


@pytest.mark.parametrize(
    ("name", "primaries", "transfer"),
    [
        ("lin_rec709_scene", "rec709", "linear"),
        ("lin_ap0_scene", "ap0", "linear"),
        ("lin_ciexyzd65_scene", "xyz-d65", "linear"),
        ("srgb_p3d65_scene", "p3-d65", "srgb"),
        ("srgb_ap1_scene", "ap1", "srgb"),
        ("g18_rec709_scene", "rec709", 1.8),
        ("g22_adobergb_scene", "adobe-rgb", 563 / 256),
        ("g26_xyzd65_display", "xyz-d65", 2.6),
        ("pq_rec2020_display", "rec2020", "pq"),
        ("hlg_rec2020_display", "rec2020", "hlg"),
        ("ocio:itu709_rec709_scene", "rec709", "rec709"),
        ("oiio:lin_prophoto_scene", "prophoto", "linear"),
        ("ACEScg", "ap1", "linear"),
        ("sRGB", "rec709", "srgb"),
        ("Linear", "rec709", "linear"),
    ],
)
def test_names(name, primaries, transfer) -> None:
    assert colour_space_named(name) == ColourSpace(primaries=primaries, transfer=transfer)


def test_names_that_say_nothing_and_unknown_ones() -> None:
    assert colour_space_named("unknown") is colour_space_named("data") is None
    for name in ("lin_awg3_scene", "ocio:acescct_ap1_scene", "mine"):
        with pytest.raises(ValueError, match="not known here"):
            colour_space_named(name)


def test_code_points() -> None:
    assert colour_space_of_cicp(9, 16) == ColourSpace(primaries="rec2020", transfer="pq")
    assert colour_space_of_cicp(9, 18) == ColourSpace(primaries="rec2020", transfer="hlg")
    assert colour_space_of_cicp(12, 13) == ColourSpace(primaries="p3-d65", transfer="srgb")
    assert colour_space_of_cicp(1, 8) == ColourSpace()
    assert colour_space_of_cicp(2, 2) is None
    for codes in ((0, 13), (1, 12)):
        with pytest.raises(ValueError, match="CICP"):
            colour_space_of_cicp(*codes)


def test_what_is_no_colour_space() -> None:
    line = (0.1, 0.1, 0.2, 0.2, 0.3, 0.3, 0.3127, 0.329)
    nothing = (float("nan"),) * 8
    zero = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3, 0.0)
    for primaries in (line, nothing, zero):
        with pytest.raises(ValueError, match="chromaticities"):
            ColourSpace(primaries=primaries)
    with pytest.raises(ValueError, match="exponent"):
        ColourSpace(transfer=0.0)


def test_what_is_linear_rec709_stays_bit_for_bit() -> None:
    values = np.random.default_rng(0).random((3, 4, 3), np.float32)
    assert ColourSpace().linear_rec709(values) is values
    near = tuple(each + 1e-3 for each in CHROMATICITIES["rec709"])
    assert ColourSpace(primaries=near).linear_rec709(values) is values
