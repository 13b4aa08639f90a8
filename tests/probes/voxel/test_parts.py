import numpy as np
import pytest

from skylight.errors import InputError
from skylight.probes.fabrication._checks import overhang
from skylight.probes.fabrication._mount import MarkerBoard, Pole, make_mount
from skylight.probes.fabrication._parts import PrintSizes
from skylight.probes.fabrication._report import PrintReport
from skylight.probes.voxel._model import NORMALS, VoxelModel, star_probe
from skylight.probes.voxel._parts import VoxelParts, voxel_parts
from skylight.probes.voxel._press_fit import FLUSH, OPEN, plan_press_fit
from skylight.probes.voxel._printing import check_voxel_parts

SIZES = PrintSizes()


def grown(cells: int, seed: int) -> VoxelModel:
    """A random model in one piece."""
    generator = np.random.default_rng(seed)
    inside = {(0, 0, 0)}
    while len(inside) < cells:
        here = sorted(inside)[int(generator.integers(len(inside)))]
        inside.add(tuple(int(v) for v in here + NORMALS[int(generator.integers(6))]))
    places = np.array(sorted(inside))
    places -= places.min(0)
    grid = np.zeros(places.max(0) + 1, bool)
    grid[tuple(places.T)] = True
    return VoxelModel(occupied=grid)


def checked(printed: VoxelParts) -> PrintReport:
    mount = make_mount(
        printed.mount_lattice, printed.mount_collar, printed.sizes, Pole(), MarkerBoard()
    )
    return check_voxel_parts(printed, mount.foot)


class TestGeometry:
    def test_leaf_is_an_open_box(self) -> None:
        leaf = voxel_parts(star_probe(3), SIZES).parts[-1]
        assert leaf.volume_mm3 == pytest.approx(20**3 - 16.8**2 * 18.4)

    def test_part_with_one_collar(self) -> None:
        """Box, less a window, and the chamfer's frustum and the collar's tube."""
        s, w, c = 20.0, 1.6, 0.15
        inner, frame = s - 2 * w, 2 * w + 2 * c
        window = s - 2 * frame
        box = s**3 - inner**2 * (s - w)
        chamfer = inner**2 * (frame - w) - (inner**3 - window**3) / 6
        collar = ((inner - 2 * c) ** 2 - (inner - 2 * c - 2 * w) ** 2) * s / 4
        expected = box - window**2 * w + chamfer + collar
        assert voxel_parts(star_probe(3), SIZES).parts[0].volume_mm3 == pytest.approx(expected)

    def test_collar_and_opening_differ_by_the_clearance(self) -> None:
        """From the vertices alone: the collar into +X, and the box that goes on there."""
        parts = voxel_parts(star_probe(3), SIZES).parts
        collar = parts[1].vertices[parts[1].vertices[:, 0] > 40 + 1e-9]
        lateral = parts[-1].vertices[:, 1:] - 30
        cavity = np.abs(lateral[np.abs(lateral).max(1) < 9]).max()
        assert np.abs(collar[:, 1:] - 30).max() == pytest.approx(cavity - 0.15)
        assert collar[:, 0].max() == pytest.approx(45)

    def test_parts_fill_their_voxel_but_for_seams(self) -> None:
        printed = voxel_parts(star_probe(5), SIZES)
        for part, cell, sides in zip(
            printed.parts, printed.assembly.cells, printed.assembly.sides, strict=True
        ):
            for side in range(6):
                axis, high = side // 2, side % 2 == 0
                reach = part.bounds[1 if high else 0, axis] * (1 if high else -1)
                edge = 20 * (cell[axis] + high) * (1 if high else -1)
                if sides[side] == FLUSH:
                    assert reach == pytest.approx(edge - 0.075)
                else:
                    assert reach >= edge - 1e-9  # a collar reaches further

    def test_only_windows_hang_over(self) -> None:
        """A window's upper edge with the roof of its collar, and the half wall below it."""
        edge, roof, land = 13.0 * 1.6, 13.3 * 5, 2 * 1.6 * 0.8
        for part in voxel_parts(star_probe(3), SIZES).parts:
            area, longest = overhang(part)
            if part.name == "part_02":
                assert area == pytest.approx(4 * (edge + roof + land))
                assert longest == pytest.approx(13.3)
            else:
                assert area == 0

    def test_saved_material(self) -> None:
        printed = voxel_parts(star_probe(3), SIZES)
        assert printed.solid_mm3 == 7 * 20**3
        assert 0.6 < 1 - printed.volume_mm3 / printed.solid_mm3 < 0.7


