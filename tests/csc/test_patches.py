import math
from pathlib import Path

import pytest
import torch

from skylight.csc._dictionary import FilterBank, builtin, project_about_pole, sharpest_a
from skylight.csc._learning import extract_patches, kmeans_filters, learn_patches, local_maxima
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


def turned_map(turn: torch.Tensor, *, level: float = 0.2, height: float = 5.0) -> torch.Tensor:
    theta, phi = polar(GRID.directions @ turn)  # R^T w
    return (level + height * kite(theta, phi)).reshape(128, 256, 1).expand(-1, -1, 3)


def canonical() -> torch.Tensor:
    """The kite as a patch of its own should come out: tapered, windowed, of unit norm."""

    def tapered(theta: torch.Tensor, phi: torch.Tensor) -> torch.Tensor:
        ramp = (2 * theta / RADIUS_RAD - 1).clamp(0, 1)
        return (kite(theta, phi) * (1 + torch.cos(math.pi * ramp)) / 2)[None]

    row = project_about_pole(tapered, 40)[0]
    l = harmonics.bands(40).to(F64)  # noqa: E741
    row = row * torch.exp(-l * (l + 1) / (4 * sharpest_a(40) ** 2))
    return row / row.norm()


# where


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


# what


@pytest.mark.parametrize("seed", range(6))
def test_a_turned_lobe_gives_the_canonical_patch(seed: int) -> None:
    patches = extract_patches([turned_map(rotation(seed))], 40, (RADIUS_RAD,))
    assert patches.shape == (1, 41**2)
    assert float(patches[0].norm()) == pytest.approx(1)
    assert float(patches[0] @ canonical()) > 0.985


@pytest.mark.parametrize(
    ("axis", "angle_deg"),
    [((0.0, 1.0, 0.0), 0.0), ((0.0, 1.0, 0.0), 137.0), ((1.0, 0.0, 0.0), 180.0)],
)
def test_poles_are_places_like_others(axis: tuple[float, float, float], angle_deg: float) -> None:
    turn = rotation_about(torch.tensor(axis, dtype=F64), math.radians(angle_deg))
    (patch,) = extract_patches([turned_map(turn)], 40, (RADIUS_RAD,))
    assert float(patch @ canonical()) > 0.985


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
    (one,) = extract_patches([turned_map(turn)], 40, (RADIUS_RAD,))
    (sun,) = extract_patches([turned_map(turn, level=2e4, height=5e5)], 40, (RADIUS_RAD,))
    torch.testing.assert_close(one, sun, atol=1e-6, rtol=0)


def test_finer_maps_are_averaged_down() -> None:
    turn = rotation(2)
    theta, phi = polar(DirectionGrid.latlong(256).directions @ turn)
    fine = (0.2 + 5 * kite(theta, phi)).reshape(256, 512, 1).expand(-1, -1, 3)
    (patch,) = extract_patches([fine], 40, (RADIUS_RAD,))
    (coarse,) = extract_patches([turned_map(turn)], 40, (RADIUS_RAD,))
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


# learned


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
    maps = [turned_map(rotation(seed)) for seed in range(4)]
    bank = learn_patches(maps, 40, 2, radii_rad=(RADIUS_RAD, RADIUS_RAD / 2))
    ani = builtin("ani")
    assert (bank.name, len(bank), bank.degree) == ("kmeans", 2 + len(ani), 40)
    assert torch.equal(bank.coefficients[0], ani.coefficients[0])
    assert torch.equal(bank.coefficients[3:], ani.coefficients[1:])
    # two radii, two clusters: the larger circle's is the kite itself
    assert float((bank.coefficients[1:3] @ canonical()).max()) > 0.98
