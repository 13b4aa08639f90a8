"""Samples of a code are of the density that the sampler tells."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import pytest
import torch
from scipy.stats import chi2, kstest

from skylight.csc._code import CodeTensors
from skylight.csc._coder import SphericalSparseCoder, pixel_of
from skylight.csc._dictionary import FilterBank, builtin
from skylight.csc._gaussian_lobes import fitted_lobes
from skylight.csc._sampling import CodeSampler
from skylight.csc._sub_dictionaries import BOX_SIZES, SubDictionary
from skylight.errors import InputError
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid

F64 = torch.float64
CELLS = 16  # rows of cells, whose probabilities come from 8 x 8 points each
FINE = DirectionGrid.latlong(8 * CELLS)


@cache
def coder() -> SphericalSparseCoder:
    """Round lobes of degree 40 and 48, and pixels of 64 rows."""
    return SphericalSparseCoder("iso", height=64)


@cache
def long_coder() -> SphericalSparseCoder:
    return SphericalSparseCoder("ani", height=32)


def code(filters: list[int], *, seed: int = 0) -> CodeTensors:
    """These filters anywhere, with positive weights."""
    generator = torch.Generator().manual_seed(seed)
    turn = torch.rand(len(filters), 3, generator=generator, dtype=F64)
    rotations = turn * torch.tensor([2 * math.pi, math.pi, 2 * math.pi], dtype=F64)
    weights = 0.5 + torch.rand(len(filters), 3, generator=generator, dtype=F64)
    return CodeTensors(torch.tensor(filters), rotations, weights, torch.tensor(len(filters)))


@cache
def long_sampler() -> CodeSampler:
    """The constant, long lobes and round ones; float64."""
    return CodeSampler.of(code([0, 5, 37, 58, 150, 170]), long_coder(), dtype=F64)


@cache
def dotted_sampler() -> CodeSampler:
    """A wide lobe, a sharp one of 64 rows, and two pixels."""
    last = coder().count - 1
    return CodeSampler.of(code([40, 105, last, last]), coder(), dtype=F64)


def test_densities_integrate_to_one() -> None:
    for sampler in (long_sampler(), dotted_sampler()):
        for each in (sampler, sampler.towards(torch.tensor([0.0, 0.6, 0.8]))):
            total = float(each.pdf(FINE.directions) @ FINE.solid_angles)
            assert total == pytest.approx(1, abs=1e-3)
            assert float(each.shares.sum()) == pytest.approx(1, abs=1e-12)


def p_value(directions: torch.Tensor, sampler: CodeSampler) -> float:
    """Of Pearson's chi-square test of directions against ``sampler.pdf`` in 16 x 32 cells."""
    probability = in_cells(sampler.pdf(FINE.directions) * FINE.solid_angles)
    width = 2 * CELLS
    row = (torch.acos(directions[:, 1].clamp(-1, 1)) / math.pi * CELLS).long().clamp(0, CELLS - 1)
    azimuth = torch.atan2(directions[:, 0], -directions[:, 2])
    column = ((azimuth / (2 * math.pi) + 0.5) * width).long() % width
    seen = torch.bincount(row * width + column, minlength=CELLS * width).double()
    expected = probability / probability.sum() * len(directions)
    rare = expected < 10  # taken together
    expected = torch.cat([expected[~rare], expected[rare].sum()[None]])
    seen = torch.cat([seen[~rare], seen[rare].sum()[None]])
    kept = expected > 0
    statistic = float(((seen - expected).square() / expected)[kept].sum())
    return float(chi2.sf(statistic, int(kept.sum()) - 1))


def in_cells(fine: torch.Tensor) -> torch.Tensor:
    return fine.reshape(CELLS, 8, 2 * CELLS, 8).sum((1, 3)).flatten()