class TestAssembly:
    @pytest.mark.parametrize("size", [1, 3, 5, 7])
    def test_order(self, size: int) -> None:
        """Every part comes after its parent, and its way in crosses no voxel that is there."""
        model = star_probe(size)
        assembly = plan_press_fit(model, SIZES)
        assert {tuple(c) for c in assembly.cells.tolist()} == {
            tuple(c) for c in np.argwhere(model.occupied).tolist()
        }
        assert ((assembly.sides == OPEN).sum(1) == 1).all()
        for i in range(len(assembly)):
            parent, step = assembly.parents[i], NORMALS[assembly.toward_parent[i]]
            assert parent < i
            if parent >= 0:
                np.testing.assert_array_equal(assembly.cells[parent], assembly.cells[i] + step)
            before = {tuple(c) for c in assembly.cells[:i].tolist()}
            way = {tuple((assembly.cells[i] - k * step).tolist()) for k in range(1, size)}
            assert not before & way

    def test_the_pole_goes_below_the_middle(self) -> None:
        cells = plan_press_fit(star_probe(5), SIZES).cells
        np.testing.assert_array_equal(cells[0], [2, 0, 2])
        plate = VoxelModel(occupied=np.ones((3, 1, 3), bool))
        np.testing.assert_array_equal(plan_press_fit(plate, SIZES).cells[0], [1, 0, 1])

    def test_models_in_pieces_are_refused(self) -> None:
        grid = np.zeros((2, 2, 2), bool)
        grid[0, 0, 0] = grid[1, 1, 0] = True  # an edge does not hold
        with pytest.raises(InputError, match="not in one piece"):
            voxel_parts(VoxelModel(occupied=grid), SIZES)

    def test_too_many_voxels_are_refused(self) -> None:
        with pytest.raises(InputError, match="at most 1000 voxels"):
            voxel_parts(VoxelModel(occupied=np.ones((11, 11, 11), bool)), SIZES)


class TestMeasured:
    @pytest.mark.parametrize("size", [1, pytest.param(5, marks=pytest.mark.slow)])
    def test_star_probes(self, size: int) -> None:
        report = checked(voxel_parts(star_probe(size), SIZES))
        assert report.problems == ()
        assert report.face_deviation_mm < 1e-6
        assert report.clearances_mm == pytest.approx((0.15, 0.15), abs=1e-3)

    @pytest.mark.parametrize("seed", range(3))
    def test_random_models(self, seed: int) -> None:
        sizes = PrintSizes(face_mm=15.0, wall_mm=1.2, clearance_mm=0.2)
        report = checked(voxel_parts(grown(6, seed), sizes))
        assert report.problems == ()
        assert report.thinnest_mm == pytest.approx(1.2, abs=1e-6)

    def test_the_smallest_face(self) -> None:
        sizes = PrintSizes(face_mm=10.2, wall_mm=1.6, clearance_mm=0.15)
        printed = voxel_parts(VoxelModel(occupied=np.ones((2, 2, 1), bool)), sizes)
        pole = Pole(diameter_mm=2.0, length_mm=80.0)
        mount = make_mount(printed.mount_lattice, printed.mount_collar, sizes, pole, MarkerBoard())
        assert check_voxel_parts(printed, mount.foot).problems == ()
