"""Sizes that are chosen: every named design prints, and what was asked for stays or is refused."""

import math
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from manifold3d import Manifold, OpType
from trimesh import Trimesh

from skylight.errors import InputError
from skylight.probes.fabrication._parts import lay_out
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import design_names, named_design
from skylight.probes.partitions.printed._assembly import AskedSizes, fitted_sizes
from skylight.probes.partitions.printed._halves import ShellPlan, standing_rotation
from skylight.probes.partitions.printed._printing import PrintedPartitions, print_fitted
from skylight.probes.partitions.printed._solids import ProbeSizes, WallNet, face_radii, wall_solid

QUICK = ("6d", "14d-outdoor")


@cache
def fitted(name: str, bed_mm: float = 220.0, **asked: float) -> ProbeSizes:
    cells = Cells.of(named_design(name))
    return fitted_sizes(cells, AskedSizes(**asked), pole_mm=6.0, bed_mm=bed_mm)


def openings(result: PrintedPartitions) -> int:
    """Into how many of the pieces of a layer below the rims faces look, cut walls made whole.

    Slots beside walls too short to be widened make pieces, too, into which none does.
    """
    printed, radius = result.printed, result.sizes.radius_mm
    lower, upper = printed.lower.solid(), printed.upper.solid()
    assert lower is not None
    assert upper is not None
    layer = Manifold.sphere(0.95 * radius, 64) - Manifold.sphere(0.9 * radius, 64)
    net = printed.net
    thin = np.full(2, result.sizes.wall_mm / 2)
    glue = [
        wall_solid(net.ends_of_walls[wall], net.poles[wall], thin, result.sizes)
        for wall in np.flatnonzero(printed.split.cut)
    ]
    shell = Manifold.batch_boolean([lower, upper, *glue], OpType.Add)
    ahead = [
        Manifold.cube((0.2, 0.2, 0.2), True).translate(tuple((0.925 * radius * n).tolist()))
        for n in net.normals
    ]
    pieces = (layer - shell).decompose()
    seen = [[k for k, piece in enumerate(pieces) if (piece ^ box).volume() > 0] for box in ahead]
    assert all(len(each) == 1 for each in seen)
    return len({each[0] for each in seen})


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in design_names()],
)
def test_every_named_design_prints_by_default(name: str, request: pytest.FixtureRequest) -> None:
    design = named_design(name)
    if name == "6d":
        result = request.getfixturevalue("printed_cube")
    else:
        result = print_fitted(design, AskedSizes())
    assert result.report.problems == ()
    assert not [line for line in result.too_large(220.0) if "one by one" not in line]
    for part in (*result.bed.parts, result.base):
        mesh = Trimesh(part.vertices, part.faces, process=False)
        assert mesh.is_watertight
        assert mesh.body_count == 1
    assert openings(result) == design.count
    assert float(result.visibility.loss.max()) < 0.5  # every face sees most of its cell


@pytest.mark.parametrize(
    "name", [pytest.param("38d", marks=pytest.mark.slow), "14d-outdoor", "14d-sun-6"]
)
def test_kernels_are_the_smallest(name: str) -> None:
    """A tenth less cannot be printed, or has faces that are hard to read."""
    cells, sizes = Cells.of(named_design(name)), fitted(name)
    net = WallNet.of(cells, standing_rotation(cells))
    less = ProbeSizes(outer_mm=sizes.outer_mm, kernel_mm=0.9 * sizes.kernel_mm, flare=sizes.flare)
    try:
        ShellPlan.of(net, less, 6.0)
    except InputError:
        return
    assert 2 * face_radii(net, less).min() < 4.0


def test_coarse_designs_get_faces_of_four_millimetres() -> None:
    """The discs of a cube: 2 (r sin 45 - w / 2)."""
    sizes = fitted("6d")
    assert (sizes.outer_mm, sizes.kernel_mm, sizes.wall_mm) == (80.0, 4.0, 1.6)
    assert 2 * (4 * np.sqrt(0.5) - 0.8) > 4
    assert fitted("6d", wall_mm=3.0).kernel_mm == pytest.approx((2 + 1.5) * 2**0.5, abs=0.1)


def test_what_is_asked_for_stays() -> None:
    assert fitted("14d", outer_mm=100.0, kernel_mm=9.0) == ProbeSizes(
        outer_mm=100.0, kernel_mm=9.0, flare=1.0
    )
    for asked in ({"outer_mm": 90.0}, {"kernel_mm": 8.0}, {"wall_mm": 1.2, "clearance_mm": 0.2}):
        found = fitted("6d", **asked, flare=0.5)
        assert {name: getattr(found, name) for name in asked} == asked
        assert found.flare == 0.5


def test_walls_get_thinner_where_the_shell_would_be_larger_than_the_bed() -> None:
    assert fitted("14d-sun-6").wall_mm == 1.6
    small = fitted("14d-sun-6", bed_mm=150.0)
    assert small.wall_mm == 0.8
    assert small.outer_mm < fitted("14d-sun-6").outer_mm
    # where both are larger, the smaller
    assert fitted("14d-sun-6", bed_mm=50.0) == small


@pytest.mark.parametrize(
    ("asked", "reason"),
    [
        ({"kernel_mm": 8.0}, "too narrow"),
        ({"outer_mm": 20.0}, "too narrow"),
        ({"wall_mm": 0.5}, "too thin to print"),
        ({"outer_mm": -1.0}, "outer_mm must be"),
        ({"outer_mm": 30.0, "kernel_mm": 13.0}, "make outer_mm"),
    ],
)
def test_refusals_name_sizes_that_print(asked: dict[str, float], reason: str) -> None:
    with pytest.raises(InputError, match=reason) as caught:
        fitted("14d-outdoor", **asked)
    line = str(caught.value)
    told = dict(re.findall(r"(outer_mm|kernel_mm|wall_mm) ([\d.]+\d)", line.split("; ")[-1]))
    again = fitted("14d-outdoor", **{name: float(value) for name, value in told.items()})
    assert len(told) == 3
    assert again == fitted("14d-outdoor")


@pytest.mark.parametrize(
    ("name", "value"),
    [("outer_mm", math.nan), ("kernel_mm", math.inf), ("wall_mm", math.nan), ("bed_mm", math.inf)],
)
def test_lengths_that_are_no_numbers(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"{name} must be a length above 0 mm, got {value}"):
        fitted("6d", **{name: value})


def test_what_is_larger_than_the_bed_is_told(printed_cube: PrintedPartitions) -> None:
    """A base of 192 x 142 mm, half shells of 87 x 85 mm, together on 189 x 85 mm."""
    assert printed_cube.too_large(220.0) == []
    wide = replace(printed_cube, bed=lay_out(printed_cube.bed.parts, spacing_mm=30.0))
    (line,) = wide.too_large(195.0)
    assert "one by one" in line
    lines = printed_cube.too_large(80.0)
    assert any("shell_lower is" in line and "thinner walls" in line for line in lines)
    assert any("marker_base is" in line and "smaller board" in line for line in lines)
