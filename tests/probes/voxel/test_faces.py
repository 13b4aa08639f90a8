"""Faces and their occlusion: by hand, by ray casts, and under the rotations of a cube."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st

from skylight.probes.voxel._model import (
    CONFIGURATIONS,
    FORWARD,
    NORMALS,
    OCCLUDERS,
    ORIENTATIONS,
    RIGHT,
    VoxelModel,
    exposed_faces,
    quarter_turns,
    star_probe,
    visibility_vectors,
)
from skylight.transport._rays import Raycaster
from tests.probes.voxel.shapes import face_among

GRIDS = st.integers(1, 2**27 - 1).map(
    lambda bits: VoxelModel(
        occupied=np.array([bits >> i & 1 for i in range(27)], bool).reshape(3, 3, 3)
    )
)


def test_frames_are_right_handed() -> None:
    assert (np.cross(RIGHT, FORWARD) == NORMALS).all()
    assert [o[0] == "+" for o in ORIENTATIONS] == (NORMALS.sum(1) > 0).tolist()


def test_the_three_probe_has_the_five_configurations_of_table_3_1() -> None:
    faces = exposed_faces(star_probe(3))
    assert len(faces) == 30
    for o in range(6):
        found = faces.configuration[faces.orientation == o].sort().values
        # none, left, right, forward, backward: never the ceiling
        assert found.tolist() == [0, 1, 2, 4, 8]
    table = visibility_vectors()[[0, 1, 2, 4, 8]]
    assert table.tolist() == [
        [1, 1, 1, 1, 1],
        [0, 1, 1, 1, 1],
        [1, 0, 1, 1, 1],
        [1, 1, 0, 1, 1],
        [1, 1, 1, 0, 1],
    ]


@pytest.mark.parametrize("orientation", range(6))
def test_neighbours_of_the_front_cell_are_the_bits_of_the_configuration(orientation: int) -> None:
    for configuration in range(CONFIGURATIONS):
        faces, number = face_among(orientation, configuration)
        assert int(faces.configuration[number]) == configuration


@given(GRIDS)
@settings(max_examples=25, deadline=None)
def test_occluders_are_where_rays_are_stopped(model: VoxelModel) -> None:
    """From the middle of the front cell towards each neighbour, against the faces' own mesh."""
    faces = exposed_faces(model)
    caster = Raycaster(*faces.triangles())
    for o in range(6):
        mine = faces.orientation == o
        if not mine.any():
            continue
        front = faces.corners[mine].mean(1) + 0.5 * torch.from_numpy(NORMALS[o])
        steps = (-RIGHT[o], RIGHT[o], FORWARD[o], -FORWARD[o], NORMALS[o])
        for i, step in enumerate(steps):
            hits = caster.intersect(front, torch.from_numpy(step).double()[None])
            present = (faces.configuration[mine] >> i & 1).bool()
            torch.testing.assert_close(hits.distance < 0.75, present)


@given(GRIDS)
@settings(max_examples=25, deadline=None)
def test_faces_close_a_surface(model: VoxelModel) -> None:
    """Triangles have the orientations' normals and areas of 1/2, and hold the cells' volume."""
    faces = exposed_faces(model)
    vertices, triangles = faces.triangles()
    a, b, c = vertices[triangles].unbind(1)
    cross = torch.linalg.cross(b - a, c - a)
    normals = torch.from_numpy(NORMALS)[faces.orientation].repeat_interleave(2, 0)
    torch.testing.assert_close(cross, normals.double())
    volume = float((a * cross).sum() / 6)
    assert volume == pytest.approx(len(model))


def test_texels_lie_on_their_face_left_to_right_and_forward_first() -> None:
    faces = exposed_faces(star_probe(1))
    points = faces.points(4)
    for o in range(6):
        right, forward = torch.from_numpy(RIGHT[o]).double(), torch.from_numpy(FORWARD[o]).double()
        torch.testing.assert_close(points[o, 0, 1] - points[o, 0, 0], right / 4)
        torch.testing.assert_close(points[o, 0, 0] - points[o, 1, 0], forward / 4)
        torch.testing.assert_close(points[o].mean((0, 1)), faces.corners[o].mean(0))


def test_a_cube_has_24_rotations() -> None:
    turns = quarter_turns()
    assert len({t.tobytes() for t in turns}) == 24
    assert (turns[0] == np.eye(3)).all()
    assert all(round(np.linalg.det(t)) == 1 for t in turns)


def test_names_of_occluders_are_in_the_order_of_their_bits() -> None:
    assert OCCLUDERS == ("left", "right", "forward", "backward", "top")
