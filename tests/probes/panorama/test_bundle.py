"""Turns and lens from matches that are exact, or partly wrong."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skylight.imaging._camera_turns import Link
from skylight.probes.panorama._bundle import Bundle, adjust, spanning_trees
from skylight.probes.panorama._matches import Lens, RotatedLink, rotated_links
from skylight.probes.panorama._panorama import rotation_to

LENS = Lens(width=300, height=200, focal_px=220.0, k1=-0.08)
TRUE = [
    rotation_to(40.0 * k, 15.0 * (-1) ** k) @ Rotation.from_rotvec([0, 0, 0.03 * k]).as_matrix()
    for k in range(9)
]


def links(wrong: float = 0.0, noise: float = 0.0) -> list[Link]:
    """Of all shots that overlap."""
    rng = np.random.default_rng(2)
    found = []
    for one in range(9):
        for two in range(one + 1, 9):
            places = rng.uniform([1, 1], [299, 199], (400, 2))
            rays = LENS.rays(places) @ TRUE[one].T @ TRUE[two]
            there = LENS.project(rays)
            inside = LENS.ahead(rays) & (there > 1).all(1) & (there < [299, 199]).all(1)
            if inside.sum() < 12:
                continue
            before, after = places[inside], there[inside]
            before = before + noise * rng.standard_normal(before.shape)
            swap = rng.random(len(before)) < wrong
            before[swap] = rng.uniform([1, 1], [299, 199], (int(swap.sum()), 2))
            found.append(Link(start=one, end=two, before=before, after=after))
    return found


def started(matches: list[Link], off_deg: float = 3.0) -> Bundle:
    """From turns that are wrong by so much, a pinhole, and a focal length off by a twelfth."""
    rng = np.random.default_rng(7)
    off = np.radians(off_deg) * rng.standard_normal((9, 3))
    start = {k: TRUE[k] @ Rotation.from_rotvec(off[k]).as_matrix() for k in range(9)}
    lens = Lens(width=300, height=200, focal_px=240.0)
    return adjust(rotated_links(matches, lens), [], start, lens, {})


def worst_deg(bundle: Bundle) -> float:
    """Of all shots against the first."""
    off = [bundle.rotations[0].T @ bundle.rotations[k] @ TRUE[k].T @ TRUE[0] for k in range(1, 9)]
    return float(np.degrees(Rotation.from_matrix(off).magnitude()).max())


def test_exact_matches_give_exact_turns_and_lens() -> None:
    found = started(links())
    # that distortion is small is believed a little: one match of 720 as good as that counts more
    assert worst_deg(found) < 1e-3
    assert found.lens.focal_px == pytest.approx(220, abs=0.01)
    assert found.lens.k1 == pytest.approx(-0.08, abs=1e-4)
    assert found.rms_px < 1e-3


def test_a_quarter_of_wrong_matches_does_little() -> None:
    found = started(links(wrong=0.25, noise=0.3))
    assert worst_deg(found) < 0.15
    assert found.lens.focal_px == pytest.approx(220, rel=0.002)
    # both places err by nothing but the noise of one
    assert found.rms_px == pytest.approx(0.3, abs=0.06)


def test_hints_hold_what_nothing_else_does() -> None:
    """A shot without matches stays; the others turn together to meet theirs."""
    kept = rotated_links([one for one in links() if 8 not in (one.start, one.end)], LENS)
    tilt = Rotation.from_rotvec([0.0, 0.02, 0.01]).as_matrix()
    hints = {k: tilt @ TRUE[k] for k in range(9)}
    found = adjust(kept, [], {k: TRUE[k] for k in range(9)}, LENS, hints)
    for k in range(9):
        np.testing.assert_allclose(found.rotations[k], hints[k], atol=1e-3)


def test_a_lamp_places_what_else_only_hints_do() -> None:
    """Where shot 7 sees it; another lamp, 28 degrees off, does nothing."""
    kept = rotated_links([one for one in links() if 8 not in (one.start, one.end)], LENS)
    lamp = TRUE[7] @ LENS.rays(np.array([[290.0, 40.0]]))[0]
    (true,) = LENS.project(lamp[None] @ TRUE[8])
    hint = TRUE[8] @ Rotation.from_rotvec([0.03, 0.02, 0.0]).as_matrix()
    hints = {**{k: TRUE[k] for k in range(8)}, 8: hint}
    for off_px, left_deg in ((0.0, 0.0), (80.0, 2.07)):
        link = Link(start=7, end=8, before=np.array([[290.0, 40.0]]), after=true[None] + off_px)
        found = adjust(kept, [link], hints, LENS, hints)
        (one,) = found.lens.rays(link.before) @ found.rotations[7].T
        (two,) = found.lens.rays(true[None]) @ found.rotations[8].T
        assert np.degrees(np.arccos(one @ two)) == pytest.approx(left_deg, abs=0.1)


def test_spanning_trees_are_those_of_most_matches() -> None:
    """A weak and wrong link is not used where strong ones lead; the larger group is the first."""

    def turned(one: int, two: int, count: int, rotation: np.ndarray) -> RotatedLink:
        nothing = np.zeros((count, 2))
        link = Link(start=one, end=two, before=nothing, after=nothing)
        return RotatedLink(link=link, rotation=rotation)

    true = [turned(one, two, 100, TRUE[one].T @ TRUE[two]) for one, two in ((0, 1), (1, 2), (2, 3))]
    wrong = turned(0, 3, 20, np.eye(3))
    apart = turned(5, 6, 500, TRUE[5].T @ TRUE[6])
    found, other = spanning_trees([*true, wrong, apart])
    assert sorted(found) == [0, 1, 2, 3]
    assert sorted(other) == [5, 6]
    np.testing.assert_allclose(other[5].T @ other[6], TRUE[5].T @ TRUE[6], atol=1e-12)
    for k in range(4):
        np.testing.assert_allclose(
            found[0].T @ found[k], TRUE[0].T @ TRUE[k], atol=1e-12, err_msg=str(k)
        )


class TestLens:
    def test_rays_and_places_are_each_others_inverse(self) -> None:
        places = np.random.default_rng(0).uniform([0, 0], [300, 200], (50, 2))
        np.testing.assert_allclose(LENS.project(LENS.rays(places)), places, atol=1e-9)
        assert LENS.ahead(LENS.rays(places)).all()

    def test_it_is_that_of_opencv(self) -> None:
        """cv2.projectPoints; its camera looks along +Z with Y down, its pixel centres are whole."""
        rays = np.array([[0.0, 0, -1], [0.4, 0.2, -0.9], [-0.5, 0.3, -1], [0.1, -0.6, -1.2]])
        matrix = np.array([[220.0, 0, 149.5], [0, 220, 99.5], [0, 0, 1]])
        distortion = np.array([-0.08, 0, 0, 0, 0])
        want, _ = cv2.projectPoints(
            rays * [1, -1, -1], np.zeros(3), np.zeros(3), matrix, distortion
        )
        np.testing.assert_allclose(LENS.project(rays), want[:, 0] + 0.5, atol=1e-9)

    def test_the_middle_looks_ahead_and_right_is_right(self) -> None:
        ahead, right, up = LENS.rays(np.array([[150.0, 100], [200, 100], [150, 50]]))
        np.testing.assert_allclose(ahead, [0, 0, -1], atol=1e-12)
        assert right[0] > 0
        assert up[1] > 0

    def test_a_smaller_picture_shows_the_same(self) -> None:
        half = LENS.scaled(150, 100)
        places = np.array([[10.0, 20], [290, 150]])
        np.testing.assert_allclose(half.rays(places / 2), LENS.rays(places), atol=1e-9)

    def test_what_distortion_folds_is_not_ahead(self) -> None:
        """1 + 3 k1 r^2 = 0 at r = 2.04, 63.9 degrees."""
        angles = np.radians([63.0, 65.0])
        rays = np.stack([np.sin(angles), 0 * angles, -np.cos(angles)], 1)
        assert LENS.ahead(rays).tolist() == [True, False]
