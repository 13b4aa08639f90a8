import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from scipy.integrate import dblquad, quad
from scipy.special import eval_legendre, ive, sph_harm_y

from skylight.csc import _dictionary as dictionary
from skylight.csc._dictionary import FilterBank, builtin, load_dictionary, project_about_pole
from skylight.errors import InputError
from skylight.io._tensors import write_tensors
from skylight.sphere import _harmonics as harmonics, _lobes as lobes
from skylight.sphere._frame import DirectionGrid

F64 = torch.float64
SIZES = {"iso": 101, "ani": 201, "vmf": 2, "box": 201}


def number(value: float) -> torch.Tensor:
    return torch.full((1, 1, 1), value, dtype=F64)


def random_bank(count: int = 4, degree: int = 3, name: str = "random") -> FilterBank:
    generator = torch.Generator().manual_seed(count)
    return FilterBank(torch.randn(count, (degree + 1) ** 2, generator=generator, dtype=F64), name)


def zonal_index(degree: int) -> torch.Tensor:
    l = torch.arange(degree + 1)  # noqa: E741
    return l * (l + 1)


# projection


@pytest.mark.parametrize("kappa", [1.0, 800.0])
def test_von_mises_fisher_has_bessel_functions_for_coefficients(kappa: float) -> None:
    """c_l0 = sqrt(4 pi (2 l + 1)) exp(-kappa) i_l(kappa), modified spherical Bessel functions."""
    rows = project_about_pole(
        lambda theta, phi: lobes.von_mises_fisher(theta, number(kappa)), 40, columns=128
    )
    l = np.arange(41)  # noqa: E741
    bessel = ive(l + 0.5, kappa) * math.sqrt(math.pi / (2 * kappa))
    expected = torch.zeros(1, 41**2, dtype=F64)
    expected[0, zonal_index(40)] = torch.from_numpy(np.sqrt(4 * math.pi * (2 * l + 1)) * bessel)
    torch.testing.assert_close(rows, expected, atol=1e-13, rtol=1e-11)


def test_shipped_von_mises_fisher_is_that_of_kappa_80() -> None:
    l = np.arange(41)  # noqa: E741
    expected = torch.from_numpy(np.sqrt(2 * l + 1) * ive(l + 0.5, 80))
    zonal = builtin("vmf").coefficients[1, zonal_index(40)]
    torch.testing.assert_close(zonal, expected / expected.norm(), atol=1e-12, rtol=1e-9)


@pytest.mark.parametrize("row", [1, 40, 100])
def test_isotropic_agrees_with_adaptive_quadrature(row: int) -> None:
    a = math.expm1(math.log1p(14.33) * row / 100)
    bands = [0, 1, 2, 7, 20, 40]

    def integrand(theta: float, band: int) -> float:
        value = math.exp(-4 * a * a * math.tan(theta / 2) ** 2) * math.sin(theta)
        return value * eval_legendre(band, math.cos(theta)) * math.sqrt(2 * band + 1)

    ends = [0.0, *(x for x in (1 / a, 5 / a) if x < 3), 3.0, math.pi]
    expected = torch.tensor(
        [
            sum(quad(integrand, p, q, args=(band,), limit=200)[0] for p, q in pairwise(ends))
            for band in bands
        ],
        dtype=F64,
    )
    got = builtin("iso").coefficients[row, zonal_index(40)[bands]]
    torch.testing.assert_close(got / got[0], expected / expected[0], atol=1e-9, rtol=1e-6)


