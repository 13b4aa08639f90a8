"""What faces see: exact without walls, against marched rays with them."""

import numpy as np
import pytest
import torch

from skylight.probes.fabrication._parts import PrintedPart, merged
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions.printed._halves import ProbeParts, probe_parts, standing_rotation
from skylight.probes.partitions.printed._printing import Visibility, measure_visibility
from skylight.probes.partitions.printed._solids import ProbeSizes, face_radii
from skylight.transport._rays import Raycaster

SIZES = ProbeSizes(outer_mm=60.0, kernel_mm=9.0)


@pytest.fixture(scope="module")
def cells() -> Cells:
    return Cells.of(named_design("6d"))


@pytest.fixture(scope="module")
def cube(cells: Cells) -> ProbeParts:
    return probe_parts(cells, SIZES, rotation=standing_rotation(cells), pole_mm=6.0)


def caster_of(*parts: PrintedPart) -> Raycaster:
    vertices, faces, _ = merged(parts)
    return Raycaster(torch.from_numpy(vertices), torch.from_numpy(faces))


def seen(cells: Cells, cube: ProbeParts, *parts: PrintedPart) -> Visibility:
    return measure_visibility(
        cells,
        caster_of(*parts),
        centres=SIZES.kernel_mm * cube.net.normals,
        radii=face_radii(cube.net, SIZES),
        rotation=cube.rotation,
        directions=8000,
    )


def test_a_kernel_without_walls_sees_its_hemisphere(cells: Cells, cube: ProbeParts) -> None:
    found = seen(cells, cube, cube.kernel)
    expected = cells.clamped_cosine(cells.normals)
    torch.testing.assert_close(found.response, expected, atol=2e-3, rtol=0)
    torch.testing.assert_close(found.loss, torch.zeros(6).double(), atol=1e-9, rtol=0)
    # all of pi but its own share
    torch.testing.assert_close(found.leak, torch.pi / found.facing - 1, atol=2e-3, rtol=0)


def test_walls_take_away_and_add_nothing(cells: Cells, cube: ProbeParts) -> None:
    """Opposite faces never meet; walls hide some of others' light and, but for pins, no own."""
    found = seen(cells, cube, *cube.parts)
    assert (found.response <= cells.clamped_cosine(cells.normals) + 1e-9).all()
    assert (found.response[~cells.neighbours & ~torch.eye(6).bool()] < 1e-9).all()
    assert (found.loss < 1e-3).all()
    assert ((found.leak > 0.3) & (found.leak < 0.45)).all()