@pytest.mark.parametrize("make", [long_sampler, dotted_sampler])
def test_samples_pass_a_chi_square_test_that_wrong_densities_fail(
    make: Callable[[], CodeSampler],
) -> None:
    """200,000 draws; wrong are lobes 10 % too wide or turned by 3 degrees, and a share 20 % off."""
    sampler = make()
    for each in (sampler, sampler.towards(torch.tensor([0.0, 0.6, 0.8]))):
        directions = each.sample(200_000, torch.Generator().manual_seed(1))
        assert p_value(directions, each) > 1e-3

    directions = sampler.sample(200_000, torch.Generator().manual_seed(1))
    lobes, shares = sampler.lobes, sampler.shares.clone()
    wider = replace(lobes, precisions=lobes.precisions / 1.21)
    angle = math.radians(3)
    x, y, z = lobes.axes
    tilted = torch.stack([math.cos(angle) * x + math.sin(angle) * z, y, z], 0)
    tilted[2] = math.cos(angle) * z - math.sin(angle) * x
    largest = int(shares[1:].argmax()) + 1
    shares[largest] *= 1.2
    for wrong in (
        replace(sampler, lobes=wider),
        replace(sampler, lobes=replace(lobes, axes=tilted)),
        replace(sampler, shares=shares / shares.sum()),
    ):
        assert p_value(directions, wrong) < 1e-6


@cache
def lit_map() -> EnvironmentMap:
    """Blocks of noise, a lamp ten times as bright, and black ones; 128 rows."""
    radiance = torch.rand(32, 64, 3, generator=torch.Generator().manual_seed(0))
    radiance[5, 7] *= 10
    radiance[20:24, 30:40] = 0
    return EnvironmentMap(radiance=radiance.repeat_interleave(4, 0).repeat_interleave(4, 1))


def test_the_density_is_the_decoded_luminance_where_all_weights_are_positive() -> None:
    positive = code([0, 5, 37, 150, 170])
    sampler = CodeSampler.of(positive, long_coder(), uniform=1e-6, dtype=F64)
    decoded = luminance(long_coder().decode(positive, 128)).flatten().detach()
    power = decoded @ FINE.solid_angles
    density = sampler.pdf(FINE.directions)
    assert (density - decoded / power).abs().max() < 2e-3 * density.max()
    turned = positive._replace(rotations=positive.rotations + 0.1)
    wrong = CodeSampler.of(turned, long_coder(), uniform=1e-6, dtype=F64).pdf(FINE.directions)
    assert (wrong - decoded / power).abs().max() > 0.05 * density.max()


def test_pixels_are_drawn_within_themselves_with_their_share() -> None:
    sampler = dotted_sampler()
    only = replace(sampler, shares=torch.cat([0 * sampler.shares[:-2], sampler.shares[-2:]]))
    only = replace(only, shares=only.shares / only.shares.sum())
    directions = only.sample(2000, torch.Generator().manual_seed(0))
    pixels = sampler.boxes[:, 0].long() * 128 + sampler.boxes[:, 2]
    angles = DirectionGrid.latlong(64).solid_angles[pixels]
    torch.testing.assert_close(
        only.pdf(directions).unique(), (only.shares[-2:] / angles).unique(), rtol=1e-12, atol=0
    )


def of_boxes() -> tuple[CodeTensors, SphericalSparseCoder]:
    """Three boxes, one at a pole and one across the seam."""
    coder = SphericalSparseCoder(FilterBank(builtin("iso", 20).coefficients, "box"))
    boxes = coder.parts[-1]
    filters = [boxes.first + BOX_SIZES.index(size) for size in ((3, 4), (2, 1), (1, 8))]
    places = torch.tensor([[9, 20, 0], [0, 0, 0], [20, 62, 0]])
    weights = torch.tensor([[1.0, 2, 3], [0.5, 0.1, 0.2], [1, 1, 1]], dtype=F64)
    rotations = boxes.positions.rotations(places)
    return CodeTensors(torch.tensor(filters), rotations, weights, torch.tensor(3)), coder


def test_boxes_are_drawn_within_themselves() -> None:
    """The density is the decoded luminance, and every sample lies where there is light."""
    code, coder = of_boxes()
    sampler = CodeSampler.of(code, coder, uniform=1e-9, dtype=F64)
    decoded = luminance(coder.decode(code, 128).detach()).flatten()
    expected = decoded / (decoded @ FINE.solid_angles)
    torch.testing.assert_close(sampler.pdf(FINE.directions), expected, atol=1e-8, rtol=1e-8)
    drawn = sampler.sample(20_000, torch.Generator().manual_seed(0))
    assert (decoded[pixel_of(drawn, (128, 256))] > 0).all()
    assert float(sampler.pdf(drawn).reciprocal().mean()) == pytest.approx(
        float(FINE.solid_angles[decoded > 0].sum()), rel=0.05
    )