@pytest.mark.parametrize(("l", "m"), [(0, 0), (5, 2), (8, 6), (7, 3), (6, -2)])
def test_anisotropic_agrees_with_adaptive_quadrature(l: int, m: int) -> None:  # noqa: E741
    a1, a2 = 0.8, 2.5
    row = project_about_pole(
        lambda theta, phi: lobes.anisotropic_gaussian(theta, phi, number(a1), number(a2)), 8
    )

    def integrand(theta: float, phi: float) -> float:
        along, across = a1 * math.cos(phi), a2 * math.sin(phi)
        lobe = math.exp(-4 * math.tan(theta / 2) ** 2 * (along**2 + across**2))
        value = complex((-1) ** m * sph_harm_y(l, abs(m), theta, phi))
        part = (value.imag if m < 0 else value.real) * (1 if m == 0 else math.sqrt(2))
        return lobe * part * math.sin(theta)

    expected, _ = dblquad(integrand, 0, 2 * math.pi, 0, math.pi, epsabs=1e-8, epsrel=1e-8)
    assert float(row[0, l * (l + 1) + m]) == pytest.approx(expected, abs=1e-7)


def test_filters_lie_at_the_zenith_and_are_long_along_z() -> None:
    directions = DirectionGrid.hammersley(500).directions
    x, y, z = directions.unbind(1)
    theta, phi = torch.acos(y), torch.atan2(x, z)  # phi from +Z towards +X
    a1, a2 = torch.tensor(1.0, dtype=F64), torch.tensor(4.0, dtype=F64)
    lobe = lobes.anisotropic_gaussian(theta, phi, a1, a2)
    bank = FilterBank.project(
        lambda theta, phi: lobes.anisotropic_gaussian(theta, phi, a1, a2)[None], 40, "one"
    )
    value = bank.evaluate(directions)[0]
    scale = (value @ lobe) / (lobe @ lobe)
    torch.testing.assert_close(value / scale, lobe, atol=1e-4, rtol=0)


def test_half_a_sphere_on_a_cap() -> None:
    """The cap's solid angle and first moment: sqrt(4 pi) c_00 and sqrt(4 pi / 3) c_10."""
    rows = project_about_pole(
        lambda theta, phi: torch.ones(1, theta.shape[0], phi.shape[0], dtype=F64),
        1,
        cap_rad=math.pi / 3,
        rows=4,
        columns=8,
    )
    assert math.sqrt(4 * math.pi) * float(rows[0, 0]) == pytest.approx(math.pi)
    assert math.sqrt(4 * math.pi / 3) * float(rows[0, 2]) == pytest.approx(math.pi * 0.75)


def test_twice_the_samples_give_the_same_anisotropic_filters() -> None:
    bank = builtin("ani")
    for row, (a1, ratio) in {10: (0.5, 1.0), 9: (0.5, 0.9), 100: (14.33 / 2, 1.0)}.items():
        limit = 14.33 / math.sqrt(1 + 1 / (9 * a1**4))
        a2 = a1 * (limit / a1) ** ratio
        fine = FilterBank.project(
            lambda theta, phi, a1=a1, a2=a2: lobes.anisotropic_gaussian(
                theta, phi, number(a1), number(a2)
            ),
            40,
            "fine",
        )
        finer = project_about_pole(
            lambda theta, phi, a1=a1, a2=a2: lobes.anisotropic_gaussian(
                theta, phi, number(a1), number(a2)
            ),
            40,
            rows=512,
            columns=1024,
        )
        finer = finer / finer.norm()
        torch.testing.assert_close(fine.coefficients, finer, atol=1e-10, rtol=0)
        torch.testing.assert_close(bank.coefficients[row : row + 1], finer, atol=1e-10, rtol=0)


# the dictionaries


@pytest.mark.parametrize("name", list(SIZES))
def test_builtin_has_unit_filters_and_the_constant_first(name: str) -> None:
    bank = load_dictionary(name)
    assert (bank.name, len(bank), bank.degree) == (name, SIZES[name], 40)
    assert bank.coefficients.dtype == F64
    torch.testing.assert_close(
        bank.coefficients.norm(dim=1), torch.ones(len(bank), dtype=F64), atol=1e-14, rtol=0
    )
    assert bank.coefficients[0, 0] == 1
    assert torch.count_nonzero(bank.coefficients[:, 0] == 1) == 1
    gram = bank.coefficients @ bank.coefficients.T - torch.eye(len(bank), dtype=F64)
    assert gram.max() < 1 - 1e-9  # no filter twice


