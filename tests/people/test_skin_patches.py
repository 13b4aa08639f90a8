"""Patches cover the skin once, and those that the camera sees are the pixels'."""

import numpy as np
import pytest

from skylight.faces._model import Region
from skylight.people._light import RenderOptions
from skylight.people._people import outer_skin, person, seen_parts
from skylight.people._skin import SmoothHead
from skylight.people._subsurface import patches, patches_in_reach

REACH_M = 0.01


def area_of(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = points[faces].swapaxes(0, 1)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


@pytest.mark.parametrize("area", [100.0, 0.02, 0.003])
def test_patches_divide_their_faces(area: float) -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(0, 1, (9, 3))
    faces = np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8]])
    found = patches(points, faces, np.array([0, 2]), area)
    whole = area_of(points, faces)
    for face in (0, 2):
        mine = found.of_face == face
        assert found.areas[mine].sum() == pytest.approx(whole[face])
        corners = found.corners[mine] @ points[faces[face]]
        np.testing.assert_allclose(corners.mean(1), found.positions[mine])
        a, b, c = corners.swapaxes(0, 1)
        own = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        np.testing.assert_allclose(own, found.areas[mine])
        assert found.corners[mine].min() >= -1e-12
        # the middles' mean, each by its area, is the face's: none lies on another
        np.testing.assert_allclose(found.positions[mine].mean(0), points[faces[face]].mean(0))
        assert len(np.unique(found.positions[mine].round(9), axis=0)) == mine.sum()
        assert own.max() < max(1.6 * area, 1.01 * whole[face] * (whole[face] < 2.3 * area))
    assert 1 not in found.of_face


def test_a_heads_patches_reach_round_the_corner() -> None:
    options = RenderOptions(size=96)
    who, head = person(0, 2.0, options), SmoothHead.load()
    seen = seen_parts(who)
    found = patches_in_reach(who, seen, REACH_M)
    shown = found.pixel >= 0
    width = float(np.median(-seen.positions[seen.skin][:, 2])) / who.truth.camera.focal_px
    pixel = seen.positions.reshape(-1, 3)[found.pixel[shown]]
    assert np.linalg.norm(pixel - found.positions[shown], axis=1).max() < width
    assert seen.skin.reshape(-1)[found.pixel[shown]].all()
    # what no pixel shows lies near, and much of it faces away from the camera
    skin = seen.positions[seen.skin]
    hidden = found.positions[~shown]
    nearest = np.array([np.linalg.norm(skin - x, axis=1).min() for x in hidden[::40]])
    assert nearest.max() < REACH_M
    a, b, c = who.points[head.faces[found.of_face[~shown]]].swapaxes(0, 1)
    away = (np.cross(b - a, c - a) * hidden).sum(1) > 0
    assert 0.3 < away.mean() < 0.95
    # neither walls of holes nor eyes
    assert outer_skin()[head.faces[found.of_face]].all()
    for region in (Region.EYEBALL, Region.MOUTH, Region.HIDDEN):
        assert head.belongs[region][head.faces[found.of_face]].max() <= 0.5
    # an ear's back is in reach through the ear
    ear = (head.belongs[Region.EAR][head.faces[found.of_face]] > 0.9).all(1)
    assert (ear & ~shown).sum() > 50
