"""The six faces of a cube map: where each pixel looks, and what it shows."""

import pytest
import torch

from skylight.errors import InputError
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._projections import FACES, cube_faces, face_directions
from skylight.sphere._wavelets import texel_solid_angles


def opengl_lookup(direction: tuple[float, float, float]) -> tuple[str, float, float]:
    """Face, s and t from 0 to 1, as OpenGL 4.6 core, 8.13, table 8.19 has it."""
    x, y, z = direction
    size = max(abs(x), abs(y), abs(z))
    face, sc, tc = {
        x: ("px", -z, -y), -x: ("nx", z, -y), y: ("py", x, z),
        -y: ("ny", x, -z), z: ("pz", x, -y), -z: ("nz", -x, -y),
    }[size]  # fmt: skip
    return face, (sc / size + 1) / 2, (tc / size + 1) / 2


def test_pixels_look_where_opengl_looks_them_up() -> None:
    size = 5
    directions = face_directions(size)
    for number, name in enumerate(FACES):
        for row in range(size):
            for column in range(size):
                x, y, z = directions[number, row, column].tolist()
                face, s, t = opengl_lookup((x, y, z))
                assert face == name
                assert s * size == pytest.approx(column + 0.5)
                assert t * size == pytest.approx(row + 0.5)


def test_a_map_that_codes_its_directions_shows_them_on_the_faces() -> None:
    directions = DirectionGrid.latlong(128).directions
    coded = EnvironmentMap(radiance=(directions + 2).reshape(128, 256, 3).float())
    faces = cube_faces(coded, 16)
    torch.testing.assert_close(faces.double(), face_directions(16) + 2, atol=3e-3, rtol=0)


def test_light_is_kept() -> None:
    light = EnvironmentMap(
        radiance=torch.rand(32, 64, 3, generator=torch.Generator().manual_seed(0))
    )
    total = (cube_faces(light, 32) * texel_solid_angles(32)[..., None].float()).sum((0, 1, 2))
    torch.testing.assert_close(total, light.integrate(), rtol=0.01, atol=0)


def test_a_sky_alone_is_refused() -> None:
    with pytest.raises(InputError, match="lower half"):
        cube_faces(EnvironmentMap(radiance=torch.ones(8, 32, 3)), 8)
