"""Grown probes: connected, within their budget, no worse than stars of the same size."""

import numpy as np
import pytest
from scipy.ndimage import label

from skylight.errors import InputError
from skylight.probes.voxel._analysis import CameraRing, design_probe, probe_residual, visible_faces
from skylight.probes.voxel._model import VoxelModel, exposed_faces, star_probe


def test_a_symmetric_design_is_no_worse_than_the_five_probe() -> None:
    star = star_probe(5)
    design = design_probe(len(star), beam=3)
    assert len(design.model) <= len(star)
    assert label(design.model.occupied)[1] == 1
    assert design.residual <= probe_residual(star) + 1e-9
    assert probe_residual(design.model) == pytest.approx(design.residual)
    for axis in "xyz":
        np.testing.assert_array_equal(design.model.turned(axis, 1).occupied, design.model.occupied)


def test_all_faces_of_a_cube_are_seen_and_none_in_a_narrow_well() -> None:
    cube = exposed_faces(VoxelModel(occupied=np.ones((1, 1, 1), bool)))
    assert visible_faces(cube, CameraRing()).all()
    solid = np.ones((3, 4, 3), bool)
    solid[1, 1:, 1] = False
    well = exposed_faces(VoxelModel(occupied=solid))
    bottom = (well.orientation == 2) & (well.configuration == 15)
    assert bottom.sum() == 1
    assert not visible_faces(well, CameraRing())[bottom].any()


def test_cameras_above_do_not_see_what_looks_down() -> None:
    cube = exposed_faces(VoxelModel(occupied=np.ones((1, 1, 1), bool)))
    seen = visible_faces(cube, CameraRing(elevations_deg=(15.0, 60.0)))
    assert (seen == (cube.orientation != 3)).all()


def test_bad_input_is_named() -> None:
    with pytest.raises(InputError, match="odd grid"):
        design_probe(7, size=4)
