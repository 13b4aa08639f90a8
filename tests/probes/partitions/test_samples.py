"""Samples of the faces of a probe made by hand, by cameras that are known, and their averages."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.cameras._response import Response
from skylight.probes.partitions._captured import (
    FaceDiscs,
    FaceSample,
    ProbeCapture,
    SampleCapture,
    read_samples,
)
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions.relight._live import RunningShading
from skylight.sphere._rotation import RigidTransform
from tests.probes.partitions.pictures import (
    FREE_MM,
    KERNEL_MM,
    RADIUS_MM,
    Shine,
    cube_probe,
    looking_from,
    picture_of_faces,
)

LENS = Intrinsics(width=320, height=240, fx=560.0, fy=560.0, cx=162.0, cy=117.0, k1=-0.1, p1=0.001)
TURN = Rotation.from_euler("yxz", [20.0, -15.0, 30.0], degrees=True).as_matrix()
MIDDLE = np.array([80.0, 130.0, 60.0])
PROBE = cube_probe(TURN, MIDDLE)
CORNER = TURN @ np.ones(3)
SHINE = np.random.default_rng(3).uniform(0.05, 0.7, (6, 3))


def flat(cells: np.ndarray, _points: np.ndarray) -> np.ndarray:
    return SHINE[cells]


def sloping(cells: np.ndarray, points: np.ndarray) -> np.ndarray:
    """As flat at the centres, changing by 30 % over a face."""
    across = (points - PROBE.face_centres[cells]) @ np.array([0.4, 0.7, -0.5])
    return SHINE[cells] * (1 + 0.02 * across[:, None])


def photo(pose: RigidTransform, *, brightness: float = 1.0, shine: Shine = flat) -> np.ndarray:
    light = brightness * picture_of_faces(PROBE, shine, LENS, pose)
    return Response().encode(torch.from_numpy(light.astype(np.float32)))


def blank() -> ProbeCapture:
    return ProbeCapture.blank(named_design("6d"), torch.full((3,), 0.8, dtype=torch.float64))


VIEWS = [looking_from(s * CORNER, MIDDLE, 200.0) for s in (1.0, -1.0)]


@pytest.mark.parametrize("shine", [flat, sloping])
def test_two_opposite_views_tell_all_six_faces(shine: Shine) -> None:
    capture = SampleCapture(PROBE, blank())
    taken = [capture.add_photo(photo(p, shine=shine), Response(), p, LENS) for p in VIEWS]
    assert taken == [3, 3]
    found = capture.captured()
    assert found.known.all()
    assert not found.saturated.any()
    np.testing.assert_allclose(found.shading, SHINE, rtol=0.01)


def test_a_sample_counts_the_pixels_of_its_disc() -> None:
    """Half of the free radius, foreshortened, 560 px at about 200 mm."""
    pose = looking_from(TURN @ np.array([0.0, 0.0, 1.0]), MIDDLE, 209.0)
    (sample,) = read_samples(photo(pose), Response(), FaceDiscs(PROBE), pose, LENS)
    assert sample.cell == 4
    assert sample.area_px == pytest.approx(np.pi * (4.0 * 560 / 200) ** 2, rel=0.04)


@pytest.mark.parametrize(("beyond_deg", "shown"), [(-1.0, True), (1.0, False)])
def test_walls_hide_what_is_behind_them(beyond_deg: float, shown: bool) -> None:
    """6 mm beside the centre, 9 mm up, behind a wall whose top is 17.3 mm up and beside it."""
    top = RADIUS_MM / np.sqrt(3)
    hidden = np.arctan2(top - 0.75 * FREE_MM, top - KERNEL_MM)
    angle = hidden + np.radians(beyond_deg)
    towards = TURN @ np.array([np.sin(angle), 0.0, np.cos(angle)])
    # far off, where all rays are parallel
    pose = looking_from(towards, MIDDLE + KERNEL_MM * TURN[:, 2], 3000.0)
    cells, _ = FaceDiscs(PROBE).visible(pose, replace(LENS, fx=8000.0, fy=8000.0))
    assert (4 in cells) == shown


def test_faces_out_of_the_frame_are_no_samples() -> None:
    pose = looking_from(CORNER, MIDDLE + 60 * VIEWS[0].rotation[0].numpy(), 200.0)
    assert read_samples(photo(pose), Response(), FaceDiscs(PROBE), pose, LENS) == []


def test_the_largest_view_is_kept_and_others_are_compared() -> None:
    near, far = VIEWS[0], looking_from(CORNER, MIDDLE, 260.0)
    capture = SampleCapture(PROBE, blank())
    capture.add_photo(photo(far, brightness=0.8), Response(), far, LENS)
    assert capture.add_photo(photo(near), Response(), near, LENS) == 3
    assert capture.add_photo(photo(far, brightness=0.8), Response(), far, LENS) == 0
    found = capture.captured()
    np.testing.assert_allclose(found.shading[found.known], SHINE[found.known.numpy()], rtol=0.01)
    # seen once more before and once after: 0.25 of 0.8, then 0.2 of 1
    np.testing.assert_allclose(found.disagreement[found.known], 0.225, atol=0.01)
    assert found.disagreement[~found.known].isnan().all()


def test_the_same_light_agrees_between_views() -> None:
    capture = SampleCapture(PROBE, blank())
    for towards in (CORNER, CORNER + 0.3 * TURN[:, 0], CORNER - 0.3 * TURN[:, 1]):
        pose = looking_from(towards, MIDDLE, 200.0)
        capture.add_photo(photo(pose), Response(), pose, LENS)
    assert np.nanmax(capture.captured().disagreement.numpy()) < 0.01


def test_faces_that_clip_are_not_taken() -> None:
    brightest = 2 * int(SHINE[[0, 2, 4]].max(1).argmax())
    scale = 1.2 / SHINE[brightest].max()
    capture = SampleCapture(PROBE, blank())
    capture.add_photo(photo(VIEWS[0], brightness=scale), Response(), VIEWS[0], LENS)
    found = capture.captured()
    assert found.saturated[brightest]
    assert not found.known[brightest]
    # a better exposure makes up for it
    capture.add_photo(photo(VIEWS[0]), Response(), VIEWS[0], LENS)
    assert not capture.captured().saturated.any()


def test_small_faces_are_not_taken() -> None:
    pose = looking_from(CORNER, MIDDLE, 2500.0)
    capture = SampleCapture(PROBE, blank())
    assert capture.add_photo(photo(pose), Response(), pose, LENS) == 0
    assert capture.small.sum() == 3


def test_a_pose_off_by_a_millimetre_costs_nothing_on_even_faces() -> None:
    taken = photo(VIEWS[0])
    for shift in torch.diag(torch.tensor([1.0, 1.0, 5.0]).double()):
        off = RigidTransform.translating(shift) @ VIEWS[0]
        samples = read_samples(taken, Response(), FaceDiscs(PROBE), off, LENS)
        assert len(samples) == 3
        for sample in samples:
            np.testing.assert_allclose(sample.radiance, SHINE[sample.cell], rtol=0.01)


def test_a_capture_goes_on_from_what_is_known() -> None:
    first = SampleCapture(PROBE, blank())
    first.add_photo(photo(VIEWS[0]), Response(), VIEWS[0], LENS)
    second = SampleCapture(PROBE, first.captured())
    second.add_photo(photo(VIEWS[1]), Response(), VIEWS[1], LENS)
    assert second.captured().known.all()
    sample = FaceSample(cell=0, radiance=torch.ones(3).double(), area_px=1e6, clipped=0.0)
    assert second.add([sample]) == 1
    np.testing.assert_array_equal(second.captured().shading[0], 1.0)


def sample(cell: int, value: float, *, area: float = 50.0, clipped: float = 0.0) -> FaceSample:
    return FaceSample(
        cell=cell,
        radiance=torch.full((3,), value, dtype=torch.float64),
        area_px=area,
        clipped=clipped,
    )


def test_first_sight_counts_whole_and_later_ones_blend() -> None:
    running = RunningShading(torch.zeros(2, 3).double(), torch.zeros(2, dtype=torch.bool))
    assert running.add([sample(1, 0.5)]) == 1
    assert running.known.tolist() == [False, True]
    assert running.shading[1].tolist() == [0.5] * 3
    for _ in range(5):
        running.add([sample(1, 1.0)])
    # 1 - 0.5 x 0.8^5
    assert float(running.shading[1, 0]) == pytest.approx(0.83616)


def test_noise_is_averaged() -> None:
    running = RunningShading(torch.zeros(1, 3).double(), torch.zeros(1, dtype=torch.bool))
    noise = np.random.default_rng(0).normal(0.5, 0.1, 2000)
    kept = []
    for value in noise:
        running.add([sample(0, value)])
        kept.append(float(running.shading[0, 0]))
    # of an exponential mean with weight a, variance falls by a / (2 - a)
    assert np.std(kept[50:]) == pytest.approx(0.1 * np.sqrt(0.2 / 1.8), rel=0.15)


def test_what_cannot_be_read_is_left_alone() -> None:
    running = RunningShading(torch.full((2, 3), 0.3), torch.ones(2, dtype=torch.bool))
    assert running.add([sample(0, 0.9, clipped=0.5), sample(1, 0.9, area=2.0)]) == 0
    assert (running.shading == 0.3).all()
