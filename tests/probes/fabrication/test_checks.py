"""The checks find what is wrong with parts that are broken on purpose."""

from dataclasses import replace

import numpy as np
import pytest

from skylight.probes.fabrication import _checks as checks
from skylight.probes.fabrication._mount import Mount
from skylight.probes.fabrication._parts import PrintedPart, PrintSizes, box, part_of
from skylight.probes.fabrication._report import PrintReport
from skylight.probes.voxel._model import star_probe
from skylight.probes.voxel._parts import VoxelParts, voxel_parts
from skylight.probes.voxel._printing import check_voxel_parts


def shell(wall: float, floor: float) -> PrintedPart:
    """A box of 20 mm, open above."""
    inner = box(np.array([wall, wall, floor]), np.array([20 - wall, 20 - wall, 30.0]))
    return part_of("shell", box(np.zeros(3), np.full(3, 20.0)) - inner)


def with_part(printed: VoxelParts, place: int, part: PrintedPart) -> VoxelParts:
    parts = list(printed.parts)
    parts[place] = part
    return replace(printed, parts=tuple(parts))


def checked(printed: VoxelParts, mount: Mount) -> PrintReport:
    return check_voxel_parts(printed, mount.foot)


class TestOnePart:
    @pytest.mark.parametrize(("wall", "floor"), [(1.2, 3.0), (3.0, 0.7), (1.6, 1.6)])
    def test_thinnest_wall_of_a_box(self, wall: float, floor: float) -> None:
        assert checks.thinnest_wall_mm(shell(wall, floor)) == pytest.approx(
            min(wall, floor), abs=1e-6
        )

    def test_a_thin_spot_is_found(self) -> None:
        pocket = box(np.array([9.0, 1.3, 9]), np.array([11.0, 5, 11]))
        solid = shell(1.6, 1.6).solid()
        assert solid is not None
        assert checks.thinnest_wall_mm(part_of("a", solid - pocket)) == pytest.approx(1.3, abs=1e-6)

    def test_sound_part(self) -> None:
        figures = checks.part_figures(shell(1.6, 1.6))
        assert figures.watertight
        assert figures.consistent
        assert figures.pieces == 1
        assert figures.volume_mm3 == pytest.approx(20**3 - 16.8**2 * 18.4)
        assert figures.overhang_mm2 == 0

    def test_hole(self) -> None:
        part = shell(1.6, 1.6)
        figures = checks.part_figures(replace(part, faces=part.faces[1:]))
        assert not figures.watertight

    def test_triangle_turned_over(self) -> None:
        part = shell(1.6, 1.6)
        faces = part.faces.copy()
        faces[3] = faces[3, ::-1]
        assert not checks.part_figures(replace(part, faces=faces)).consistent

    def test_inside_out(self) -> None:
        part = shell(1.6, 1.6)
        figures = checks.part_figures(replace(part, faces=part.faces[:, ::-1].copy()))
        assert figures.volume_mm3 < 0
        assert figures.thinnest_mm == 0

    def test_two_pieces(self) -> None:
        two = box(np.zeros(3), np.ones(3)) + box(np.full(3, 2.0), np.full(3, 3.0))
        assert checks.part_figures(part_of("two", two)).pieces == 2

    def test_overhang_of_a_table(self) -> None:
        table = box(np.array([0.0, 0, 9]), np.array([12.0, 8, 10])) + box(
            np.array([5.0, 3, 0]), np.array([7.0, 5, 9])
        )
        area, longest = checks.overhang(part_of("table", table))
        assert area == pytest.approx(12 * 8 - 2 * 2)
        assert longest == pytest.approx(12)