@pytest.mark.parametrize("box", [0, 1])
def test_draws_are_uniform_within_a_box(box: int) -> None:
    """Kolmogorov and Smirnov's test of 20,000 heights and longitudes, 3 x 4 and 2 x 1 at a pole.

    Solid angle is proportional to steps of cos(theta), and to those of longitude.
    """
    row, rows, left, columns = [(8, 3, 19, 4), (0, 2, 0, 1)][box]
    sampler = CodeSampler.of(*of_boxes(), dtype=F64)
    assert [row, rows, left, columns] == sampler.boxes[box].tolist()
    shares = torch.zeros_like(sampler.shares)
    shares[len(sampler.lobes.precisions) + box] = 1
    only = replace(sampler, shares=shares)
    drawn = only.sample(20_000, torch.Generator().manual_seed(0))
    upper, lower = (math.cos(math.pi * edge / 32) for edge in (row, row + rows))
    down = (upper - drawn[:, 1]) / (upper - lower)
    # columns begin at -180 degrees, with -z in the middle
    azimuth = torch.atan2(drawn[:, 0], -drawn[:, 2])
    along = ((azimuth / (2 * math.pi) + 0.5) * 64 - left) / columns
    for fraction in (down, along):
        assert kstest(fraction.numpy(), "uniform").pvalue > 1e-3
    assert abs(float(torch.corrcoef(torch.stack([down, along]))[0, 1])) < 4 / math.sqrt(20_000)


def test_boxes_towards_a_normal_count_by_their_mean_cosine() -> None:
    code, coder = of_boxes()
    normal = torch.tensor([0.6, 0.64, -0.48], dtype=F64)
    sampler = CodeSampler.of(code, coder, dtype=F64)
    cosine = (FINE.directions @ normal).clamp(min=0) * FINE.solid_angles
    means = []
    for n in range(3):
        one = CodeTensors(
            code.filters[n : n + 1],
            code.rotations[n : n + 1],
            code.weights[n : n + 1],
            torch.tensor(1),
        )
        light = luminance(coder.decode(one, 128).detach()).flatten()
        means.append(float(light @ cosine / (light @ FINE.solid_angles)))
    found = sampler.towards(normal).shares[-3:] / sampler.shares[-3:]
    expected = torch.tensor(means, dtype=F64)
    assert expected.max() > 2 * expected.min()
    torch.testing.assert_close(
        found / found.max(), expected / expected.max(), rtol=0.02, atol=0.005
    )


def test_a_sun_does_not_leave_its_pixel_by_rounding() -> None:
    """Single precision: a map of twice the rows, bright in the pixels alone, has no outliers."""
    last = coder().count - 1
    sampler = CodeSampler.of(code([last, last], seed=3), coder(), uniform=0.01)
    bright = torch.zeros(64 * 128)
    bright[sampler.boxes[:, 0].long() * 128 + sampler.boxes[:, 2]] = 1
    fine = bright.view(64, 128).repeat_interleave(2, 0).repeat_interleave(2, 1).flatten()
    directions = sampler.sample(1_000_000, torch.Generator().manual_seed(0))
    lit = fine[pixel_of(directions.double(), (128, 256))] > 0
    density = sampler.pdf(directions[lit])
    assert density.min() > 0.1 * density.max()


def test_integrals_are_estimated_without_bias() -> None:
    """The irradiance of a map that the code has not seen, to 4 standard errors; 2e5 samples."""
    normal = torch.tensor([0.6, 0.0, -0.8], dtype=F64)

    def integrand(directions: torch.Tensor) -> torch.Tensor:
        light = 1 + torch.sin(3 * directions[:, 0]) * directions[:, 1].abs()
        return light * (directions @ normal).clamp(min=0)

    exact = float(integrand(FINE.directions) @ FINE.solid_angles)
    for sampler in (long_sampler(), dotted_sampler(), dotted_sampler().towards(normal)):
        directions = sampler.sample(200_000, torch.Generator().manual_seed(2))
        values = integrand(directions) / sampler.pdf(directions)
        error = float(values.std()) / math.sqrt(len(values))
        assert error < 0.05 * exact
        assert abs(float(values.mean()) - exact) < 4 * error


