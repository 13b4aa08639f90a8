"""Six pictures of a cube map, crosses and strips: where each pixel looks."""

from typing import get_args

import pytest
import torch

from skylight._names import CubeLayout
from skylight.errors import InputError
from skylight.sphere._cube_layouts import (
    cross_of_faces,
    faces_of_cross,
    horizontal_cross,
    laid_out,
)
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._projections import FACES, cube_faces, face_directions, from_latlong


def coded_map() -> EnvironmentMap:
    """Colours that tell directions."""
    directions = DirectionGrid.latlong(128).directions
    return EnvironmentMap(radiance=(directions + 2).reshape(128, 256, 3).float())


def test_faces_show_where_threejs_looks_them_up() -> None:
    """OpenGL's faces, looked up by directions whose x is swapped (three.js, flipEnvMap)."""
    swapped = torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64)
    faces = faces_of_cross(from_latlong(coded_map(), "cube", 48))
    torch.testing.assert_close(faces.double(), face_directions(16) * swapped + 2, atol=3e-3, rtol=0)


def test_they_are_the_faces_of_graphics_libraries_mirrored() -> None:
    light = EnvironmentMap(
        radiance=torch.rand(32, 64, 3, generator=torch.Generator().manual_seed(0))
    )
    mirrored = EnvironmentMap(radiance=light.radiance.flip(1))
    faces = faces_of_cross(from_latlong(light, "cube", 48))
    torch.testing.assert_close(faces, cube_faces(mirrored, 16), atol=1e-5, rtol=1e-5)


def test_crosses_and_faces_are_each_others_inverse() -> None:
    faces = torch.rand(6, 5, 5, 3, generator=torch.Generator().manual_seed(0)) + 1
    cross = cross_of_faces(faces)
    assert cross.shape == (15, 20, 3)
    assert int((cross.sum(2) == 0).sum()) == 6 * 25  # what no face covers
    assert torch.equal(faces_of_cross(cross), faces)


@pytest.mark.parametrize("layout", get_args(CubeLayout))
def test_every_layout_comes_back_exactly(layout: CubeLayout) -> None:
    faces = torch.rand(6, 4, 4, 3, generator=torch.Generator().manual_seed(1)) + 1
    cross = cross_of_faces(faces)
    assert torch.equal(horizontal_cross(laid_out(cross, layout), layout), cross)


def test_strips_have_the_order_of_the_six() -> None:
    faces = torch.arange(6.0)[:, None, None, None].expand(6, 2, 2, 3)
    row = laid_out(cross_of_faces(faces), "cube-row")
    column = laid_out(cross_of_faces(faces), "cube-column")
    assert row.shape == (2, 12, 3)
    assert column.shape == (12, 2, 3)
    assert row[0, ::2, 0].tolist() == column[::2, 0, 0].tolist() == list(range(len(FACES)))


@pytest.mark.parametrize(
    ("shape", "layout", "message"),
    [
        ((16, 32), None, "32x16 .* is no cross"),
        ((12, 16), "cube-vertical", "expected 3:4"),
        ((4, 20), "cube-row", "six times as wide as high"),
        ((4, 24), "cube-column", "six times as high as wide"),
    ],
)
def test_wrong_shapes_are_named(
    shape: tuple[int, int], layout: CubeLayout | None, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        horizontal_cross(torch.zeros(*shape, 3), layout)
