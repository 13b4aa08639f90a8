"""A code as a light model; the contract of all models is in tests/models/test_contract.py."""

import math
from dataclasses import replace

import pytest
import torch

from skylight.csc.code import SparseCode
from skylight.csc.coder import SphericalSparseCoder
from skylight.csc.dictionary import isotropic
from skylight.csc.light import SparseLight
from skylight.errors import InputError
from skylight.sphere.envmap import luminance
from skylight.sphere.frame import angles_from_direction, direction_from_angles


@pytest.fixture(scope="module")
def coder() -> SphericalSparseCoder:
    """With pixels: maps of 64 rows have layers."""
    return SphericalSparseCoder(isotropic(20, 4), height=64)


def code_of(coder: SphericalSparseCoder, filters: list[int], weights: list[float]) -> SparseCode:
    turn = torch.arange(len(filters), dtype=torch.float64)
    return SparseCode(
        dictionary=coder.bank.name,
        fingerprint=coder.bank.fingerprint,
        height=coder.height,
        banded=coder.banded,
        filters=torch.tensor(filters),
        directions=direction_from_angles(turn, 0.6 + 0.4 * turn),
        twists_rad=0.3 * turn,
        weights=torch.tensor(weights).double()[:, None] * torch.tensor([1.0, 0.8, 0.5]).double(),
        relative_error=0.0,
    )


@pytest.mark.parametrize("weights", [[3.0, 1.0, 0.5, 0.2, 0.1, 0.0], [3, 1, 0.5, -0.2, -0.1, -1]])
@pytest.mark.parametrize("height", [64, 24])
def test_starts_is_the_decoded_code_of_mean_one(
    coder: SphericalSparseCoder, weights: list[float], height: int
) -> None:
    pixel = coder.count - 1
    code = code_of(coder, [0, 2, 4, pixel, pixel, pixel], weights)
    model = SparseLight(code, coder, height=height)
    light = model.radiance(model.starts().double())[0]
    decoded = coder.decode(code, height).clamp(min=0).flatten(0, 1)
    above = (model.grid.directions[:, 1] > 0) * model.grid.solid_angles
    level = luminance(decoded) @ above / (2 * math.pi)
    torch.testing.assert_close(light, decoded / level, rtol=1e-5, atol=1e-5)


def test_code_is_left_as_it_was(coder: SphericalSparseCoder) -> None:
    code = code_of(coder, [0, 1], [3.0, 1.0])
    before = code.weights.clone()
    SparseLight(code, coder, height=16)
    assert torch.equal(code.weights, before)


def test_bounds_are_those_of_the_weights(coder: SphericalSparseCoder) -> None:
    low, high = SparseLight(code_of(coder, [0, 1], [3.0, 0.0]), coder, height=16).bounds
    assert low.tolist() == [0.0] * 6 + [-math.inf]
    assert high.isinf().all()
    low, _ = SparseLight(code_of(coder, [0, 1], [3.0, -0.1]), coder, height=16).bounds
    assert low.isinf().all()


def test_brightest_goes_to_the_azimuth(coder: SphericalSparseCoder) -> None:
    model = SparseLight(code_of(coder, [0, 4, 4], [3.0, 1.0, 2.0]), coder, height=64)
    azimuth = torch.tensor([0.0, 1.9, -2.5], dtype=torch.float64)
    directions = direction_from_angles(azimuth, torch.full_like(azimuth, 0.4))
    starts = model.starts_towards(directions).double()
    brightest = luminance(model.radiance(starts[:, 0])).argmax(1)
    found, zenith = angles_from_direction(model.grid.directions[brightest])
    difference = torch.remainder(found - azimuth + math.pi, 2 * math.pi) - math.pi
    assert difference.abs().max() < 2 * math.pi / 128
    assert (zenith - 1.4).abs().max() < 0.1  # the third activation's


def test_dark_above(coder: SphericalSparseCoder) -> None:
    """A pixel below the horizon alone: mean 1 over the whole sphere."""
    code = replace(
        code_of(coder, [coder.count - 1], [2.0]),
        directions=coder.transform.grid.directions[50 * 128 + 7][None],
    )
    model = SparseLight(code, coder, height=64)
    light = luminance(model.radiance(model.starts().double())[0])
    assert float(light @ model.grid.solid_angles) / (4 * math.pi) == pytest.approx(1, rel=1e-5)


@pytest.mark.parametrize("weights", [[0.0, 0.0], [-3.0, -1.0]])
def test_no_light(coder: SphericalSparseCoder, weights: list[float]) -> None:
    with pytest.raises(InputError, match="no light"):
        SparseLight(code_of(coder, [0, 0], weights), coder, height=16)


def test_code_of_another_dictionary(coder: SphericalSparseCoder) -> None:
    code = replace(code_of(coder, [0, 1], [1.0, 1.0]), fingerprint="0" * 12)
    with pytest.raises(InputError, match="make a coder that matches"):
        SparseLight(code, coder, height=16)
