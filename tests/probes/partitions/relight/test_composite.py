"""What a scene does to the light of the ground, and pictures of both."""

import math

import numpy as np
import pytest
import torch

from skylight.probes.cameras._board import cylinder_mesh
from skylight.probes.cameras._drawing import lens_rays, looking_at
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.cameras._response import Response
from skylight.probes.partitions.relight._composite import SceneOnBoard, meets
from skylight.probes.partitions.relight._gather import ACROSS
from skylight.sphere._rotation import RigidTransform
from tests.probes.partitions.boards import (
    F64,
    affine,
    box,
    box_on_board,
    fourteen,
    standing,
    turn_about_y,
)
from tests.probes.partitions.shapes import quad

LENS = Intrinsics(width=160, height=120, fx=150.0, fy=150.0, cx=80.0, cy=60.0, k1=-0.1)
UP = torch.tensor([[0.0, 1.0, 0.0]], dtype=F64)


def bare_ratio(scene: SceneOnBoard, light: torch.Tensor) -> torch.Tensor:
    """E_with / E_without at the ground's vertices, without smoothing and fading."""
    values = scene.transfer.values[len(scene.scene.vertices) :].double()
    without = scene.ground.albedo / math.pi * fourteen().clamped_cosine(UP)[0] @ light.double()
    with_scene = torch.einsum("mnc,nc->mc", values, light.double())
    return (with_scene / without).reshape(ACROSS, ACROSS, 3)


def from_direction(towards: tuple[float, float, float]) -> torch.Tensor:
    light = torch.zeros(14, 3)
    light[fourteen().cell_of(torch.tensor([towards], dtype=F64))[0]] = 1
    return light


def view(eye: tuple[float, float, float]) -> RigidTransform:
    target = torch.tensor([0.0, 8.0, 0.0], dtype=F64)
    return looking_at(torch.tensor(eye, dtype=F64), target)


def test_below_a_black_plate_the_sky_lacks_the_plate() -> None:
    """Under even light, 1 less the form factor of a square of side 2 a at height h above it.

    F of a quarter, A = a / h, root = sqrt(1 + A^2): A / root atan(A / root) / pi (Howell, B-3).
    """
    a, h = 10.0, 8.0
    plate = quad([-a, h, -a], [-a, h, a], [a, h, a], [a, h, -a], albedo=(0.0, 0.0, 0.0))
    lit = standing(plate, rays=256, bounces=0).lit(torch.ones(14, 3))
    root = math.sqrt(1 + (a / h) ** 2)
    expected = 1 - 4 * (a / h / root * math.atan(a / h / root) / math.pi)
    middle = ACROSS // 2
    shade = lit.shade[middle - 1 : middle + 2, middle - 1 : middle + 2]
    assert float(shade.mean()) == pytest.approx(expected, abs=0.015)


def test_shade_is_1_at_the_rim_and_nearly_so_before_it_fades() -> None:
    scene = box_on_board()
    place = scene.ground.scene().vertices
    distance = torch.hypot(place[:, 0], place[:, 2]).reshape(ACROSS, ACROSS)
    fading = distance > 0.7 * scene.ground.reach
    even = bare_ratio(scene, torch.ones(14, 3))
    assert float((even[fading] - 1).abs().mean()) < 0.002
    # the lowest cells, each as the only light there is
    for i in torch.nonzero(fourteen().normals[:, 1].abs() < 1e-6)[:, 0]:
        light = torch.zeros(14, 3)
        light[i] = 1
        assert float((bare_ratio(scene, light)[fading] - 1).abs().mean()) < 0.01
        shade = scene.lit(light).shade
        assert bool((shade[[0, -1]] == 1).all() and (shade[:, [0, -1]] == 1).all())


def test_shadow_falls_away_from_the_light() -> None:
    shade = box_on_board().lit(from_direction((1.0, 0.8, 0.5))).shade[..., 0]
    place = box_on_board().ground.scene().vertices.reshape(ACROSS, ACROSS, 3)
    ring = torch.hypot(place[..., 0], place[..., 2]).sub(20).abs() < 4
    behind, before = ring & (place[..., 0] < -15), ring & (place[..., 0] > 15)
    assert float(shade[behind].mean()) < 0.6
    assert float(shade[before].mean()) > 0.95


def test_bounces_brighten_the_ground_before_a_lit_face() -> None:
    light = from_direction((1.0, 0.8, 0.5))
    with_bounce = bare_ratio(box_on_board(), light)
    place = box_on_board().ground.scene().vertices.reshape(ACROSS, ACROSS, 3)
    before = (place[..., 0] > 11) & (place[..., 0] < 16) & (place[..., 2].abs() < 5)
    seen = with_bounce[before].mean(0)
    assert float(seen[0]) > 1.05
    # the box is redder than grey (0.6, 0.5, 0.4)
    assert float(seen[0] - 1) > 1.2 * float(seen[2] - 1)


