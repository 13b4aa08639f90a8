"""Perturbations by exactly what was asked, and the curves made of them."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from skylight.evaluation import _face_sensitivity as face_sensitivity
from skylight.evaluation._face_sensitivity import (
    ANGLES_DEG,
    SIGMAS,
    UNCHANGED,
    Condition,
    FaceSensitivity,
    curves,
    face_height_px,
    misshapen,
    perturbed,
    resampled,
    turned_head,
    write_sensitivity,
)
from skylight.evaluation._known_faces import FaceSource, KnownFace, pose_error_deg, rendered_here
from skylight.faces._fit import camera_project
from skylight.faces._model import HeadModel


@pytest.fixture(scope="module")
def face() -> KnownFace:
    return rendered_here(20_000_000, 64)


@pytest.mark.parametrize(("axis", "still"), [("y", 1), ("x", 0)])
@pytest.mark.parametrize("angle", [5.0, 30.0])
def test_a_turned_head_is_turned_by_the_angle_about_its_centre(face, axis, still, angle):
    turned = turned_head(face.truth, axis, angle)
    assert pose_error_deg(turned, face.truth) == pytest.approx(angle)
    centre = [f.translation[None] for f in (face.truth, turned)]
    before, after = (camera_project(face.truth.camera, c) for c in centre)
    assert after == pytest.approx(before)
    # a rigid motion that leaves the coordinate along its axis alone
    assert turned.vertices[:, still] == pytest.approx(face.truth.vertices[:, still])
    radius = [np.linalg.norm(f.vertices - f.translation, axis=1) for f in (face.truth, turned)]
    assert radius[1] == pytest.approx(radius[0])


def test_pose_and_vertices_of_a_turned_head_agree(face):
    turned = turned_head(face.truth, "y", 12.0)
    shape = HeadModel.load().vertices(face.truth.identity, face.truth.expression)
    assert turned.vertices == pytest.approx(shape @ turned.rotation.T + turned.translation)


def test_noise_of_the_shape_grows_along_one_direction(face):
    steps = {s: misshapen(face.truth, s, seed=3) for s in (0.0, 0.5, 1.0)}
    assert steps[0.0].vertices == pytest.approx(face.truth.vertices)
    half, whole = (steps[s].identity - face.truth.identity for s in (0.5, 1.0))
    assert whole == pytest.approx(2 * half)
    # standard normal, so of mean square 1 within five deviations of sqrt(2 / n)
    seeds = [misshapen(face.truth, 1.0, seed) for seed in range(8)]
    for errors in (
        np.concatenate([fit.identity - face.truth.identity for fit in seeds]),
        np.concatenate([fit.expression - face.truth.expression for fit in seeds]),
    ):
        deviation = math.sqrt(2 / len(errors))
        assert np.square(errors).mean() == pytest.approx(1, abs=5 * deviation)
        assert 5 * deviation < 0.5  # that of half the noise would be 1/4


def test_another_size_shows_the_same_head(face):
    small = resampled(face, 32)
    assert small.picture.shape == (32, 32, 3)
    assert small.picture.mean() == pytest.approx(float(face.picture.mean()), rel=1e-5)
    points = [camera_project(f.truth.camera, f.truth.vertices[:100]) for f in (face, small)]
    assert points[1] == pytest.approx(points[0] / 2)
    assert face_height_px(small.truth) == pytest.approx(face_height_px(face.truth) / 2, abs=1)
    # a pixel counts as over-exposed where any part of it is
    clipped = torch.zeros(64, 64, dtype=torch.bool)
    clipped[10, 21] = clipped[30:34, 40:44] = True
    small = resampled(replace(face, clipped=clipped), 32)
    assert torch.equal(small.clipped, clipped.reshape(32, 2, 32, 2).any(3).any(1))
    assert int(small.clipped.sum()) == 1 + 4


def test_only_sizes_that_a_picture_has():
    evaluation = FaceSensitivity(count=1, size=64)
    asked = [c for c in evaluation.conditions(192) if c is not None]
    assert [c.value for c in asked if c.factor == "size"] == [90, 128, 192]
    assert len(evaluation.conditions(360)) == 1 + 5 + 2 * (len(ANGLES_DEG) - 1) + len(SIGMAS) - 1


def test_a_condition_changes_what_it_names(face):
    turned = perturbed(face, Condition(factor="pitch", value=10.0), 0)
    assert turned.truth.vertices[:, 0] == pytest.approx(face.truth.vertices[:, 0])
    assert turned.picture is face.picture
    assert perturbed(face, Condition(factor="shape", value=1.0), 0).picture is face.picture
    assert perturbed(face, Condition(factor="size", value=48.0), 0).picture.shape == (48, 48, 3)


def rows(errors: dict[str, float]) -> dict[str, dict[str, dict[str, float]]]:
    return {f"autoencoder, {k}": {"full_dw_mae": {"mean": v}} for k, v in errors.items()}


def test_growth_is_relative_to_the_true_head_and_the_largest_picture():
    errors = {UNCHANGED: 0.5, "yaw 15": 0.5, "pitch 15": 0.6, "size 90": 0.75, "size 360": 0.6}
    pose, size = FaceSensitivity(count=1, size=64).checks(rows(errors), []).values()
    assert pose.value == pytest.approx(0.1)
    assert pose.ok
    assert size.value == pytest.approx(0.25)
    assert not size.ok


def test_curves_start_at_the_unchanged_face_and_pose_means_both_axes(tmp_path):
    errors = {UNCHANGED: 1.0, "yaw 5": 2.0, "pitch 5": 4.0, "shape 1.1": 5.0, "size 90": 6.0}
    found = curves(rows(errors))
    assert found["pose"]["full_dw_mae"]["autoencoder"] == [(0, 1), (5, 3)]
    assert found["pitch"]["full_dw_mae"]["autoencoder"] == [(0, 1), (5, 4)]
    assert found["shape"]["full_dw_mae"]["autoencoder"] == [(0, 1), (1.1, 5)]
    assert found["size"]["full_dw_mae"]["autoencoder"] == [(90, 6)]
    names = {path.name for path in write_sensitivity(tmp_path, found)}
    assert names == {f"figure_{n}.png" for n in ("5_8", "b_5", "b_6", "b_7")}


def test_every_condition_has_a_row_for_each_method(tmp_path, monkeypatch):
    seen = []

    def light_of(face, fit, methods, seconds, *, face_height_px, options):
        seen.append((fit, face_height_px))
        seconds["transport"] = 1.0
        metrics = {m: {"full_dw_mae": float(len(seen)), "seconds": 1.0} for m in methods}
        return SimpleNamespace(metrics=metrics)

    monkeypatch.setattr(face_sensitivity, "light_of", light_of)
    evaluation = FaceSensitivity(
        count=1,
        size=64,
        sizes=(48,),
        angles_deg=(0.0, 15.0),
        sigmas=(0.0,),
        methods=("sh9", "sh25"),
    )
    item = evaluation.measure("face0000", tmp_path / "face.png")
    labels = [UNCHANGED, "size 48", "yaw 15", "pitch 15"]
    assert list(item.metrics) == [f"{m}, {label}" for label in labels for m in ("sh9", "sh25")]
    assert item.metrics["sh25, yaw 15"] == {"full_dw_mae": 3.0}
    truth = rendered_here(20_000_000, 64).truth
    assert [round(pose_error_deg(fit, truth)) for fit, _ in seen] == [0, 0, 15, 15]
    # only a resampled picture sets how many pixels are looked at
    assert [height for _, height in seen] == [None, face_height_px(seen[1][0]), None, None]


def test_every_face_has_noise_of_its_own(face, tmp_path, monkeypatch):
    seeds = []

    def noted(face, condition, noise_seed):
        seeds.append(noise_seed)
        return face

    def light_of(*_, **__):
        return SimpleNamespace(metrics={})

    monkeypatch.setattr(FaceSource, "read", lambda self, name: face)
    monkeypatch.setattr(face_sensitivity, "perturbed", noted)
    monkeypatch.setattr(face_sensitivity, "light_of", light_of)
    evaluation = FaceSensitivity(count=24, size=64, sizes=(), angles_deg=(0.0,), sigmas=(0.0, 1.1))
    for name in evaluation.items():
        evaluation.measure(name, tmp_path / "face.png")
    assert len(seeds) == len(set(seeds)) == 24


def test_curves_go_from_the_least_change_to_the_largest() -> None:
    rows = {f"a, yaw {deg}": {"mae": {"mean": deg}} for deg in (9.0, -3.0, 6.0)}
    found = face_sensitivity.curves(rows)["yaw"]["mae"]["a"]
    assert found == [(-3.0, -3.0), (6.0, 6.0), (9.0, 9.0)]