def test_against_rays_marched_through_the_walls(cube: ProbeParts) -> None:
    """Walls from their definition alone; pins and socket are left to the printed parts."""
    generator = np.random.default_rng(5)
    net = cube.net
    centre, normal = 9.0 * net.normals[0], net.normals[0]
    directions = generator.normal(size=(3000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions = directions[directions @ normal > 0.05]
    points = centre + np.linspace(0.2, 40, 800)[:, None, None] * directions
    blocked = np.zeros(len(directions), bool)
    for (a, b), pole in zip(net.ends_of_walls, net.poles, strict=True):
        off = points @ pole
        flat = points - off[..., None] * pole
        radius = np.linalg.norm(flat, axis=-1)
        within = (flat @ np.cross(pole, a) > 0) & (flat @ np.cross(b, pole) > 0)
        blocked |= ((np.abs(off) < 0.8) & within & (radius < 30) & (radius > 13)).any(0)
    caster = caster_of(*cube.parts)
    start = torch.from_numpy(centre + caster.epsilon * normal)[None].expand(len(directions), 3)
    printed = caster.occluded(start, torch.from_numpy(directions)).numpy()
    assert 0.2 < blocked.mean() < 0.8
    # but for the clearance below the walls and the seam
    assert printed[blocked].mean() > 0.99
    assert printed[~blocked].mean() < 0.03


def measured(cells: Cells, sizes: ProbeSizes, directions: int = 8000) -> Visibility:
    turn = standing_rotation(cells)
    parts = probe_parts(cells, sizes, rotation=turn, pole_mm=6.0)
    return measure_visibility(
        cells,
        caster_of(*parts.parts),
        centres=sizes.kernel_mm * parts.net.normals,
        radii=face_radii(parts.net, sizes),
        rotation=turn,
        directions=directions,
    )


def through_opening(ratio: float, rim: np.ndarray) -> float:
    """int <n, w> dw over an opening as seen from ``ratio`` n, n = +Z: Lambert's sum over its edge.

    ``rim`` (m,3), closed and anticlockwise, on the sphere of radius 1.
    """
    seen = rim - ratio * np.array([0.0, 0.0, 1.0])
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    cross = np.cross(seen, np.roll(seen, -1, 0))
    sine = np.linalg.norm(cross, axis=1)
    angle = np.arctan2(sine, (seen * np.roll(seen, -1, 0)).sum(1))
    return float((angle * cross[:, 2] / sine).sum() / 2)


def cube_rim(steps: int = 400) -> np.ndarray:
    """The edge of a cube's side, seen from its centre."""
    at = np.linspace(-1, 1, steps, endpoint=False)
    side = np.stack([np.ones(steps), at, np.ones(steps)], 1)
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    sides = [side @ np.linalg.matrix_power(quarter, k).T for k in range(4)]
    rim = np.concatenate(sides)
    return rim / np.linalg.norm(rim, axis=1, keepdims=True)


def test_the_opening_of_a_round_cell_has_a_closed_form() -> None:
    """sin^2 b / sin^2 a - 1 = 1 / (1 - 2 q cos a + q^2) - 1, about 2 q cos a for small q."""
    half = 0.7
    turn = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    rim = np.stack(
        [np.sin(half) * np.cos(turn), np.sin(half) * np.sin(turn), np.full(4000, np.cos(half))], 1
    )
    for ratio in (0.0, 0.01, 0.1, 0.3):
        found = through_opening(ratio, rim) / (np.pi * np.sin(half) ** 2)
        assert found == pytest.approx(1 / (1 - 2 * ratio * np.cos(half) + ratio**2), rel=1e-5)


@pytest.mark.parametrize("ratio", [0.05, 0.2])
def test_leaks_past_thin_walls_are_those_of_an_opening_seen_from_a_point(cells, ratio):
    """Of a probe so large that its walls are thin beside it; pins and socket are small, too."""
    outer = 4000.0
    sizes = ProbeSizes(outer_mm=outer, kernel_mm=ratio * outer / 2)
    expected = through_opening(ratio, cube_rim()) / float(cells.facing[0]) - 1
    assert through_opening(0.0, cube_rim()) == pytest.approx(float(cells.facing[0]), rel=1e-4)
    found = measured(cells, sizes, directions=16000)
    assert float(found.leak.mean()) == pytest.approx(expected, rel=0.04)


def test_leaks_fall_with_the_kernel_over_the_shell(cells: Cells) -> None:
    """And go to nothing in proportion to it; thick walls only help."""
    leaks = []
    for kernel in (12.0, 6.0, 4.0):
        sizes = ProbeSizes(outer_mm=80.0, kernel_mm=kernel)
        leak = float(measured(cells, sizes).leak.mean())
        assert leak < through_opening(kernel / 40, cube_rim()) / float(cells.facing[0]) - 1
        leaks.append(leak)
    assert (np.diff(leaks) < 0).all()
    slope = [through_opening(q, cube_rim()) / float(cells.facing[0]) - 1 for q in (0.01, 0.02)]
    assert slope[1] / slope[0] == pytest.approx(2, rel=0.02)


@pytest.mark.parametrize(
    "name", ["6d", *(pytest.param(name, marks=pytest.mark.slow) for name in ("14d", "14d-indoor"))]
)
def test_rims_keep_out_others_light_and_none_of_a_cells_own(name: str) -> None:
    found = Cells.of(named_design(name))
    plain, half, flared = (
        measured(found, ProbeSizes(kernel_mm=8.0, flare=flare)) for flare in (0.0, 0.5, 1.0)
    )
    assert (flared.leak < half.leak).all()
    assert (half.leak < plain.leak).all()
    assert float(flared.leak.mean()) < 0.75 * float(plain.leak.mean())
    torch.testing.assert_close(flared.loss, plain.loss, atol=2e-3, rtol=0)