def test_symmetry_is_exact() -> None:
    l = harmonics.bands(40)  # noqa: E741
    m = torch.arange(len(l)) - l * (l + 1)
    for name in ("iso", "vmf"):
        assert torch.count_nonzero(load_dictionary(name).coefficients[:, m != 0]) == 0
    ani = builtin("ani").coefficients
    assert torch.count_nonzero(ani[:, (m < 0) | (m % 2 != 0)]) == 0
    assert (ani[1:101, (m > 0) & (m % 2 == 0)].abs().amax(dim=1) > 1e-3).all()
    assert torch.equal(ani[101:], builtin("iso").coefficients[1:])
    assert torch.equal(builtin("box").coefficients, ani)


def test_filters_hardly_ring() -> None:
    iso, ani, vmf = (load_dictionary(name).undershoot() for name in ("iso", "ani", "vmf"))
    assert iso[0] == pytest.approx(-1)
    assert iso[2:].max() < 0.019  # the last of them is the sharpest
    assert iso[100] > 0.017
    assert iso[1] < 0.1  # a = 0.028: the hole at the antipode
    assert ani[1:101].max() < 0.021
    assert vmf[1] < 1e-5


@pytest.mark.parametrize("degree", [8, 20])
def test_lower_degrees_ring_as_little(degree: int) -> None:
    assert dictionary.isotropic(degree).undershoot()[20:].max() < 0.02
    assert dictionary.anisotropic(degree).undershoot()[1:101].max() < 0.026


def test_undershoot_is_that_of_a_fine_meridian() -> None:
    bank = FilterBank.project(lambda theta, phi: lobes.gaussian(theta, number(20.0)), 40, "sharp")
    theta = torch.linspace(0, math.pi, 4001, dtype=F64)
    meridian = torch.stack([torch.zeros_like(theta), theta.cos(), theta.sin()], dim=-1)
    value = bank.evaluate(meridian)
    assert float(bank.undershoot()) == pytest.approx(float(-value.min() / value.max()), rel=0.03)
    assert bank.undershoot() > 0.05  # beyond 14.33 they do ring


def test_builtin_is_the_callers_own() -> None:
    with torch.no_grad():
        builtin("vmf").coefficients.zero_()
    assert builtin("vmf").coefficients[0, 0] == 1


# the bank


def test_filters_are_normalised_once() -> None:
    bank = random_bank()
    again = FilterBank(bank.coefficients, "again")
    assert torch.equal(again.coefficients, bank.coefficients)
    scaled = FilterBank(7 * bank.coefficients, "scaled")
    torch.testing.assert_close(scaled.coefficients, bank.coefficients)


def test_cut_keeps_the_lower_bands() -> None:
    bank = random_bank(degree=5)
    cut = bank.cut(2)
    kept = bank.coefficients[:, :9]
    assert cut.degree == 2
    torch.testing.assert_close(cut.coefficients, kept / kept.norm(dim=1, keepdim=True))
    assert torch.equal(bank.cut(5).coefficients, bank.coefficients)
    with pytest.raises(InputError, match="ends at degree 5"):
        bank.cut(6)


def test_joined_keeps_one_constant() -> None:
    iso, vmf = dictionary.isotropic(6, 5), dictionary.von_mises_fisher(6, 4.0)
    both = FilterBank.joined("both", iso, vmf)
    assert (both.name, len(both)) == ("both", 7)
    assert torch.equal(both.coefficients[:6], iso.coefficients)
    assert torch.equal(both.coefficients[6], vmf.coefficients[1])
    with pytest.raises(InputError, match=r"degrees \[3, 6\]"):
        FilterBank.joined("both", iso, random_bank())


