"""The ground: its grid, how it is seen, and where its shadow ends."""

import math

import pytest
import torch

from skylight.errors import InputError
from skylight.probes.cameras._drawing import camera_rays, looking_at
from skylight.probes.partitions.relight._gather import ACROSS, Ground
from skylight.transport._cameras import Camera
from tests.probes.partitions.boards import F64, STILL, affine, box

GROUND = Ground(centre=(3.0, -2.0), width=2.0, reach=20.0)


def vector(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=F64)


def test_grid_is_a_square_that_looks_up() -> None:
    scene = GROUND.scene()
    torch.testing.assert_close(scene.vertices.amin(0), vector(-17, 0, -22))
    torch.testing.assert_close(scene.vertices.amax(0), vector(23, 0, 18))
    corners = scene.vertices[scene.faces]
    areas = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    assert bool((areas[:, 1] > 0).all())
    assert float(areas[:, 1].sum()) == pytest.approx(1600)
    # denser by the object than at the rim
    gaps = scene.vertices[:ACROSS, 0].diff()
    assert float(gaps.max() / gaps.min()) > 5
    assert float(gaps.min()) < 2.0 / 15


def test_ground_is_under_the_scene() -> None:
    ground = Ground.under(box(20.0))
    assert ground.centre == pytest.approx((0, 0))
    assert ground.width == pytest.approx(10)
    assert ground.reach == pytest.approx(10 * math.sqrt(2) + 120)
    with pytest.raises(InputError, match="below the ground"):
        Ground.under(box(20.0).placed(affine(STILL, (0.0, -5.0, 0.0))))


def test_values_are_seen_where_they_lie() -> None:
    """An image of its own coordinates comes back as the places that rays meet."""
    place = GROUND.scene().vertices.reshape(ACROSS, ACROSS, 3).float()
    eye = vector(5, 9, 6)
    pose = looking_at(eye, vector(3, 0, -2))
    camera = Camera(focal_px=90.0, width=48, height=40, center_px=(24.0, 20.0))
    rays = camera_rays(camera, samples=2)
    seen = GROUND.seen(place, rays, pose)
    directions = rays @ pose.rotation
    met = eye + directions * (-eye[1] / directions[..., 1:2])
    torch.testing.assert_close(seen, met.mean(2).float(), atol=0.01, rtol=0)


def test_nothing_changes_beyond_the_rim_or_from_below() -> None:
    shade = 1 - 0.5 * GROUND.fade()[..., None].expand(-1, -1, 3)
    assert bool((shade[[0, -1]] == 1).all())
    assert float(shade[ACROSS // 2, ACROSS // 2, 0]) == 0.5
    camera = Camera(focal_px=30.0, width=40, height=40, center_px=(20.0, 20.0))
    for eye, target in (((3, 9, -2), (3, 9, -9)), ((3, -1, -2), (3, 4, -9))):
        place = looking_at(vector(*eye), vector(*target))
        seen = GROUND.seen(shade, camera_rays(camera), place)
        assert bool((seen[:20] == 1).all())  # the sky
    assert bool((seen == 1).all())


def test_extent_holds_all_that_differs() -> None:
    shade = torch.ones(ACROSS, ACROSS, 3)
    assert GROUND.extent(shade, 0.01).shape == (0, 3)
    shade[40:50, 60:62, 1] = 0.9
    around = GROUND.extent(shade, 0.01)
    place = GROUND.scene().vertices.reshape(ACROSS, ACROSS, 3)
    torch.testing.assert_close(around.amin(0), place[39, 59])
    torch.testing.assert_close(around.amax(0), place[50, 62])


def test_smoothing_keeps_planes_and_the_footprint() -> None:
    generator = torch.Generator().manual_seed(0)
    noise = torch.rand(ACROSS**2, 2, 3, generator=generator)
    smooth = GROUND.smoothed(noise)
    far = (GROUND.scene().vertices - vector(3, 0, -2)).abs().amax(1)
    torch.testing.assert_close(smooth[far <= 2.0], noise[far <= 2.0])
    assert float(smooth[far > 6].std()) < 0.4 * float(noise[far > 6].std())
    even = torch.full_like(noise, 0.3)
    torch.testing.assert_close(GROUND.smoothed(even), even)
