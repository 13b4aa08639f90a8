"""Planes of the studio's photo against ones that are projected here, by another way."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.studio.composite.composite_modules import Error, called

Array = NDArray[np.float64]
CAMERA = {"focal_px": 1500.0, "width": 1000, "height": 800, "principal": [480.0, 410.0]}
CLICK = 0.002  # of the longer side, as the page has it


def pixels(points: Array, camera: dict[str, Any] = CAMERA) -> Array:
    """Where points are seen, homogeneous coordinates divided whatever their sign."""
    f, (cx, cy) = camera["focal_px"], camera["principal"]
    return np.stack([cx - f * points[:, 0] / points[:, 2], cy + f * points[:, 1] / points[:, 2]], 1)


def axes(tilt_deg: float, towards_deg: float, turn_deg: float) -> tuple[Array, Array, Array]:
    """Two directions in a plane of that tilt, and its normal."""
    tilt, towards, turn = np.radians([tilt_deg, towards_deg, turn_deg])
    normal = np.array(
        [np.sin(tilt) * np.cos(towards), np.cos(tilt), np.sin(tilt) * np.sin(towards)]
    )
    first = np.cross(normal, [0.3, 0.2, -1.0])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    along = np.cos(turn) * first + np.sin(turn) * second
    return along, np.cross(normal, along), normal


def rectangle(
    middle: Array, sides: tuple[float, float], tilt_deg: float, towards_deg: float, turn_deg: float
) -> tuple[Array, Array]:
    """Its corners in order, and its plane's normal."""
    a, b, normal = axes(tilt_deg, towards_deg, turn_deg)
    around = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    corners = [middle + sides[0] / 2 * i * a + sides[1] / 2 * j * b for i, j in around]
    return np.array(corners), normal


def by_homography(corners: Array) -> Array:
    """The normal by the homography of a square: n ~ K^T H^-T (0, 0, 1), y down and z ahead."""
    rows = []
    for (u, v), (x, y) in zip([(0, 0), (1, 0), (1, 1), (0, 1)], corners, strict=True):
        rows += [[u, v, 1, 0, 0, 0, -x * u, -x * v, -x], [0, 0, 0, u, v, 1, -y * u, -y * v, -y]]
    homography = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    f, (cx, cy) = CAMERA["focal_px"], CAMERA["principal"]
    intrinsic = np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]])
    normal = intrinsic.T @ np.linalg.inv(homography).T @ [0, 0, 1]
    normal = normal / np.linalg.norm(normal) * [1, -1, -1]
    return normal * np.sign(normal[1])


def test_rectangles_that_are_projected_are_found_again() -> None:
    generator = np.random.default_rng(3)
    calls, wanted = [], []
    for _ in range(60):
        middle = generator.uniform([-0.3, -1.2, -3.0], [0.3, -0.5, -1.6])
        sides = tuple(generator.uniform(0.3, 0.7, 2))
        angles = generator.uniform([0, 0, 0], [25, 360, 360])
        corners, normal = rectangle(middle, sides, *angles)
        if normal @ middle > -0.25:
            continue  # nearly edge-on
        seen = pixels(corners)[:: 1 if len(calls) % 2 else -1]
        if len(calls) % 2 == 0:
            corners = corners[::-1]
        calls.append(("planeOfRectangle", CAMERA, seen.tolist()))
        wanted.append((corners, normal, angles[0]))
    assert len(calls) > 30
    found = called("plane", *calls)
    told = [not isinstance(one, Error) for one in found]
    assert sum(told) > 0.6 * len(told)  # the others are too small to tell, and say so
    assert all("click a larger" in one for one in found if isinstance(one, Error))
    scaled = []
    for one, (corners, normal, tilt) in zip(found, wanted, strict=True):
        if isinstance(one, Error):
            continue
        assert one["normal"] == pytest.approx(normal, abs=1e-9)
        assert one["tiltDeg"] == pytest.approx(tilt, abs=1e-6)
        assert one["cornerDeg"] == pytest.approx(90, abs=1e-6)
        first = np.linalg.norm(corners[1] - corners[0])
        ahead = -corners[:, 2].mean()
        assert one["side"] / one["depth"] == pytest.approx(first / ahead)
        scaled.append((("withSide", one, first), normal @ corners[0]))
        scaled.append((("sideAtDepth", one, ahead), first))
    answers = called("plane", *(call for call, _ in scaled))
    for answer, (call, want) in zip(answers, scaled, strict=True):
        value = answer["offset"] if call[0] == "withSide" else answer
        assert value == pytest.approx(want)


