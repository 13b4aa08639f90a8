"""One, two and four faces of a scene: who is put together, and what is compared."""

import json
import math
from types import SimpleNamespace

import pytest

from skylight.errors import InputError
from skylight.evaluation import _shared_light as shared_light
from skylight.evaluation._known_faces import (
    NOT_FOUND,
    EstimateOptions,
    FaceSource,
    KnownFace,
    rendered_here,
    stage,
)
from skylight.evaluation._shared_light import SharedLight


@pytest.fixture
def folder(tmp_path):
    """Nine faces: two scenes of four, and one face of a third."""
    for number in range(9):
        face = tmp_path / "faces" / f"face{number:04d}"
        face.mkdir(parents=True)
        (face / "face.json").write_text(json.dumps({"scene": number // 4}))
    return tmp_path / "faces"


@pytest.fixture
def estimated(monkeypatch):
    """Faces are 0, 1, ...; n of them together find the sun 24 / n degrees aside, and are noted."""
    truth: KnownFace = rendered_here(20_000_000, 64)
    together = []

    def light_together(self, observations, light):
        together.append(list(observations))
        turn = math.radians(24 / len(observations))
        return SimpleNamespace(environment=truth.environment.rotate_azimuth(turn))

    def observe(picture, clipped, model, fit):
        return SimpleNamespace(observation=fit)

    names = iter(range(100))
    monkeypatch.setattr(FaceSource, "read", lambda self, name: truth)
    monkeypatch.setattr(shared_light, "fitted_head", lambda face, seconds: next(names))
    monkeypatch.setattr(shared_light, "observe_face", observe)
    monkeypatch.setattr(EstimateOptions, "estimate", light_together)
    return together


def test_scenes_of_four(folder):
    evaluation = SharedLight(data=folder)
    assert evaluation.items() == ["scene0000", "scene0001"]
    assert evaluation.names["scene0001"] == [f"face{i:04d}" for i in (4, 5, 6, 7)]
    assert SharedLight(data=folder, scenes=1).items() == ["scene0000"]


def test_single_faces_are_no_scenes(tmp_path):
    face = tmp_path / "face0000"
    face.mkdir()
    (face / "face.json").write_text('{"scene": 0}')
    with pytest.raises(InputError, match="--per-scene 4"):
        SharedLight(data=tmp_path)
    (face / "face.json").write_text("{}")
    with pytest.raises(InputError, match=r"face\.json"):
        SharedLight(data=tmp_path)


def test_every_face_counts_once_for_each_number_of_faces(folder, estimated, tmp_path):
    evaluation = SharedLight(data=folder)
    item = evaluation.measure("scene0000", tmp_path / "scene.png")
    assert estimated == [[0], [1], [2], [3], [0, 1], [2, 3], [0, 1, 2, 3]]
    angle = {label: row["sun_angle_deg"] for label, row in item.metrics.items()}
    assert list(angle) == ["1 face", "2 faces", "4 faces"]
    # a turn of the sky turns a sun above the horizon by less; its brightest pixels leave a margin
    assert 0 < angle["4 faces"] < angle["2 faces"] < angle["1 face"] < 25
    assert (tmp_path / "scene.png").is_file()
    seconds = item.facts["seconds"]
    assert isinstance(seconds, dict)
    assert {"transport", *angle} <= seconds.keys()


def test_what_is_done_four_times_is_timed_in_sum():
    seconds = {"head": 100.0}
    with stage(seconds, "head"):
        pass
    assert 100 < seconds["head"] < 101


def test_a_scene_with_a_face_that_is_not_found_is_left_out(folder, estimated, monkeypatch):
    def unfound(face, seconds):
        raise InputError(NOT_FOUND)

    monkeypatch.setattr(shared_light, "fitted_head", unfound)
    with pytest.raises(InputError, match="face0004: no face found by the landmark detector"):
        SharedLight(data=folder).measure("scene0001", folder / "scene.png")


def test_four_faces_are_compared_with_one(folder):
    def rows(four):
        return {
            label: {"sun_angle_deg": {"mean": mean}}
            for label, mean in (("1 face", 10.0), ("2 faces", 8.0), ("4 faces", four))
        }

    (met,) = SharedLight(data=folder).checks(rows(5.0), []).values()
    assert met.value == pytest.approx(0.5)
    assert met.ok
    (missed,) = SharedLight(data=folder).checks(rows(7.0), []).values()
    assert not missed.ok
    assert SharedLight(data=folder).checks({"1 face": {"mae": {"mean": 1.0}}}, []) == {}
