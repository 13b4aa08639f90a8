import math
from functools import cache
from pathlib import Path

import pytest
import torch

from skylight.csc._code import CodeTensors
from skylight.csc._coder import SphericalSparseCoder
from skylight.csc._dictionary import (
    FilterBank,
    anisotropic,
    builtin,
    isotropic,
    project_about_pole,
    sharpest_a,
)
from skylight.csc._learning import (
    CapFilterBank,
    cap_lobes,
    cap_nodes,
    extract_patches,
    kmeans_filters,
    learn_patches,
    local_maxima,
)
from skylight.errors import InputError
from skylight.io._files import read_environment_map
from skylight.sphere import _harmonics as harmonics, _lobes as lobes
from skylight.sphere._frame import DirectionGrid, angle_between, rotation_about

F64 = torch.float64
GRID = DirectionGrid.latlong(128)
RADIUS_RAD = math.radians(45)


def number(value: float) -> torch.Tensor:
    return torch.tensor(value, dtype=F64)


def rotation(seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    q, r = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=F64))
    q = q * r.diagonal().sign()
    return q * torch.linalg.det(q).sign()


def polar(directions: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """(theta, phi) about the zenith, phi from +Z towards +X."""
    x, y, z = directions.unbind(-1)
    return torch.atan2(torch.hypot(x, z), y), torch.atan2(x, z)


def kite(theta: torch.Tensor, phi: torch.Tensor) -> torch.Tensor:
    """Long along phi = 0, with its longer tail there, and of one mirror plane only."""
    a1 = torch.where(torch.cos(phi) > 0, number(2.5), number(6.0))
    return lobes.anisotropic_gaussian(theta, phi, a1, number(9.0))


def kite_map(turn: torch.Tensor, *, level: float = 0.2, height: float = 5.0) -> torch.Tensor:
    theta, phi = polar(GRID.directions @ turn)  # R^T w
    return (level + height * kite(theta, phi)).reshape(128, 256, 1).expand(-1, -1, 3)


def canonical_kite() -> torch.Tensor:
    """The kite as a patch of its own should come out: tapered, windowed, of unit norm."""

    def tapered(theta: torch.Tensor, phi: torch.Tensor) -> torch.Tensor:
        ramp = (2 * theta / RADIUS_RAD - 1).clamp(0, 1)
        return (kite(theta, phi) * (1 + torch.cos(math.pi * ramp)) / 2)[None]

    row = project_about_pole(tapered, 40)[0]
    l = harmonics.bands(40).to(F64)  # noqa: E741
    row = row * torch.exp(-l * (l + 1) / (4 * sharpest_a(40) ** 2))
    return row / row.norm()


def test_maxima_are_found_across_sides_and_poles() -> None:
    """Each lobe once, wherever it lies, and the brightest first."""
    centres = torch.tensor(
        [[0, 1, 0], [0, -1, 0], [0.02, 0.1, 1], [1, 0.3, 0], [-0.7, -0.6, -0.2]], dtype=F64
    )
    value = torch.full((len(GRID),), 0.1, dtype=F64)
    for i, centre in enumerate(centres):
        angle = angle_between(GRID.directions, centre.expand_as(GRID.directions))
        value += (5 - 0.3 * i) * lobes.gaussian(angle, number(6.0))
    found = local_maxima(value.reshape(128, 256), math.radians(10))
    assert found.shape == (5, 3)
    assert angle_between(found, centres).max() < math.radians(1.5)


def test_the_dimmer_of_two_maxima_in_a_circle_is_left_out() -> None:
    apart = rotation_about(torch.tensor([1.0, 0, 0], dtype=F64), math.radians(20))
    first = torch.tensor([0, 0.995, 0.0998], dtype=F64)
    value = torch.zeros(len(GRID), dtype=F64)
    for height, centre in ((1.0, first), (0.8, apart @ first)):  # on both sides of the zenith
        angle = angle_between(GRID.directions, centre.expand_as(GRID.directions))
        value += height * lobes.gaussian(angle, number(12.0))
    image = value.reshape(128, 256)
    assert len(local_maxima(image, math.radians(15))) == 2
    (only,) = local_maxima(image, math.radians(25))
    assert angle_between(only, first) < math.radians(1.5)


def test_flat_and_dim_spots_are_no_maxima() -> None:
    assert local_maxima(torch.full((32, 64), 0.3, dtype=F64), 0.3).shape == (0, 3)
    image = torch.ones(32, 64, dtype=F64)
    image[:16] = 10
    image[24, 10] = 2  # stands out, but is below the mean
    found = local_maxima(image, 0.3)
    assert (found[:, 1] > 0).all()
    plateau = torch.ones(32, 64, dtype=F64)
    plateau[15:17, 30:32] = 7
    assert len(local_maxima(plateau, 0.3)) == 1


TURNS = {
    **{f"at random, {seed}": rotation(seed) for seed in range(3)},
    "at the zenith": torch.eye(3, dtype=F64),
    "there, the long way round": rotation_about(torch.tensor([0.0, 1, 0]).double(), 2.4),
    "at the nadir": rotation_about(torch.tensor([1.0, 0, 0]).double(), math.pi),
}


@pytest.mark.parametrize("turn", TURNS)
def test_a_turned_lobe_gives_the_canonical_patch(turn: str) -> None:
    patches = extract_patches([kite_map(TURNS[turn])], 40, (RADIUS_RAD,))
    assert patches.shape == (1, 41**2)
    assert float(patches[0].norm()) == pytest.approx(1)
    assert float(patches[0] @ canonical_kite()) > 0.985


def test_patches_are_not_mirrored() -> None:
    """A lobe without mirror plane comes out as itself, twisted, and not as its mirror image."""

    def hook(theta: torch.Tensor, phi: torch.Tensor) -> torch.Tensor:
        bend = phi - 2 * theta  # further out, further towards positive phi
        return lobes.anisotropic_gaussian(theta, bend, number(2.5), number(9.0))

    theta, phi = polar(GRID.directions @ rotation(1))
    image = (0.2 + 5 * hook(theta, phi)).reshape(128, 256, 1).expand(-1, -1, 3)
    (patch,) = extract_patches([image], 40, (math.radians(60),))

    def best(sign: int) -> float:
        twists = torch.linspace(-1, 1, 81, dtype=F64)[:, None, None]
        rows = project_about_pole(
            lambda theta, phi: hook(theta, sign * (phi + twists)), 40, rows=64, columns=128
        )
        rows = rows * torch.exp(-harmonics.bands(40) * (harmonics.bands(40) + 1) / 820)
        return float((rows @ patch / rows.norm(dim=1)).max())

    assert best(1) > 0.98
    assert best(-1) < best(1) - 0.04


def test_patches_know_no_exposure_and_no_surroundings() -> None:
    turn = rotation(3)
    (one,) = extract_patches([kite_map(turn)], 40, (RADIUS_RAD,))
    (sun,) = extract_patches([kite_map(turn, level=2e4, height=5e5)], 40, (RADIUS_RAD,))
    torch.testing.assert_close(one, sun, atol=1e-6, rtol=0)


def test_finer_maps_are_averaged_down() -> None:
    turn = rotation(2)
    theta, phi = polar(DirectionGrid.latlong(256).directions @ turn)
    fine = (0.2 + 5 * kite(theta, phi)).reshape(256, 512, 1).expand(-1, -1, 3)
    (patch,) = extract_patches([fine], 40, (RADIUS_RAD,))
    (coarse,) = extract_patches([kite_map(turn)], 40, (RADIUS_RAD,))
    assert float(patch @ coarse) > 0.995


def test_patches_of_single_pixels_hardly_ring() -> None:
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(128, 256, 1, generator=generator, dtype=F64)
    for _ in range(40):
        row, column = (int(torch.randint(n, (1,), generator=generator)) for n in (128, 256))
        image[row, column] = 1e4
    patches = extract_patches([image.expand(-1, -1, 3)], 40)
    assert len(patches) > 40
    torch.testing.assert_close(patches.norm(dim=1), torch.ones(len(patches), dtype=F64))
    assert FilterBank(patches, "patches").undershoot().max() < 0.03


def test_real_rooms_hardly_ring(shared_data: Path) -> None:
    environment = read_environment_map(shared_data / "hdr" / "aerodynamics_workshop.exr")
    patches = extract_patches([environment.radiance], 40)
    assert len(patches) > 10
    assert FilterBank(patches, "patches").undershoot().max() < 0.03


def test_maps_without_lights_give_no_patches() -> None:
    assert extract_patches([torch.full((64, 128, 3), 0.7)], 5).shape == (0, 36)
    assert extract_patches([], 5).shape == (0, 36)
    with pytest.raises(InputError, match="lat-long"):
        extract_patches([torch.ones(64, 256, 3)], 5)


def clouds(sizes: tuple[int, ...], spread: float = 0.02) -> torch.Tensor:
    """Unit vectors in tight bunches about the axes."""
    generator = torch.Generator().manual_seed(0)
    centres = torch.eye(16, dtype=F64)[: len(sizes)].repeat_interleave(torch.tensor(sizes), 0)
    noise = torch.randn(centres.shape, generator=generator, dtype=F64)
    points = centres + spread * noise
    return points / points.norm(dim=1, keepdim=True)


def test_kmeans_finds_the_bunches_largest_first() -> None:
    patches = clouds((5, 30, 12))
    filters = kmeans_filters(patches, 3, seed=1)
    expected = torch.eye(16, dtype=F64)[[1, 2, 0]]
    assert ((filters * expected).sum(1) > 0.998).all()
    torch.testing.assert_close(filters.norm(dim=1), torch.ones(3, dtype=F64))
    assert torch.equal(filters, kmeans_filters(patches, 3, seed=1))


def test_too_few_patches_are_refused() -> None:
    same = clouds((1, 1)).repeat(20, 1)
    with pytest.raises(InputError, match=r"3 filters .* 2 different"):
        kmeans_filters(same, 3)
    with pytest.raises(InputError, match="0 filters"):
        kmeans_filters(same, 0)


def test_learned_dictionary_has_the_others_too() -> None:
    maps = [kite_map(rotation(seed)) for seed in range(4)]
    bank = learn_patches(maps, 40, 2, radii_rad=(RADIUS_RAD, RADIUS_RAD / 2))
    ani = builtin("ani")
    assert (bank.name, len(bank), bank.degree) == ("kmeans", 2 + len(ani), 40)
    assert torch.equal(bank.coefficients[0], ani.coefficients[0])
    assert torch.equal(bank.coefficients[3:], ani.coefficients[1:])
    # two radii, two clusters: the larger circle's is the kite itself
    assert float((bank.coefficients[1:3] @ canonical_kite()).max()) > 0.98


CAP_DEGREE, CAP_RAD = 12, math.radians(50)


@cache
def start() -> FilterBank:
    """The constant and four anisotropic Gaussians."""
    return FilterBank(anisotropic(CAP_DEGREE).coefficients[[0, 60, 20, 80, 90]], "start")


def bank(*, signed: bool = False) -> CapFilterBank:
    return CapFilterBank(start(), [1, 3], radius_rad=CAP_RAD, signed=signed)


def moved(bank: CapFilterBank) -> CapFilterBank:
    """Amounts of either sign and any norm."""
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        bank.amounts.add_(torch.randn(bank.amounts.shape, generator=generator, dtype=F64))
    return bank


def test_lobes_are_the_sharpest_gaussian_about_each_node() -> None:
    """Of unit norm, highest at their nodes, the first at the zenith."""
    lobes, nodes = cap_lobes(CAP_RAD, CAP_DEGREE), cap_nodes(CAP_RAD, CAP_DEGREE)
    torch.testing.assert_close(lobes[0], isotropic(CAP_DEGREE).coefficients[100].detach())
    norms = lobes.norm(dim=1)
    torch.testing.assert_close(norms, torch.ones_like(norms), rtol=0, atol=1e-12)
    heights = FilterBank(lobes, "lobes").evaluate(nodes).detach()
    assert torch.equal(heights.argmax(1), torch.arange(len(nodes)))
    assert float(nodes[:, 1].min()) > math.cos(CAP_RAD)


def test_it_starts_at_the_nearest_sums_of_lobes() -> None:
    """Gaussians no sharper than the lobes and well within the cap are nearly met."""
    round_ = isotropic(CAP_DEGREE).coefficients[[0, 95, 100]]
    learned = CapFilterBank(FilterBank(round_, "two"), [1, 2], radius_rad=CAP_RAD)
    torch.testing.assert_close(learned.coefficients, round_, rtol=0, atol=0.02)
    assert bool((learned.amounts >= 0).all())


def test_only_learned_filters_move_and_all_have_unit_norm() -> None:
    learned = moved(bank())
    rows = learned.coefficients.detach()
    torch.testing.assert_close(rows.norm(dim=1), torch.ones(5, dtype=F64), rtol=0, atol=1e-12)
    others = [0, 2, 4]
    assert torch.equal(rows[others], start().coefficients[others])
    assert not torch.isclose(rows[[1, 3]], bank().coefficients[[1, 3]]).all()
    assert [name for name, _ in learned.named_parameters()] == ["amounts"]


@pytest.mark.parametrize("signed", [False, True])
def test_projection_is_to_unit_filters_of_allowed_signs(signed: bool) -> None:
    learned = moved(bank(signed=signed))
    amounts, rows = learned.amounts.detach().clone(), learned.coefficients.detach()
    learned.project_()
    torch.testing.assert_close(
        (learned.amounts @ learned.lobes).norm(dim=1), torch.ones(2, dtype=F64)
    )
    assert bool((learned.amounts >= 0).all()) != signed
    if signed:
        torch.testing.assert_close(learned.coefficients, rows)
    else:
        assert torch.equal(learned.amounts > 0, amounts > 0)


def test_a_filter_that_vanished_is_a_gaussian_again() -> None:
    learned = bank()
    with torch.no_grad():
        learned.amounts[1] = -1
    learned.project_()
    torch.testing.assert_close(learned.coefficients[3], learned.lobes[0])


def test_coefficients_are_differentiable_in_the_amounts() -> None:
    learned = moved(bank())

    def coefficients(amounts: torch.Tensor) -> torch.Tensor:
        del learned.amounts
        learned.amounts = amounts
        return learned.coefficients

    amounts = learned.amounts.detach().clone().requires_grad_()
    assert torch.autograd.gradcheck(coefficients, [amounts], fast_mode=True)


def test_a_state_makes_the_same_dictionary_and_codes_follow() -> None:
    first, second = moved(bank()), bank()
    first.project_()
    coder = SphericalSparseCoder(second, height=16, activations=3)
    one = torch.tensor([[0.3, 1.2, 0.4]]), torch.ones(1, 3), torch.tensor(1)
    x = SphericalSparseCoder(first, height=16).decode(CodeTensors(torch.tensor([1]), *one)).detach()
    before = coder.relative_error(x, coder(x))
    second.load_state_dict(first.state_dict())
    assert second.fingerprint == first.fingerprint
    expected = SphericalSparseCoder(first, height=16, activations=3)(x)
    for found, of_fresh in zip(coder(x), expected, strict=True):
        assert torch.equal(found, of_fresh)
    assert coder.relative_error(x, coder(x)) < 0.5 * before


@pytest.mark.parametrize(
    ("learned", "radius_deg", "message"),
    [
        ([0], 50, "constant filter"),
        ([5], 50, "0 to 4, got"),
        ([], 50, "0 to 4"),
        ([1, 1], 50, "0 to 4"),
        ([1], 100, "got 100"),
    ],
)
def test_what_cannot_be_learned(learned: list[int], radius_deg: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        CapFilterBank(start(), learned, radius_rad=math.radians(radius_deg))
