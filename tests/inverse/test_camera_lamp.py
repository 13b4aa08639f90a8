"""A lamp at the camera, such as a flash, as an explanation of its own."""

import math
from dataclasses import replace

import pytest
import torch
from torch.nn.functional import normalize

from skylight.inverse._posterior import CAMERA_SHARE, face_evidence, sun_evidence
from skylight.inverse._scan import scan_faces
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix
from skylight.transport._reflection import camera_lamp, specular_transport
from skylight.transport._render import Specular
from tests.inverse.test_posterior import FRONT, ball, light_of, posterior_of

AHEAD = torch.tensor([0.0, 0.0, 1.0])


def visible_normals(count=200):
    x = torch.randn(count, 3, generator=torch.Generator().manual_seed(2))
    x[:, 2] = x[:, 2].abs() + 0.1
    return normalize(x, dim=1)


def test_it_is_the_transport_from_the_cameras_direction():
    normals, lobe = visible_normals(), Specular(f0=0.028, roughness=0.5)
    views = AHEAD.expand_as(normals)
    grid = DirectionGrid(directions=AHEAD[None].double(), solid_angles=torch.ones(1).double())
    diffuse = TransportMatrix(matrix=normals[:, 2:], grid=grid)
    specular = specular_transport(diffuse, normals, views, lobe)
    found = camera_lamp(normals, views, lobe)
    torch.testing.assert_close(found, torch.cat([diffuse.matrix, specular.matrix], 1))
    assert float(camera_lamp(normals, views, None)[:, 1].abs().max()) == 0


def test_uneven_light_of_a_near_lamp_is_what_the_docstring_says():
    # by 1 / r^2 over the 6 cm in depth that the front of a face has, relative to its mean
    for distance, told in ((0.5, 0.25), (1.5, 0.083)):
        near, far = 1 / (distance - 0.03) ** 2, 1 / (distance + 0.03) ** 2
        assert (near - far) / (near + far) * 2 == pytest.approx(told, rel=0.1)


def flash_lit(share):
    """A ball's photograph with ``share`` of its light from the camera, and the same without."""
    seen = ball(light_of(FRONT, 0.6), noise=0.03)
    row, column = seen.places.unbind(1)
    x, y = (column + 0.5) / 7 - 1, 1 - (row + 0.5) / 7
    normals = torch.stack([x, y, (1 - x**2 - y**2).sqrt()], 1)
    lamp = camera_lamp(normals, AHEAD.expand_as(normals), None)
    flash = lamp[:, :1] / lamp[:, :1].mean() * seen.pixels.mean()
    rest = ball(light_of(FRONT, 0.1)).pixels
    rest = rest / rest.mean() * seen.pixels.mean()
    return replace(seen, pixels=share * flash + (1 - share) * rest, camera_lamp=lamp), seen, lamp


def evidence_of(observation):
    return sun_evidence(face_evidence([observation], scan_faces([observation])))


def test_a_flash_is_told_from_a_sun():
    lit, by_sun, lamp = flash_lit(0.8)
    found = evidence_of(lit)
    assert found.camera_gain > CAMERA_SHARE * found.gain
    assert posterior_of(found).by_camera
    other = evidence_of(replace(by_sun, camera_lamp=lamp))
    assert other.camera_gain < 0.6 * other.gain
    assert not posterior_of(other).by_camera


def test_it_explains_what_it_lights_and_is_not_asked_where_there_is_none():
    lit, _, _ = flash_lit(1.0)
    scan = scan_faces([lit])[0]
    assert scan.camera_lit < 1e-4
    assert scan.camera_lit < 0.2 * float(scan.unexplained.min())
    blind = scan_faces([replace(lit, camera_lamp=None)])[0]
    assert blind.camera_lit == pytest.approx(blind.without_sun)
    torch.testing.assert_close(blind.unexplained, scan.unexplained)
    assert math.isfinite(blind.without_sun)
