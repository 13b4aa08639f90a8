import math

import pytest
import torch
from torch.func import vmap
from torch.utils._pytree import (
    tree_flatten,
    tree_map,
    tree_unflatten,
    treespec_dumps,
    treespec_loads,
)

from skylight.sphere._frame import DirectionGrid, row_edges_cos

F64 = torch.float64


@pytest.mark.parametrize("height", [1, 2, 16, 63])
def test_every_row_has_its_exact_solid_angle(height: int) -> None:
    """Area of a spherical zone between two zenith angles."""
    grid = DirectionGrid.latlong(height)
    per_pixel = grid.solid_angles.reshape(height, -1)
    for i in range(height):
        t0, t1 = i * math.pi / height, (i + 1) * math.pi / height
        zone = 4 * math.pi * math.sin((t0 + t1) / 2) * math.sin((t1 - t0) / 2)
        assert per_pixel[i].sum().item() == pytest.approx(zone, rel=1e-12)
        assert (per_pixel[i] == per_pixel[i, 0]).all()


@pytest.mark.parametrize(
    ("grid", "total"),
    [
        (DirectionGrid.latlong(64), 4 * math.pi),
        (DirectionGrid.sky(32), 2 * math.pi),
        (DirectionGrid.hammersley(1000), 4 * math.pi),
    ],
)
def test_solid_angles_sum_to_the_sphere(grid: DirectionGrid, total: float) -> None:
    assert grid.solid_angles.sum().item() == pytest.approx(total, rel=1e-13)
    norms = grid.directions.norm(dim=1)
    torch.testing.assert_close(norms, torch.ones_like(norms))


def test_pixels_of_the_thesis_sky() -> None:
    """5.91e-5 sr at the zenith, 2.41e-3 sr at the horizon for 32x128."""
    solid_angles = DirectionGrid.sky(32).solid_angles
    assert solid_angles[0].item() == pytest.approx(5.91e-5, rel=1e-3)
    assert solid_angles[-1].item() == pytest.approx(2.41e-3, rel=2e-3)


def test_sky_is_the_upper_half_of_the_sphere() -> None:
    sky, sphere = DirectionGrid.sky(8), DirectionGrid.latlong(16)
    torch.testing.assert_close(sky.directions, sphere.directions[: len(sky)])
    torch.testing.assert_close(sky.solid_angles, sphere.solid_angles[: len(sky)])
    assert (sky.directions[:, 1] > 0).all()


def test_layout_puts_the_zenith_on_top_and_forward_in_the_middle() -> None:
    d = DirectionGrid.latlong(64).directions.reshape(64, 128, 3)
    assert d[0, :, 1].min() > 0.999
    torch.testing.assert_close(
        d[31:33, 63:65].mean((0, 1)), torch.tensor([0.0, 0, -1], dtype=F64), atol=1e-3, rtol=0
    )
    assert d[32, 96, 0] > 0.99


def moments(grid: DirectionGrid) -> torch.Tensor:
    """Integrals of 1, x, y, z, xx, yy, zz, xy, xz, yz, y^4, x^2 y^2."""
    x, y, z = grid.directions.unbind(1)
    one = torch.ones_like(x)
    terms = [one, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z, y**4, x * x * y * y]
    return torch.stack(terms) @ grid.solid_angles


EXACT = (
    4 * math.pi * torch.tensor([1, 0, 0, 0, 1 / 3, 1 / 3, 1 / 3, 0, 0, 0, 1 / 5, 1 / 15], dtype=F64)
)


@pytest.mark.parametrize(
    ("grid", "tolerance"),
    [
        (DirectionGrid.latlong(64), 2.5e-3),
        (DirectionGrid.latlong(128), 6.5e-4),
        (DirectionGrid.hammersley(4096), 1e-2),
    ],
)
def test_low_degree_polynomials(grid: DirectionGrid, tolerance: float) -> None:
    torch.testing.assert_close(moments(grid), EXACT, atol=tolerance, rtol=0)


def test_latlong_quadrature_is_second_order() -> None:
    errors = [(moments(DirectionGrid.latlong(h)) - EXACT).abs().max().item() for h in (16, 32, 64)]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.1)


def test_hammersley_fills_every_octant_evenly() -> None:
    d = DirectionGrid.hammersley(4096).directions > 0
    octant = (d * torch.tensor([1, 2, 4])).sum(1)
    share = octant.bincount(minlength=8) / 4096
    torch.testing.assert_close(share, torch.full((8,), 1 / 8), atol=2e-3, rtol=0)
    assert len(DirectionGrid.hammersley(1)) == 1


def test_row_edges_descend_from_zenith() -> None:
    torch.testing.assert_close(row_edges_cos(2, 4), torch.tensor([1.0, 0, -1], dtype=F64))
    torch.testing.assert_close(row_edges_cos(1, 4), torch.tensor([1.0, 0], dtype=F64))


def test_mismatched_parts_are_refused() -> None:
    grid = DirectionGrid.latlong(2)
    with pytest.raises(Exception, match=r"match|violat|parameter"):
        DirectionGrid(directions=grid.directions[1:], solid_angles=grid.solid_angles)
    with pytest.raises(ValueError, match="layout"):
        DirectionGrid(directions=grid.directions, solid_angles=grid.solid_angles, layout=(3, 3))


def test_a_grid_is_a_pytree_of_its_tensors() -> None:
    """Arguments of transforms and programs; the layout is no number to be followed."""
    grid = DirectionGrid.latlong(4)
    leaves, spec = tree_flatten(grid)
    assert [each.shape for each in leaves] == [(32, 3), (32,)]
    assert tree_unflatten(leaves, treespec_loads(treespec_dumps(spec))).layout == (4, 8)
    turned = [grid, tree_map(lambda each: each.flip(0), grid)]
    both = tree_map(lambda *each: torch.stack(each), *turned)
    heights = vmap(lambda one: one.directions[:, 1] * one.solid_angles)(both)
    for found, one in zip(heights, turned, strict=True):
        assert torch.equal(found, one.directions[:, 1] * one.solid_angles)

    class Heights(torch.nn.Module):
        def forward(self, one: DirectionGrid) -> torch.Tensor:
            assert one.layout == (4, 8)
            return one.directions[:, 1]

    program = torch.export.export(Heights(), (grid,)).module()
    assert torch.equal(program(turned[1]), turned[1].directions[:, 1])
