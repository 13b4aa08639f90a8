"""Relighting by coefficients: linear in the light; laws of turning, and angles in between."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import KDTree
from torch.nn.functional import normalize

from skylight.errors import InputError
from skylight.probes.cameras._board import cylinder_mesh
from skylight.probes.cameras._drawing import lens_rays, looking_at
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.cameras._response import Response
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions.relight._atlas import refined
from skylight.probes.partitions.relight._composite import (
    LitScene,
    Relighting,
    SceneOnBoard,
    TurningRelighting,
    board_transfer,
)
from skylight.probes.partitions.relight._gather import Ground
from skylight.probes.partitions.relight._scene import Scene
from skylight.probes.partitions.relight._transfer import (
    TransferCoefficients,
    TransferSampling,
    Turn,
    transfer_coefficients,
    turning_coefficients,
)
from tests.probes.partitions.boards import F64, affine, box, fourteen, standing, turn_about_y
from tests.probes.partitions.shapes import corner, quad, six_cells, solid

pytestmark = pytest.mark.usefixtures("coarse_ground")

SAMPLING = TransferSampling(rays=64, bounces=1)
ONES = torch.ones(14, 3)
LENS = Intrinsics(width=160, height=120, fx=150.0, fy=150.0, cx=80.0, cy=60.0, k1=-0.1)


def some_light(seed: int = 0) -> torch.Tensor:
    return torch.rand(14, 3, generator=torch.Generator().manual_seed(seed))


def random_coefficients(angles: int) -> TransferCoefficients:
    values = torch.rand(angles, 20, 14, 3, generator=torch.Generator().manual_seed(0))
    return TransferCoefficients(values=values, orders=torch.zeros(1).double())


def ball() -> Scene:
    """Of revolution about y, in 48 equal parts."""
    mesh = trimesh.creation.uv_sphere(count=[12, 48])
    mesh.apply_transform(trimesh.transformations.rotation_matrix(-math.pi / 2, [1, 0, 0]))
    return solid(mesh)


@cache
def turning_ball() -> TransferCoefficients:
    """Convex, so that nothing bounces."""
    sampling = TransferSampling(rays=64, bounces=0)
    return turning_coefficients(ball(), fourteen(), Turn(), sampling=sampling)


def tower_and_box() -> Scene:
    """Neither convex nor of any symmetry."""
    tower = box(12.0).placed(affine(torch.eye(3, dtype=F64), (9.0, 0.0, 5.0)))
    return Scene.joined([box(), tower])


@cache
def on_board() -> SceneOnBoard:
    """Of few rays, beside a pole, by a turned probe."""
    scene, rotation = tower_and_box(), turn_about_y(0.4)
    ground = Ground.under(scene)
    transfer = board_transfer(
        Path(mkdtemp()) / "t.npz", scene, ground, fourteen(), rotation,
        angles=12, sampling=TransferSampling(rays=64, bounces=1),
    )  # fmt: skip
    return SceneOnBoard(scene, ground, transfer, fourteen(), rotation, pole())


def pole() -> tuple[np.ndarray, np.ndarray]:
    return cylinder_mesh((-5.0, 28.0, 3.0, 60.0))


@pytest.mark.parametrize("angles", [4, 7, 24])
def test_at_the_angles_it_is_each_ones_relighting(angles: int) -> None:
    coefficients = random_coefficients(angles)
    turning = TurningRelighting(coefficients)
    for k in range(angles):
        still = TransferCoefficients(values=coefficients.values[k], orders=coefficients.orders)
        found = turning(some_light(), 2 * math.pi * k / angles)
        torch.testing.assert_close(found, Relighting(still)(some_light()), atol=1e-5, rtol=1e-5)


def test_a_whole_turn_is_none() -> None:
    turning, light = TurningRelighting(random_coefficients(9)), some_light()
    for angle in (0.0, 0.3, 2.0):
        for turns in (-1, 1, 3):
            found = turning(light, angle + 2 * math.pi * turns)
            torch.testing.assert_close(found, turning(light, angle), atol=1e-5, rtol=1e-5)
    assert float((turning(light, 0.3) - turning(light, 0.0)).abs().max()) > 0.1


@pytest.mark.parametrize("angles", [8, 16, 32])
def test_waves_are_as_near_as_cubic_splines_are(angles: int) -> None:
    """5/384 h^4 max |f''''| (Hall and Meyer 1976), of cos 2a with steps of h: 16 h^4 5/384."""
    grid = torch.arange(angles) * 2 * math.pi / angles
    values = (2 * grid).cos().double()[:, None, None, None].expand(-1, 1, 14, 3)
    turning = TurningRelighting(TransferCoefficients(values=values, orders=torch.zeros(1).double()))
    bound = 16 * 5 / 384 * (2 * math.pi / angles) ** 4
    places = np.linspace(0, 7, 300)
    found = torch.stack([turning(ONES.double() / 14, angle)[0, 0] for angle in places])
    error = float((found - torch.from_numpy(np.cos(2 * places))).abs().max())
    assert 0.1 * bound < error < bound + 1e-6


def test_batches_and_gradients_of_light_and_angle() -> None:
    turning = TurningRelighting(random_coefficients(5)).double()
    lights = torch.stack([some_light(0), some_light(1)]).double()
    torch.testing.assert_close(turning(lights, 0.7)[1], turning(lights[1], 0.7))
    angle = torch.tensor(0.7, dtype=F64, requires_grad=True)
    assert torch.autograd.gradcheck(turning, (lights[0].requires_grad_(), angle))


def test_a_body_of_revolution_is_unchanged() -> None:
    """Turned by half a step, each vertex comes to where another one was."""
    scene, turning = ball(), TurningRelighting(turning_ball())
    _, place = KDTree(scene.vertices).query(Turn().rotation(math.pi / 24).points(scene.vertices))
    for seed in range(3):
        light = some_light(seed)
        still, turned = turning(light, 0.0), turning(light, math.pi / 24)
        error = (turned - still[torch.from_numpy(place)]).abs().max() / still.mean()
        assert float(error) < 1e-3
        assert float((turned - still).abs().max() / still.mean()) > 0.02


def test_even_light_is_even_at_all_angles() -> None:
    """Convex bodies reflect their albedo; in a corner the total is the same but for noise."""
    turning = TurningRelighting(turning_ball())
    for angle in (0.0, 0.1, 1.0, 4.0):
        expected = torch.tensor([0.6, 0.5, 0.4]).expand(len(ball().vertices), 3)
        torch.testing.assert_close(turning(ONES, angle), expected, atol=1e-4, rtol=0)
    room = corner((0.5, 0.4, 0.3), (0.8, 0.1, 0.1), 0.3)
    made = turning_coefficients(room, fourteen(), Turn(angles=8), sampling=SAMPLING)
    total = [float(TurningRelighting(made)(ONES, a).mean()) for a in np.linspace(0, 6, 20)]
    assert np.ptp(total) < 0.005 * np.mean(total)


@pytest.mark.parametrize(
    ("angles", "within"), [(8, 1e-4), pytest.param(18, 0.01, marks=pytest.mark.slow)]
)
def test_turning_scene_and_light_together_changes_nothing(angles: int, within: float) -> None:
    """A quarter turn takes cells of 14d to one another; with 18 angles it is between two."""
    cells, scene = fourteen(), corner((0.5, 0.4, 0.3), (0.8, 0.1, 0.1), 0.3)
    sampling = TransferSampling(rays=2048, bounces=1)
    turning = TurningRelighting(
        turning_coefficients(scene, cells, Turn(angles=angles), sampling=sampling)
    )
    quarter = Turn().rotation(math.pi / 2)
    light, turned = some_light(), torch.empty(14, 3)
    turned[cells.cell_of(quarter.directions(cells.normals))] = light
    still = turning(light, 0.0)
    off = (turning(turned, math.pi / 2) - still).pow(2).mean().sqrt() / still.mean()
    assert float(off) < within
    assert float((turning(turned, 0.0) - still).pow(2).mean().sqrt() / still.mean()) > 0.1


def test_the_axis_is_any() -> None:
    """Six cells turned about x, against the scene turned the other way round."""
    scene = corner((0.5, 0.4, 0.3), (0.8, 0.1, 0.1), 0.5)
    turn = Turn(angles=4, axis=(3.0, 0.0, 0.0))
    sampling = TransferSampling(rays=4096, bounces=1)
    made = turning_coefficients(scene, six_cells(), turn, sampling=sampling)
    quarter = torch.tensor([[1, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=F64)
    placed = scene.placed(affine(quarter, (0.0, 0.0, 0.0)))
    expected = transfer_coefficients(placed, six_cells(), sampling=sampling)
    torch.testing.assert_close(made.values[1], expected.values, atol=6e-3, rtol=0)
    assert float((made.values[0] - expected.values).abs().max()) > 0.05


@pytest.mark.parametrize(
    ("angles", "most"), [(12, 0.02), pytest.param(24, 0.01, marks=pytest.mark.slow)]
)
def test_between_the_angles_it_is_what_is_traced_there(angles: int, most: float) -> None:
    """Half way, from the same rays; root mean square over the mean, of scene and ground."""
    scene = tower_and_box()
    ground = quad([-40, 0, -40], [-40, 0, 40], [40, 0, 40], [40, 0, -40])
    together = Scene.joined([scene, refined(ground, 14.0)])
    turn, sampling = Turn(angles=angles), TransferSampling(rays=128, bounces=1)
    made = TurningRelighting(turning_coefficients(together, fourteen(), turn, sampling=sampling))
    halfway = 2 * math.pi * 2.5 / angles
    design, back = fourteen().design, turn.rotation(-halfway)
    cells = Cells.of(replace(design, seeds=normalize(back.directions(design.seeds), dim=1)))
    expected = Relighting(transfer_coefficients(together, cells, sampling=sampling))
    count = len(scene.vertices)
    for seed in range(3):
        found, true = made(some_light(seed), halfway), expected(some_light(seed))
        for part in (slice(count), slice(count, None)):
            off = (found - true)[part].pow(2).mean().sqrt() / true[part].mean()
            assert float(off) < most


def test_a_turned_scene_is_drawn_as_one_that_is_placed_so() -> None:
    """Between two angles, with its shadow, before and behind a pole, but for noise of the rays."""
    turning, angle = on_board(), math.radians(50)
    placed = turning.scene.placed(turning.turned(angle).matrix())
    still = standing(placed, turn_about_y(0.4), rays=64, bounces=1, real=pole())
    pose = looking_at(
        torch.tensor([20.0, 70.0, 90.0], dtype=F64), torch.tensor([3.0, 8.0, 3.0], dtype=F64)
    )
    photo, rays = np.full((120, 160, 3), 120, np.uint8), lens_rays(LENS)
    linear = Response(kind="gamma", gamma=1.0)
    light = torch.full((14, 3), 0.1)
    light[fourteen().cell_of(torch.tensor([[1.0, 0.8, 0.5]], dtype=F64))[0]] = 1.5

    def drawn(lit: LitScene) -> np.ndarray:
        made = turning.put_into(photo, lit, pose, LENS, linear, rays.__getitem__)
        return made.astype(float)

    made = drawn(turning.lit(light, angle))
    expected = still.put_into(photo, still.lit(light), pose, LENS, linear, rays.__getitem__)
    off = np.abs(made - expected).max(2)
    changed = (np.abs(expected.astype(float) - 120) > 5).any(2)
    assert changed.mean() > 0.1
    assert off[changed].mean() < 2.5
    assert np.abs(drawn(turning.lit(light, 0.0)) - expected).max(2)[changed].mean() > 10


def test_the_ground_far_away_is_unchanged_at_all_angles() -> None:
    for angle in (0.0, 0.4):
        shade = on_board().lit(ONES, angle).shade
        assert bool((shade[[0, -1]] == 1).all() and (shade[:, [0, -1]] == 1).all())
        assert float(shade.min()) < 0.3


@pytest.mark.parametrize("angles", [3, 361])
def test_turns_that_are_refused(angles: int) -> None:
    with pytest.raises(InputError, match="4 to 360"):
        Turn(angles=angles)


@pytest.fixture
def coefficients() -> TransferCoefficients:
    values = torch.rand(50, 14, 3, generator=torch.Generator().manual_seed(0))
    return TransferCoefficients(values=values, orders=torch.zeros(1).double())


def test_radiance_is_the_sum_over_the_cells_in_each_colour(coefficients):
    light = torch.rand(14, 3, generator=torch.Generator().manual_seed(1))
    expected = sum(light[i] * coefficients.values[:, i] for i in range(14))
    torch.testing.assert_close(Relighting(coefficients)(light), expected)


def test_a_batch_is_each_light_by_itself(coefficients):
    lights = torch.rand(2, 4, 14, 3, generator=torch.Generator().manual_seed(1))
    relighting = Relighting(coefficients)
    found = relighting(lights)
    assert found.shape == (2, 4, 50, 3)
    torch.testing.assert_close(found[1, 2], relighting(lights[1, 2]))


def test_gradients_are_those_of_the_transpose(coefficients):
    relighting = Relighting(coefficients).double()
    light = torch.rand(14, 3, dtype=torch.float64, requires_grad=True)
    residual = torch.rand(50, 3, dtype=torch.float64)
    (relighting(light) * residual).sum().backward()
    expected = torch.einsum("mic,mc->ic", coefficients.values.double(), residual)
    torch.testing.assert_close(light.grad, expected)
    torch.autograd.gradcheck(relighting, (light,))


def test_transfer_is_the_state_and_precision_that_of_the_light(coefficients, device):
    relighting = Relighting(coefficients).to(device)
    light = torch.rand(14, 3, generator=torch.Generator().manual_seed(1)).to(device)
    other = Relighting(replace(coefficients, values=torch.zeros_like(coefficients.values)))
    other.to(device).load_state_dict(relighting.state_dict())
    torch.testing.assert_close(other(light), relighting(light), rtol=0, atol=0)
    assert relighting(light.double()).dtype == torch.float64
    torch.testing.assert_close(relighting(light.double()).float(), relighting(light))
    torch.testing.assert_close(relighting.double()(light), other(light))
