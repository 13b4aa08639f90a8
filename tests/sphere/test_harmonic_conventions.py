"""27 numbers as others evaluate them: their formulas, written out, against our irradiance."""

import inspect
import math

import pytest
import torch

from skylight.errors import InputError
from skylight.sphere._harmonics import HarmonicConvention, to_convention
from tests.oracles.harmonics import from_convention, irradiance

LIGHT = torch.randn(9, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
NORMALS = torch.nn.functional.normalize(
    torch.randn(50, 3, generator=torch.Generator().manual_seed(4), dtype=torch.float64), dim=1
)
# hello_ar_java's sphericalHarmonicFactors
ARCORE_FACTORS = (
    0.282095, -0.325735, 0.325735, -0.325735, 0.273137, -0.273137, 0.078848, -0.273137, 0.136569
)  # fmt: skip


def polynomials(normals: torch.Tensor) -> torch.Tensor:
    """1, y, z, x, xy, yz, 3 z^2 - 1, xz, x^2 - y^2: all programs here agree on these."""
    x, y, z = normals.unbind(1)
    one = torch.ones_like(x)
    return torch.stack([one, y, z, x, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y], 1)


@pytest.mark.parametrize("convention", ["arcore", "gltf"])
def test_numbers_come_back(convention: HarmonicConvention) -> None:
    numbers = to_convention(LIGHT, convention)
    assert numbers.shape == (27,)
    torch.testing.assert_close(from_convention(numbers, convention), LIGHT)


def test_arcores_sample_shader_finds_our_irradiance() -> None:
    numbers = to_convention(LIGHT, "arcore").reshape(9, 3)
    coefficients = numbers * torch.tensor(ARCORE_FACTORS, dtype=torch.float64)[:, None]
    radiance = polynomials(NORMALS) @ coefficients  # of a white diffuse surface
    torch.testing.assert_close(radiance, irradiance(LIGHT, NORMALS) / math.pi, atol=2e-5, rtol=1e-5)


def test_threejs_formula_finds_our_irradiance() -> None:
    # SphericalHarmonics3.getIrradianceAt
    numbers = to_convention(LIGHT, "threejs").reshape(9, 3)
    x, y, z = NORMALS.unbind(1)
    first, second = 2 * 0.511664, 2 * 0.429043
    basis = torch.stack(
        [torch.full_like(x, 0.886227), first * y, first * z, first * x, second * x * y,
         second * y * z, 0.743125 * z * z - 0.247708, second * x * z,
         0.429043 * (x * x - y * y)], 1
    )  # fmt: skip
    torch.testing.assert_close(basis @ numbers, irradiance(LIGHT, NORMALS), atol=2e-5, rtol=1e-5)


def test_babylons_basis_finds_our_irradiance_where_it_puts_a_gltf_scene() -> None:
    constants = torch.tensor(
        [math.sqrt(1 / 4 / math.pi), *[math.sqrt(3 / 4 / math.pi)] * 3,
         *[math.sqrt(15 / 4 / math.pi)] * 2, math.sqrt(5 / 16 / math.pi),
         math.sqrt(15 / 4 / math.pi), math.sqrt(15 / 16 / math.pi)], dtype=torch.float64
    )  # fmt: skip
    signs = torch.tensor([1, -1, 1, -1, 1, -1, 1, -1, 1])
    numbers = to_convention(LIGHT, "gltf").reshape(9, 3)
    # the loader's root turns glTF's (x, y, z) into (-x, y, z)
    there = NORMALS * torch.tensor([-1.0, 1.0, 1.0])
    found = polynomials(there) @ (numbers * (constants * signs)[:, None])
    torch.testing.assert_close(found, irradiance(LIGHT, NORMALS))


def test_arkit_has_a_plane_for_each_colour() -> None:
    numbers = to_convention(LIGHT, "arkit")
    torch.testing.assert_close(numbers[9:18], LIGHT[:, 1])


def test_an_unknown_convention_is_named() -> None:
    with pytest.raises(InputError, match="'dx9'"):
        # the type checker of the tests would stop it first
        inspect.unwrap(to_convention)(LIGHT, "dx9")  # pyright: ignore
