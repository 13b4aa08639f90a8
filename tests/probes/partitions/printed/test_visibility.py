"""What faces see: exact without walls, against marched rays with them."""

import numpy as np
import pytest
import torch

from skylight.fabrication.part import PrintedPart, merged
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.design.designs import named_design
from skylight.probes.partitions.printed.halves import ProbeParts, probe_parts, standing_rotation
from skylight.probes.partitions.printed.sizes import ProbeSizes
from skylight.probes.partitions.printed.solids import face_radii
from skylight.probes.partitions.printed.visibility import Visibility, measure_visibility
from skylight.transport.raycast import Raycaster

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


def test_smaller_kernels_leak_less(cells: Cells, cube: ProbeParts) -> None:
    sizes = ProbeSizes(outer_mm=80.0, kernel_mm=5.0)
    parts = probe_parts(cells, sizes, rotation=cube.rotation, pole_mm=6.0)
    small = measure_visibility(
        cells,
        caster_of(*parts.parts),
        centres=5.0 * parts.net.normals,
        radii=face_radii(parts.net, sizes),
        rotation=cube.rotation,
        directions=4000,
    )
    assert small.leak.mean() < 0.2