def test_the_error_is_that_of_clicks_that_are_off() -> None:
    corners, _ = rectangle(np.array([0.1, -0.7, -1.8]), (0.6, 0.5), 4, 30, 20)
    seen = pixels(corners)
    (found,) = called("plane", ("planeOfRectangle", CAMERA, seen.tolist()))
    generator = np.random.default_rng(1)
    normals = np.array(
        [
            by_homography(seen + CLICK * 1000 * generator.standard_normal((4, 2)))
            for _ in range(2000)
        ]
    )
    true = by_homography(seen)
    assert found["normal"] == pytest.approx(true, abs=1e-9)
    angles = np.degrees(np.arccos(np.clip(normals @ true, -1, 1)))
    assert found["tiltErrorDeg"] == pytest.approx(math.sqrt((angles**2).mean()), rel=0.1)


def test_what_is_no_rectangle_on_a_table_is_refused_in_one_line() -> None:
    good, _ = rectangle(np.array([0.1, -0.7, -1.8]), (0.6, 0.5), 4, 30, 20)
    seen = pixels(good)
    on_line = seen.copy()
    on_line[1] = (seen[0] + seen[2]) / 2 + 1
    reaching_back, _ = rectangle(np.array([0.1, -0.7, -0.5]), (1.2, 1.2), 0, 0, 45)
    assert (reaching_back[:, 2] > 0).sum() == 1
    wall, _ = rectangle(np.array([0.1, -0.2, -1.8]), (0.6, 0.5), 80, 90, 20)
    ceiling, _ = rectangle(np.array([0.1, 0.7, -1.8]), (0.6, 0.5), 4, 30, 20)
    edge_on, _ = rectangle(np.array([0.0, -0.02, -1.8]), (0.6, 0.9), 0, 0, 0)
    tiny, _ = rectangle(np.array([0.1, -0.7, -5.0]), (0.1, 0.1), 4, 30, 20)
    skewed = good + np.linspace(0, 1, 4)[[0, 0, 3, 3], None] * 0.6 * (good[1] - good[0])
    refused = {
        "on a line": on_line,
        "sides cross": seen[[0, 2, 1, 3]],
        "behind the camera": pixels(reaching_back),
        "like a wall": pixels(wall),
        "seen from below": pixels(ceiling),
        "larger rectangle": pixels(tiny),
        "has four corners": seen[:3],
        "seen by this camera": pixels(skewed),
    }
    calls = [("planeOfRectangle", CAMERA, corners.tolist()) for corners in refused.values()]
    lines = called("plane", *calls, ("planeOfRectangle", CAMERA, [[None, 0]] * 4))
    for want, line in zip([*refused, "has four corners"], lines, strict=True):
        assert isinstance(line, Error), want
        assert want in line
        assert "\n" not in line
    (line,) = called("plane", ("planeOfRectangle", CAMERA, pixels(edge_on).tolist()))
    assert isinstance(line, Error)


def test_the_ground_lies_where_eyes_of_that_height_put_it() -> None:
    eyes = [0.2, 0.15, -5.0]
    plane, seen, unseen, too_low, under = called(
        "plane",
        ("groundUnder", eyes, 1.6),
        ("showsFootOf", {"normal": [0, 1, 0], "offset": -1.0}, CAMERA, eyes),
        ("showsFootOf", {"normal": [0, 1, 0], "offset": -1.45}, CAMERA, eyes),
        ("groundUnder", [0.0, 1.7, -2.0], 1.6),
        ("planeAt", {"normal": [0, 1, 0], "offset": -1.45}, CAMERA, [480, 409]),
    )
    assert plane == {"normal": [0, 1, 0], "offset": pytest.approx(-1.45)}
    # 1500 x 1.0 / 5 = 300 pixels under the middle at 410, of 800; 1.45 m are 435
    assert (seen, unseen) == (True, False)
    assert isinstance(too_low, Error)
    assert "under it" in too_low
    assert under is None  # the horizon
    for point in ([0.3, -1.45, -4.0], [-1.0, -1.45, -20.0]):
        pixel = pixels(np.array([point]))[0].tolist()
        (back,) = called("plane", ("planeAt", plane, CAMERA, pixel))
        assert back == pytest.approx(point)