def test_negative_luminance_has_no_share_and_the_density_stays_positive() -> None:
    signed = code([5, 37, 150])
    signed.weights[1] = torch.tensor([0.2, -0.5, 0.1], dtype=F64)
    sampler = CodeSampler.of(signed, long_coder(), uniform=0.2, dtype=F64)
    assert sampler.shares[2] == 0
    assert sampler.shares[0] == pytest.approx(0.2)
    assert sampler.pdf(FINE.directions).min() >= 0.2 / (4 * math.pi) * (1 - 1e-12)


def test_the_constant_counts_as_uniform() -> None:
    few = code([0, 5])
    bank = long_coder().bank.coefficients.detach()
    power = luminance(few.weights) * bank[[0, 5], 0]
    share = float(power[0] / power.sum())
    for uniform, expected in ((0.01, share), (share + 0.1, share + 0.1)):
        sampler = CodeSampler.of(few, long_coder(), uniform=uniform, dtype=F64)
        assert sampler.shares.tolist() == pytest.approx([expected, 1 - expected])


def test_shares_towards_a_normal_are_irradiances() -> None:
    """Of each lobe, to 3 % of its largest: cosines are nearly normally distributed."""
    sampler = long_sampler()
    density = sampler.lobes.density(FINE.directions) * FINE.solid_angles[:, None]
    for normal in DirectionGrid.hammersley(5).directions:
        cosine = (FINE.directions @ normal).clamp(min=0)
        exact = sampler.shares * (cosine @ density)
        found = sampler.towards(normal).shares
        assert (found - exact / exact.sum()).abs().max() < 0.03


def test_the_density_has_derivatives() -> None:
    few = code([0, 5])
    directions = DirectionGrid.hammersley(3).directions

    def density(weights: torch.Tensor, rotations: torch.Tensor, w: torch.Tensor) -> torch.Tensor:
        changed = few._replace(weights=weights, rotations=rotations)
        return CodeSampler.of(changed, long_coder(), uniform=0.01, dtype=F64).pdf(w)

    inputs = [x.clone().requires_grad_() for x in (few.weights, few.rotations, directions)]
    assert torch.autograd.gradcheck(density, inputs, eps=1e-6, atol=1e-5, fast_mode=True)


def test_a_saved_code_and_the_same_tensors_give_the_same_samples() -> None:
    tensors = code([0, 5, 37])
    saved = long_coder().sparse_code(tensors, 0.1)
    seeds = (torch.Generator().manual_seed(3) for _ in range(2))
    one, other = (
        CodeSampler.of(each, long_coder(), dtype=F64).sample(100, seed)
        for each, seed in zip((tensors, saved), seeds, strict=True)
    )
    torch.testing.assert_close(one, other, rtol=0, atol=1e-6)


def test_devices_agree(device: torch.device) -> None:
    there = SphericalSparseCoder("ani", height=32).to(device)
    sampler = CodeSampler.of(code([0, 5, 37]).to(device), there)
    generator = torch.Generator(device=device).manual_seed(0)
    directions = sampler.sample(1000, generator)
    assert directions.device.type == device.type
    here = CodeSampler.of(code([0, 5, 37]), long_coder())
    torch.testing.assert_close(
        sampler.pdf(directions).cpu(), here.pdf(directions.cpu()), rtol=1e-3, atol=1e-6
    )


def test_bad_input_is_refused() -> None:
    few = code([5, 37])
    for uniform in (0.0, -0.1, 1.5, math.nan):
        with pytest.raises(InputError, match="uniform"):
            CodeSampler.of(few, long_coder(), uniform=uniform)
    with pytest.raises(InputError, match="one code"):
        CodeSampler.of(CodeTensors(*(x[None] for x in few)), long_coder())
    with pytest.raises(InputError, match="positive luminance"):
        CodeSampler.of(few._replace(weights=-few.weights), long_coder())
    with pytest.raises(InputError, match="matches"):
        CodeSampler.of(long_coder().sparse_code(few, 0.1), coder())


def test_fits_are_of_the_filters_of_each_sub_dictionary() -> None:
    """Of 64 rows: filter 105 is the fifth of the finer ones."""
    part = coder().parts[1]
    assert isinstance(part, SubDictionary)
    precisions, _ = fitted_lobes(part.bank, torch.tensor([105 - part.first]))
    torch.testing.assert_close(dotted_sampler().lobes.precisions[2], precisions[0])