class TestAssembly:
    def test_as_made(self, cross: VoxelParts, mount: Mount) -> None:
        report = checked(cross, mount)
        assert report.problems == ()
        assert report.thinnest_mm == pytest.approx(1.6, abs=1e-6)
        assert report.face_deviation_mm < 1e-6
        assert report.outside_mm3 < 1e-6
        assert report.overlap_mm3 < 1e-6
        assert report.clearances_mm == pytest.approx((0.15, 0.15), abs=1e-3)

    def test_part_shifted_outwards(self, cross: VoxelParts, mount: Mount) -> None:
        leaf = cross.parts[-1]  # on +X
        shifted = with_part(cross, -1, leaf.shifted(np.array([0.1, 0, 0])))
        report = checked(shifted, mount)
        assert report.face_deviation_mm == pytest.approx(0.1, abs=1e-6)
        # its rim, and its outer face
        assert report.outside_mm3 == pytest.approx(0.1 * 20**2, rel=1e-6)
        assert report.joints[-1].stop_mm == pytest.approx(0.1, abs=1e-3)
        assert any("too far on" in problem for problem in report.problems)

    def test_part_shifted_sideways(self, cross: VoxelParts, mount: Mount) -> None:
        leaf = cross.parts[-1]
        within = checked(with_part(cross, -1, leaf.shifted(np.array([0, 0.1, 0]))), mount)
        # freer on one side by as much as it is tighter on the other
        measured = sorted(within.joints[-1].clearances_mm)
        assert measured == pytest.approx([0.05, 0.15, 0.15, 0.25], abs=1e-3)
        assert any("clearance 0.050" in problem for problem in within.problems)
        beyond = checked(with_part(cross, -1, leaf.shifted(np.array([0, 0.3, 0]))), mount)
        assert beyond.overlap_mm3 > 0.1
        assert any("share" in problem for problem in beyond.problems)

    def test_loose_parts(self, mount: Mount) -> None:
        loose = voxel_parts(star_probe(3), PrintSizes(clearance_mm=0.35))
        report = checked(replace(loose, sizes=PrintSizes()), mount)
        assert report.joints[-1].clearances_mm == pytest.approx((0.35,) * 4, abs=1e-3)
        assert any("clearance 0.35" in problem for problem in report.problems)

    def test_thin_parts(self, mount: Mount) -> None:
        thin = voxel_parts(star_probe(3), PrintSizes(wall_mm=1.2))
        report = checked(replace(thin, sizes=PrintSizes()), mount)
        assert any("has a wall of 1.200 mm" in problem for problem in report.problems)

    def test_part_with_a_hole(self, cross: VoxelParts, mount: Mount) -> None:
        leaf = cross.parts[-1]
        report = checked(with_part(cross, -1, replace(leaf, faces=leaf.faces[1:])), mount)
        assert any(f"{leaf.name}: has a hole" in problem for problem in report.problems)
        assert report.overlap_mm3 == float("inf")

    def test_part_in_the_way(self) -> None:
        def cube(name: str, x: float) -> PrintedPart:
            return part_of(name, box(np.array([x, 0.0, 0.0]), np.array([x + 9.0, 9, 9])))

        parts = [cube("a", 0), cube("wall", 30), cube("b", 9)]
        joint = checks.Joint(carrier=0, plugged=2, outward=(1, 0, 0))
        outer = checks.OuterShape(
            model=parts[0], points=np.array([[4.5, 4.5, 9]]), normals=np.array([[0, 0, 1.0]])
        )
        for joints, blocked in (([joint], ("b",)), ([replace(joint, outward=(0, 1, 0))], ())):
            report = checks.check_print(
                parts, PrintSizes(), joints=joints, outer=outer, inside=[0], ray_start_mm=5.0
            )
            assert report.blocked == blocked


@pytest.mark.parametrize("gap", [0.0, 0.1, 0.4])
def test_play_is_the_gap(gap: float) -> None:
    fixed = box(np.zeros(3), np.ones(3))
    moving = box(np.array([1 + gap, 0.3, 0]), np.array([3.0, 2, 1]))
    along = np.array([-1, 0, 0])
    assert checks.play_mm(fixed, moving, along, 0.6) == pytest.approx(gap, abs=1e-3)
    assert checks.play_mm(fixed, moving, -along, 0.6) == 0.6