def test_a_turned_probe_tells_the_same_of_the_same_light() -> None:
    """Quarter turns take the cells of 14d to one another: each has its light of the world."""
    turn = turn_about_y(math.pi / 2)
    towards = torch.tensor([0.3, 0.4, -0.8], dtype=F64)
    radiances = []
    for rotation in (turn_about_y(0.0), turn):
        world = fourteen().normals @ rotation.T
        light = (1 + world @ towards)[:, None].expand(-1, 3)
        radiances.append(standing(box(), rotation, bounces=0).lit(light).radiance)
    assert float(radiances[0].std()) > 0.02
    assert float((radiances[0] - radiances[1]).abs().mean()) < 0.005


def test_turning_scene_and_probe_together_changes_nothing() -> None:
    turn, shift = turn_about_y(math.pi / 2), (30.0, 0.0, -20.0)
    light = torch.rand(14, 3, generator=torch.Generator().manual_seed(0))
    still = standing(box(), bounces=0).lit(light)
    moved = standing(box().placed(affine(turn, shift)), turn, bounces=0).lit(light)
    torch.testing.assert_close(moved.radiance, still.radiance, atol=1e-3, rtol=0)
    # +X of the board goes to -Z
    turned = still.shade.transpose(0, 1).flip(0)
    assert float((moved.shade - turned).abs().mean()) < 0.01
    assert float((moved.shade - still.shade).abs().mean()) > 0.01


def test_photo_is_multiplied_on_the_ground_and_kept_elsewhere() -> None:
    scene, pose = box_on_board(), view((60.0, 70.0, 90.0))
    lit = scene.lit(from_direction((1.0, 0.8, 0.5)))
    linear = Response(kind="gamma", gamma=1.0)
    photo = np.full((120, 160, 3), 120, np.uint8)
    rays = lens_rays(LENS)
    made = scene.put_into(photo, lit, pose, LENS, linear, rays.__getitem__)
    drawing = scene._renderer.draw(lit.radiance, rays, pose)
    shade = scene.ground.seen(lit.shade, rays, pose)
    expected = torch.where(drawing.alpha[..., None] > 0, 255 * drawing.radiance, 120 * shade)
    assert float(drawing.alpha.sum()) > 500
    assert float((shade < 0.7).all(2).double().mean()) > 0.02
    off = np.abs(made.astype(float) - expected.clamp(0, 255).numpy())
    assert off.max() <= 1.5
    assert (made == photo).all(2).mean() > 0.1


def test_the_real_probe_takes_no_shadow_and_hides_the_scene() -> None:
    pole = quad([-30, 0, 5], [-24, 0, 5], [-24, 80, 5], [-30, 80, 5])
    real = pole.vertices.numpy(), pole.faces.numpy()
    scene = standing(box(), bounces=0, real=real)
    pose = view((-20.0, 70.0, 110.0))
    photo = np.full((120, 160, 3), 120, np.uint8)
    lit = scene.lit(from_direction((1.0, 0.8, 0.5)))
    rays = lens_rays(LENS)
    made = scene.put_into(photo, lit, pose, LENS, Response(), rays.__getitem__)
    free = scene._renderer.uncovered((slice(0, 120), slice(0, 160)), rays, pose, LENS)
    on_pole = free.numpy() == 0
    assert on_pole.sum() > 200
    assert (made[on_pole] == 120).all()
    without = box_on_board().put_into(photo, lit, pose, LENS, Response(), rays.__getitem__)
    assert (without[on_pole] != 120).any()


def test_far_from_the_picture_nothing_is_drawn() -> None:
    scene = box_on_board()
    away = looking_at(
        torch.tensor([3e3, 90.0, 0.0], dtype=F64), torch.tensor([4e3, 0.0, 0.0], dtype=F64)
    )
    photo = np.full((120, 160, 3), 120, np.uint8)

    def refused(window: object) -> torch.Tensor:
        raise AssertionError("no rays are wanted")

    lit = scene.lit(from_direction((1.0, 0.8, 0.5)))
    made = scene.put_into(photo, lit, away, LENS, Response(), refused)
    assert (made == photo).all()


@pytest.mark.parametrize(
    ("x", "side", "together"),
    [(0.0, 20.0, True), (12.9, 20.0, True), (13.1, 20.0, False), (0.0, 300.0, True)],
)
def test_scenes_that_meet_a_pole(x: float, side: float, together: bool) -> None:
    """Of 6 mm and 80 mm high: through the box, at its side, beside it, and all within."""
    pole = cylinder_mesh((x, 0.0, 3.0, 80.0))
    assert meets(box(side), pole) == together
