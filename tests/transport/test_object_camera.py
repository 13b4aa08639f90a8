"""Cameras from JSON: the lens, the pose, and what is refused."""

import json
import math
from pathlib import Path

import pytest
import torch

from skylight.errors import InputError
from skylight.sphere._frame import rotation_about
from skylight.sphere._rotation import RigidTransform
from skylight.transport._cameras import PlacedCamera, object_camera, read_object_camera

AIMED = {"fov_deg": 40.0, "position": [1, 2, 5], "look_at": [0.5, 0, -1]}


def vector(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


class TestLens:
    def test_top_and_bottom_rows_see_the_field_of_view(self) -> None:
        camera = object_camera(AIMED, height=100, width=60).camera
        edge = vector(0.0, math.tan(math.radians(20)), -1.0)[None]
        torch.testing.assert_close(camera.project(edge), vector(30.0, 0.0)[None])

    def test_focal_length_and_centre_are_taken_as_they_stand(self) -> None:
        content = {k: v for k, v in AIMED.items() if k != "fov_deg"}
        camera = object_camera(
            {**content, "focal_px": 80, "center_px": [10, 20.5]}, height=50, width=40
        ).camera
        assert (camera.focal_px, camera.center_px) == (80.0, (10.0, 20.5))


def in_camera(placed: PlacedCamera) -> RigidTransform:
    return placed.world_from_camera.inverse()


class TestPose:
    def test_the_target_is_in_the_middle_and_up_is_up(self) -> None:
        placed = object_camera(AIMED, height=100, width=60)
        points = torch.stack([vector(0.5, 0, -1), vector(0.5, 0.3, -1)])
        target, above = placed.camera.project(in_camera(placed).points(points))
        torch.testing.assert_close(target, vector(30.0, 50.0))
        assert float(above[0]) == pytest.approx(30.0)
        assert float(above[1]) < 50

    def test_a_matrix_says_the_same(self) -> None:
        aimed = object_camera(AIMED, height=100, width=60)
        content = {"fov_deg": 40, "world_from_camera": aimed.world_from_camera.matrix().tolist()}
        given = object_camera(content, height=100, width=60)
        torch.testing.assert_close(
            given.world_from_camera.matrix(), aimed.world_from_camera.matrix()
        )
        assert given.camera == aimed.camera

    def test_shrunk_sees_the_same_at_a_third(self) -> None:
        placed = object_camera(AIMED, height=91, width=62)
        small = placed.shrunk(3)
        points = in_camera(placed).points(vector(0.7, 0.3, -1.4)[None])
        torch.testing.assert_close(3 * small.camera.project(points), placed.camera.project(points))
        assert (small.camera.height, small.camera.width) == (30, 20)


TURNED = torch.eye(4, dtype=torch.float64)
TURNED[:3, :3] = rotation_about(vector(1, 2, 3), 0.7)


class TestRefused:
    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"fov_deg": None}, 'either "fov_deg" or "focal_px"'),
            ({"focal_px": 100}, "and not both"),
            ({"fov_deg": 0}, "from 0.1 to 170"),
            ({"fov_deg": "wide"}, '"fov_deg" must be a number'),
            ({"fov_deg": True}, '"fov_deg" must be a number'),
            ({"fov_deg": math.nan}, '"fov_deg" must be a number'),
            ({"position": None}, 'lacks "position"'),
            ({"look_at": None}, 'lacks "look_at"'),
            ({"position": [1, 2]}, '"position" must be 3 numbers'),
            ({"position": [1, 2, math.inf]}, '"position" must be 3 numbers'),
            ({"look_at": [1, 2, 5]}, "where the camera stands"),
            ({"up": [-0.5, -2, -6]}, "along the view"),
            ({"up": [0, 0, 0]}, "along the view"),
            ({"roll": 3}, "unknown camera key 'roll'"),
            ({"world_from_camera": TURNED.tolist()}, "keep one of them"),
        ],
    )
    def test_aimed(self, change: dict, message: str) -> None:
        content = {k: v for k, v in {**AIMED, **change}.items() if v is not None}
        with pytest.raises(InputError, match=message):
            object_camera(content, height=10, width=10)

    @pytest.mark.parametrize(
        "matrix",
        [
            (TURNED * 2).tolist(),
            (TURNED * torch.tensor([-1.0, 1, 1, 1])).tolist(),
            TURNED.T.roll(1, 0).tolist(),
            TURNED[:3].tolist(),
            "identity",
            [[1, 0, 0, 0]] * 3 + [[0, 0, 1]],
        ],
    )
    def test_matrix(self, matrix: object) -> None:
        with pytest.raises(InputError, match="world_from_camera"):
            object_camera({"fov_deg": 40, "world_from_camera": matrix}, height=10, width=10)

    def test_files(self, tmp_path: Path) -> None:
        path = tmp_path / "camera.json"
        with pytest.raises(InputError, match="No such file"):
            read_object_camera(path, height=10, width=10)
        for content, message in (("{", "no JSON"), ("[1]", "a JSON object"), ("{}", "fov_deg")):
            path.write_text(content)
            with pytest.raises(InputError, match=message) as caught:
                read_object_camera(path, height=10, width=10)
            assert str(path) in str(caught.value)
        path.write_text(json.dumps(AIMED))
        assert read_object_camera(path, height=10, width=12).camera.width == 12
