import inspect
import itertools
import math

import pytest
import torch

from skylight.sphere import _wavelets as wavelets
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid

F64 = torch.float64
FACES = torch.tensor(
    [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=F64
)


def texel_directions(size: int) -> torch.Tensor:
    """Unit vectors through the centres of the texels of faces seen from inside (n, n each)."""
    right = torch.tensor([[0, 0, 1], [0, 0, -1], [1, 0, 0], [1, 0, 0], [-1, 0, 0], [1, 0, 0]])
    down = torch.linalg.cross(FACES, right.to(F64))
    centre = (torch.arange(size, dtype=F64) + 0.5) * (2 / size) - 1
    forward, right, down = (axes[:, None, None] for axes in (FACES, right.to(F64), down))
    directions = forward + centre[:, None] * right + centre[:, None, None] * down
    return directions / directions.norm(dim=-1, keepdim=True)


def random_cube(size: int, channels: int = 3) -> torch.Tensor:
    """Positive, of high contrast, no two coefficients alike."""
    generator = torch.Generator().manual_seed(size)
    return torch.randn(6, size, size, channels, generator=generator, dtype=F64).mul(2).exp()


def smooth_map(height: int) -> torch.Tensor:
    x, y, z = DirectionGrid.latlong(height).directions.unbind(1)
    rgb = torch.stack([1 + 0.5 * x * y, 1 + y**3 + 0.3 * z, 2 - x * z + 0.5 * y], dim=1)
    return rgb.reshape(height, 2 * height, 3)


def energy(latlong: torch.Tensor) -> torch.Tensor:
    solid_angles = DirectionGrid.latlong(latlong.shape[0]).solid_angles
    return solid_angles @ latlong.reshape(len(solid_angles), -1).to(F64)


def cube_energy(cube: torch.Tensor) -> torch.Tensor:
    return (wavelets.texel_solid_angles(cube.shape[1])[..., None] * cube).sum((0, 1, 2))


def quarter_turn(cube: torch.Tensor) -> torch.Tensor:
    """What looks along -Z afterwards looks along +X: azimuth grows by a quarter turn."""
    px, nx, py, ny, pz, nz = cube
    return torch.stack([nz, pz, py.rot90(1, (0, 1)), ny.rot90(-1, (0, 1)), px, nx])


@pytest.mark.parametrize("size", [1, 2, 8, 64, 256])
def test_solid_angles_sum_to_the_sphere(size: int) -> None:
    solid_angles = wavelets.texel_solid_angles(size)
    assert abs(solid_angles.sum().item() - 4 * math.pi) < 1e-12
    for face in solid_angles:
        assert abs(face.sum().item() - 2 * math.pi / 3) < 1e-12
    assert solid_angles.min() > 0


def test_solid_angles_of_single_texels_agree_with_the_cosine_law() -> None:
    """dw = cos / r^2 dA = (1 + u^2 + v^2)^(-3/2) du dv, by midpoints."""
    fine = texel_directions(256)[0]
    density = fine[..., 0] ** 3 * (2 / 256) ** 2
    expected = density.reshape(8, 32, 8, 32).sum((1, 3))
    torch.testing.assert_close(wavelets.texel_solid_angles(8)[0], expected, rtol=4e-5, atol=0)


@pytest.mark.parametrize("size", [1, 2, 16])
def test_texel_of_a_direction_is_the_one_it_came_from(size: int) -> None:
    found = wavelets.texel_from_direction(3 * texel_directions(size), size)
    assert (found.flatten() == torch.arange(6 * size**2)).all()


def test_resampling_puts_each_direction_where_the_frame_has_it() -> None:
    """A map coloured by its own direction (the frame's) comes back as the texels' directions."""
    directions = DirectionGrid.latlong(64).directions.reshape(64, 128, 3)
    cube = wavelets.cube_from_latlong(directions, 16)
    expected = texel_directions(16)
    assert (cube - expected).norm(dim=-1).max() < 0.01  # a texel is 0.1 wide
    axes = (directions.reshape(-1, 3) @ FACES.T).argmax(-1)
    coloured = torch.nn.functional.one_hot(axes, 6).to(F64).reshape(64, 128, 6)
    inner = wavelets.cube_from_latlong(coloured, 16)[:, 1:-1, 1:-1]
    expected = torch.eye(6, dtype=F64)[:, None, None].expand_as(inner)
    torch.testing.assert_close(inner, expected)


@pytest.mark.parametrize(("height", "size"), [(16, 32), (100, 8), (1, 4), (64, 1)])
def test_a_constant_stays_constant_both_ways(height: int, size: int) -> None:
    colour = torch.tensor([0.5, 1.0, 3.0], dtype=F64)
    cube = wavelets.cube_from_latlong(colour.expand(height, 2 * height, 3).contiguous(), size)
    torch.testing.assert_close(cube, colour.expand_as(cube))
    back = wavelets.latlong_from_cube(cube, height)
    torch.testing.assert_close(back, colour.expand_as(back))


def test_resampling_of_a_smooth_map_is_bounded() -> None:
    source = smooth_map(128)
    cube = wavelets.cube_from_latlong(source, 64)
    back = wavelets.latlong_from_cube(cube, 128)
    torch.testing.assert_close(cube_energy(cube), energy(source), rtol=1e-7, atol=0)
    torch.testing.assert_close(energy(back), energy(source), rtol=1e-7, atol=0)
    error = (energy((back - source) ** 2) / energy(source**2)).sqrt()
    assert error.max() < 2e-3
    assert error.min() > 1e-4  # texels are not pixels: an exact round trip would be no resampling


def test_energy_of_a_single_bright_pixel_is_nearly_kept() -> None:
    """Every pixel of a column at once, each in a channel of its own, poles included."""
    for column in (0, 17, 31, 32, 100):
        source = torch.zeros(128, 256, 128, dtype=F64)
        source[:, column] = torch.eye(128, dtype=F64)
        ratio = cube_energy(wavelets.cube_from_latlong(source, 64)) / energy(source)
        assert (ratio - 1).abs().max() < 6e-3
        assert (ratio - 1).square().mean().sqrt() < 2e-3


def test_resampling_is_the_nearest_cube_map() -> None:
    """<L, A* c> = <A L, c> over solid angle for any c, so A L is L's projection on cube maps."""
    source, other = random_cube(64)[0, :16, :32], random_cube(4)
    cube = wavelets.cube_from_latlong(source, 4)
    inner_cube = cube_energy(cube * other)
    inner_latlong = energy(source * wavelets.latlong_from_cube(other, 16))
    torch.testing.assert_close(inner_cube, inner_latlong, rtol=2e-3, atol=0)


def test_a_quarter_turn_about_the_vertical_permutes_the_faces() -> None:
    source = random_cube(64)[0, :32]
    turned = EnvironmentMap(radiance=source).rotate_azimuth(math.pi / 2).radiance
    cube = wavelets.cube_from_latlong(source, 8)
    found = wavelets.cube_from_latlong(turned, 8)
    torch.testing.assert_close(found, quarter_turn(cube), rtol=1e-9, atol=1e-9)
    for selection in ("magnitude", "area", "weighted"):
        (before,) = wavelets.approximate(cube, [40], selection)
        (after,) = wavelets.approximate(found, [40], selection)
        torch.testing.assert_close(after, quarter_turn(before), rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("size", [1, 2, 32])
def test_haar_is_orthonormal_and_invertible(size: int) -> None:
    a, b = random_cube(size), random_cube(size).flip(1, 2)
    haar_a, haar_b = wavelets.haar(a), wavelets.haar(b)
    inner = (a * b).sum((1, 2))
    torch.testing.assert_close((haar_a * haar_b).sum((1, 2)), inner, rtol=1e-13, atol=0)
    for back in (wavelets.inverse_haar(haar_a), wavelets.haar(wavelets.inverse_haar(a))):
        torch.testing.assert_close(back, a, rtol=1e-13, atol=1e-12)


def test_haar_of_a_face_of_two() -> None:
    """By hand: mean, left - right, top - bottom, diagonal, each halved."""
    face = torch.tensor([[1.0, 2.0], [4.0, 8.0]], dtype=F64)
    expected = torch.tensor([[7.5, -2.5], [-4.5, 1.5]], dtype=F64)
    found = wavelets.haar(face[None, :, :, None].expand(6, 2, 2, 1))
    torch.testing.assert_close(found, expected[None, :, :, None].expand(6, 2, 2, 1))


def test_wavelets_are_square_and_local() -> None:
    """Non-standard: coefficient (i, j) of the finest level moves one 2 x 2 block of one face."""
    coefficients = torch.zeros(6, 8, 8, 1, dtype=F64)
    coefficients[3, 1, 4 + 2] = 1
    expected = torch.zeros(6, 8, 8, 1, dtype=F64)
    expected[3, 2:4, 4], expected[3, 2:4, 5] = 0.5, -0.5
    torch.testing.assert_close(wavelets.inverse_haar(coefficients), expected)


@pytest.mark.parametrize("selection", ["magnitude", "area", "weighted"])
def test_all_wavelets_give_the_map_back_and_none_gives_black(
    selection: wavelets.Selection,
) -> None:
    cube = random_cube(16)
    none, everything = wavelets.approximate(cube, [0, 6 * 16**2], selection)
    torch.testing.assert_close(everything, cube, rtol=1e-12, atol=1e-11)
    assert (none == 0).all()


@pytest.mark.parametrize("selection", ["magnitude", "area"])
def test_one_wavelet_per_face_holds_a_constant(selection: wavelets.Selection) -> None:
    cube = torch.tensor([1.0, 2.0, 0.5], dtype=F64).expand(6, 32, 32, 3)
    fewer, enough = wavelets.approximate(cube, [5, 6], selection)
    torch.testing.assert_close(enough, cube)
    torch.testing.assert_close(fewer[:5], cube[:5])
    assert fewer[5].abs().max() < 1e-12


def test_magnitude_is_the_best_choice_of_so_many_wavelets() -> None:
    """No other choice of 3 of the 24 wavelets is nearer in the sum over texels."""
    cube = random_cube(2)
    (best,) = wavelets.approximate(cube, [3])
    least = (best - cube).square().sum()
    coefficients = wavelets.haar(cube).reshape(24, 3)
    errors = []
    for kept in itertools.combinations(range(24), 3):
        part = torch.zeros_like(coefficients)
        part[list(kept)] = coefficients[list(kept)]
        errors.append((wavelets.inverse_haar(part.reshape(cube.shape)) - cube).square().sum())
    torch.testing.assert_close(least, torch.stack(errors).min())


COUNTS = [1, 10, 100, 700]


def test_error_of_magnitude_is_the_sum_of_what_is_dropped() -> None:
    cube = random_cube(16)
    squares = wavelets.haar(cube).square().sum(-1).flatten().sort().values
    for count, found in zip(COUNTS, wavelets.approximate(cube, COUNTS), strict=True):
        error = (found - cube).square().sum()
        torch.testing.assert_close(error, squares[:-count].sum(), rtol=1e-11, atol=0)


def test_error_of_weighted_over_solid_angle_is_the_sum_of_what_is_dropped() -> None:
    cube = random_cube(16)
    solid_angles = wavelets.texel_solid_angles(16)[..., None]
    squares = wavelets.haar(cube * solid_angles.sqrt()).square().sum(-1).flatten().sort().values
    for count, found in zip(COUNTS, wavelets.approximate(cube, COUNTS, "weighted"), strict=True):
        error = ((found - cube).square() * solid_angles).sum()
        torch.testing.assert_close(error, squares[:-count].sum(), rtol=1e-11, atol=0)


def test_area_prefers_the_wide_wavelet_to_the_tall() -> None:
    """Supports of 64 and 4 texels: a factor of 4 or so (sqrt of the ratio) decides."""
    for tall, wide_wins in ((3.0, True), (6.0, False)):
        coefficients = torch.zeros(6, 8, 8, 1, dtype=F64)
        coefficients[5, 0, 1], coefficients[5, 1, 4 + 1] = 1.0, tall
        cube = wavelets.inverse_haar(coefficients)
        (by_area,) = wavelets.approximate(cube, [1], "area")
        kept = wavelets.haar(by_area)
        assert (kept[5, 0, 1].abs().item() > 0.5) == wide_wins
        (by_magnitude,) = wavelets.approximate(cube, [1])
        assert wavelets.haar(by_magnitude)[5, 1, 5].item() == pytest.approx(tall)


def test_one_choice_for_all_colours() -> None:
    found = wavelets.approximate(random_cube(8), [25])[0]
    kept = wavelets.haar(found).abs() > 1e-9
    assert (kept.sum((0, 1, 2)) == 25).all()
    assert (kept == kept[..., :1]).all()


def test_gradients_reach_the_map_through_resampling_and_selection() -> None:
    source = smooth_map(8).requires_grad_()
    (found,) = wavelets.approximate(wavelets.cube_from_latlong(source, 4), [12], "weighted")
    wavelets.latlong_from_cube(found, 8).square().sum().backward()
    assert source.grad is not None
    assert source.grad.isfinite().all()
    assert source.grad.abs().max() > 0


def test_float32_stays_float32() -> None:
    cube = wavelets.cube_from_latlong(smooth_map(16).float(), 8)
    (found,) = wavelets.approximate(cube, [6 * 64], "weighted")
    assert found.dtype == wavelets.latlong_from_cube(found, 16).dtype == torch.float32
    torch.testing.assert_close(found, cube)


def test_errors_say_what_was_expected() -> None:
    for size in (0, -4, 3, 48):
        with pytest.raises(ValueError, match=f"power of two.*got {size}"):
            wavelets.texel_solid_angles(size)
        with pytest.raises(ValueError, match=f"power of two.*got {size}"):
            wavelets.cube_from_latlong(smooth_map(8), size)
    with pytest.raises(ValueError, match=r"power of two.*got 6"):
        wavelets.approximate(torch.zeros(6, 6, 6, 3), [1])
    for shape in ((5, 4, 4, 3), (6, 4, 8, 3)):
        with pytest.raises(ValueError, match=r"\(6, n, n, c\)"):
            wavelets.approximate(torch.zeros(shape), [1])
        with pytest.raises(ValueError, match=r"\(6, n, n, c\)"):
            wavelets.latlong_from_cube(torch.zeros(shape), 8)
    for count in (-1, 97):
        with pytest.raises(ValueError, match=f"96, got {count}"):
            wavelets.approximate(torch.zeros(6, 4, 4, 3), [1, count])
    with pytest.raises(ValueError, match=r"full lat-long map.*32x8"):
        wavelets.cube_from_latlong(torch.zeros(8, 32, 3), 4)
    with pytest.raises(ValueError, match="magnitude, area, weighted"):
        # the type checker of the tests would stop it first
        inspect.unwrap(wavelets.approximate)(torch.zeros(6, 4, 4, 3), [1], "abs")  # pyright: ignore