def test_fingerprint_is_of_the_filters_alone() -> None:
    bank = random_bank()
    assert len(bank.fingerprint) == 12
    assert FilterBank(bank.coefficients, "other").fingerprint == bank.fingerprint
    jitter = bank.coefficients + 1e-15
    assert FilterBank(jitter, "rounding").fingerprint == bank.fingerprint
    assert FilterBank(bank.coefficients.flip(0), "order").fingerprint != bank.fingerprint
    assert random_bank(5).fingerprint != bank.fingerprint
    assert len({load_dictionary(name).fingerprint for name in SIZES}) == 3


def test_what_is_saved_comes_back(tmp_path: Path) -> None:
    bank = random_bank(name="märchen")
    bank.save(tmp_path / "bank.safetensors")
    back = FilterBank.load(tmp_path / "bank.safetensors")
    assert torch.equal(back.coefficients, bank.coefficients)
    assert (back.name, back.fingerprint) == (bank.name, bank.fingerprint)
    cut = load_dictionary(str(tmp_path / "bank.safetensors"), 2)
    assert torch.equal(cut.coefficients, bank.cut(2).coefficients)


@pytest.mark.parametrize("damage", ["missing", "folder", "short", "noise", "foreign", "version"])
def test_other_files_are_refused_in_one_line(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "bank.safetensors"
    bank = random_bank()
    bank.save(path)
    whole = path.read_bytes()
    if damage in ("missing", "folder"):
        path.unlink()
        if damage == "folder":
            path.mkdir()
    elif damage == "short":
        path.write_bytes(whole[:-8])
    elif damage == "noise":
        path.write_bytes(b"\xff" * 100)
    elif damage == "foreign":
        save_file({"coefficients": bank.coefficients}, path)
    else:
        metadata = {"format": dictionary.FORMAT, "version": "9"}
        write_tensors(path, {"coefficients": bank.coefficients}, metadata)
    with pytest.raises(InputError, match=r"bank\.safetensors") as caught:
        FilterBank.load(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("tensors", "message"),
    [
        ({"filters": torch.ones(2, 4)}, "coefficients"),
        ({"coefficients": torch.ones(4)}, "no table"),
        ({"coefficients": torch.ones(2, 4, dtype=torch.int64)}, "no table"),
        ({"coefficients": torch.ones(2, 5)}, "got 5"),
        ({"coefficients": torch.zeros(2, 4)}, "not finite"),
    ],
)
def test_files_with_other_tensors_are_refused(
    tmp_path: Path, tensors: dict[str, torch.Tensor], message: str
) -> None:
    path = tmp_path / "bank.safetensors"
    metadata = {"format": dictionary.FORMAT, "version": dictionary.VERSION}
    write_tensors(path, tensors, metadata)
    with pytest.raises(InputError, match=message):
        FilterBank.load(path)


def test_unusable_filters_are_refused() -> None:
    good = random_bank().coefficients
    with pytest.raises(InputError, match="no filters"):
        FilterBank(good[:0], "empty")
    with pytest.raises(InputError, match=r"'odd'.*got 15"):
        FilterBank(good[:, :15], "odd")
    with pytest.raises(InputError, match=r"'dark': 1 of 4 .*number 2"):
        FilterBank(good * (torch.arange(4) != 2)[:, None], "dark")
    bad = good.clone()
    bad[1, 0], bad[3, 3] = math.nan, math.inf
    with pytest.raises(InputError, match=r"2 of 4 .*number 1, 3"):
        FilterBank(bad, "broken")


def test_unknown_dictionaries_and_sizes_are_refused() -> None:
    with pytest.raises(InputError, match="iso, ani, vmf"):
        load_dictionary("kmeans")
    with pytest.raises(InputError, match="no square"):
        dictionary.anisotropic(8, 99)
    with pytest.raises(InputError, match="degree 3 or more"):
        dictionary.anisotropic(2)
