"""What evaluations of faces write down of an estimate, whose light is given here."""

import json
import math
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.evaluation import (
    _known_faces as known_faces,
    _lamps as lamps,
    _real_faces as real_faces,
    _speed as speed,
    _synthetic_faces as synthetic_faces,
)
from skylight.evaluation._known_faces import (
    EstimateOptions,
    FaceSource,
    KnownFace,
    LitFace,
    choice_facts,
    face_score,
    lamps_chosen,
    light_by_method,
    rendered_here,
)
from skylight.evaluation._run import Item
from skylight.faces._captures import write_azimuths
from skylight.faces._fit import FaceFit
from skylight.faces._observe import FaceView
from skylight.faces._synthetic import SyntheticFace
from skylight.imaging._photo import Photo
from skylight.inverse._result import Estimate
from skylight.inverse._sky import THESIS
from skylight.people._render import RenderedFace
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import angle_between
from skylight.transport._observation import Observation
from tests.evaluation.test_any_light import posterior_at, room
from tests.face_captures import PHOTO, TURNS_DEG

SUMMARY = "direction sure, brightness rough, colour rough"


def an_estimate(light: EnvironmentMap, *, cell: int = 0, name: str = "autoencoder"):
    return SimpleNamespace(
        light=name,
        environment=light,
        lamps=(),
        log_evidence=-100.0,
        posterior=posterior_at(cell),
        verdict=SimpleNamespace(summary=SUMMARY, direction=SimpleNamespace(word="sure")),
        faces=(SimpleNamespace(residual=0.25),),
        sun_direction=light.brightest_direction(),
        rendered=torch.zeros(1, 3),
        advice=("step back",),
    )


def made(kind: type, **fields: object):
    """One of a dataclass that has no more than some of its fields."""
    one = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(one, name, value)
    return one


def changed(one, **fields: object):
    """``replace``, of what may lack fields too."""
    other = type(one).__new__(type(one))
    for name, value in (vars(one) | fields).items():
        object.__setattr__(other, name, value)
    return other


def no_picture(*_: object, **__: object) -> np.ndarray:
    return np.zeros((4, 4, 3), np.uint8)


# lamps


@pytest.fixture
def lamp_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Lamps ahead of the face, hard at its side, and behind it; the light found is room((20, .5)).

    The posterior is sure of the hard lamp's cell.
    """
    cell_of = {}
    grid = posterior_at(0).grid
    side = torch.nn.functional.normalize(torch.tensor([0.9, 0.2, 0.3]).double(), dim=0)
    index = {"a_1.png": [0.0, 0.0, 1.0], "b_2.png": side.tolist(), "b_3.png": [0.0, 0.6, -0.8]}
    index["c_4.png"] = [1.0, 0.0, 0.0]
    (tmp_path / "lamps.json").write_text(json.dumps(index))
    cell_of["side"] = int((grid.directions @ side).argmax())

    def light_by_method(observation, methods, seconds, options):
        seconds["autoencoder"] = 1.0
        found = an_estimate(room((180 - 20, 0.5)), cell=cell_of["side"])
        return dict.fromkeys(methods, found)

    fit = made(FaceFit, landmark_error=0.02, rotation=np.eye(3))
    view = SimpleNamespace(observation=None)
    monkeypatch.setattr(lamps, "read_lamp_photo", lambda path: path.name)
    monkeypatch.setattr(lamps, "observe_largest", lambda photo, name, seconds: (fit, view))
    monkeypatch.setattr(lamps, "light_by_method", light_by_method)
    for name in ("seen_and_rendered", "strip", "beside"):
        monkeypatch.setattr(lamps, name, no_picture)
    lamps.lamp_index.cache_clear()
    yield tmp_path
    lamps.lamp_index.cache_clear()


def test_lamps_beside_a_face_count_and_those_behind_do_not(lamp_folder: Path) -> None:
    evaluation = lamps.Lamps(data=lamp_folder)
    assert evaluation.items() == ["a_1.png", "b_2.png", "b_3.png", "c_4.png"]
    assert lamps.Lamps(data=lamp_folder, every=2).items() == ["a_1.png", "b_3.png"]
    items = {name: evaluation.measure(name, lamp_folder / "p.png") for name in evaluation.items()}
    assert {name: sorted(item.metrics) for name, item in items.items()} == {
        "a_1.png": sorted(lamps.METHODS),
        "b_2.png": sorted(lamps.METHODS),
        "b_3.png": [],
        "c_4.png": sorted(lamps.METHODS),
    }
    ahead = items["a_1.png"].metrics["autoencoder"]
    assert set(ahead) == {"angle_deg", "elevation_deg", "azimuth_deg", "in_region", "region_sr"}
    assert ahead["elevation_deg"] == pytest.approx(10, abs=1.5)  # the light found is 10 high
    assert abs(ahead["azimuth_deg"]) == pytest.approx(20, abs=1.5)
    regions = [items[n].metrics["lamps"]["in_region"] for n in ("a_1.png", "b_2.png", "c_4.png")]
    assert regions == [0, 1, 0]
    for name, item in items.items():
        assert item.name == name
        assert item.facts["person"] == name[0]
        assert item.facts["direction"] == "sure"
        assert item.facts["verdicts"] == dict.fromkeys(lamps.METHODS, SUMMARY)
        assert item.facts["chosen"] == "autoencoder"
        assert item.facts["residual"] == 0.25
        assert item.facts["landmark_error"] == 0.02
        assert item.facts["seconds"] == {"autoencoder": 1.0}
        assert (item.facts["yaw_deg"], item.facts["pitch_deg"]) == (0, 0)


def test_yaw_is_to_the_right_and_pitch_up() -> None:
    y, p = math.radians(20), math.radians(10)
    ahead = np.array([math.sin(y) * math.cos(p), math.sin(p), math.cos(y) * math.cos(p)])
    fit = made(FaceFit, rotation=np.stack([np.zeros(3), np.zeros(3), ahead], 1))
    assert lamps.pose_deg(fit) == pytest.approx({"yaw_deg": 20, "pitch_deg": 10})


def lamp_rows(median: float, mean: float, bias: float) -> dict:
    row = {
        "angle_deg": {"median": median, "mean": mean},
        "elevation_deg": {"median": bias},
        "azimuth_deg": {"median": -bias},
        "in_region": {"mean": 0.9},
    }
    return dict.fromkeys(lamps.METHODS, row)


def test_goals_of_lamps(lamp_folder: Path) -> None:
    def item(name: str, angle: float, word: str = "sure", problem: str = "") -> Item:
        metrics = {} if problem else {lamps.OURS: {"angle_deg": angle}}
        facts = {"direction": word, "chosen": "lamps"}
        return Item(name=name, metrics=metrics, facts=facts, problem=problem)

    items = [item(str(i), 5.0) for i in range(9)] + [item("9", 12.0)]
    items += [item("10", 80.0, "rough")]
    checks = lamps.Lamps(data=lamp_folder).checks(lamp_rows(5.0, 8.0, 1.0), items)
    assert {name: check.ok for name, check in checks.items()} == dict.fromkeys(
        (
            *("faces found", "median angle", "mean angle", "bias of elevation"),
            *("bias of azimuth", "lamp in the 90 % region", "median angle of lamps"),
            *("median angle of auto", "faces for which lamps are chosen"),
            "of 10 of sure direction, within 10 degrees",
        ),
        True,
    )
    assert checks["of 10 of sure direction, within 10 degrees"].value == pytest.approx(0.9)
    assert checks["bias of azimuth"].value == 1
    items += [item("11", 0.0, problem="no face found by the landmark detector")]
    items[0] = item("0", 12.0)
    items[0].facts["chosen"] = items[1].facts["chosen"] = "autoencoder"
    checks = lamps.Lamps(data=lamp_folder).checks(lamp_rows(7.0, 10.0, 3.0), items)
    assert checks["faces found"].value == pytest.approx(11 / 12)
    assert not any(c.ok for n, c in checks.items() if n != "lamp in the 90 % region")
    assert list(lamps.Lamps(data=lamp_folder).checks({}, items[-1:])) == [
        "faces found",
        "faces for which lamps are chosen",
    ]


# rendered people


@pytest.fixture(scope="module")
def face() -> KnownFace:
    return rendered_here(20_000_000, 64)


@pytest.fixture
def lit(face: KnownFace, monkeypatch: pytest.MonkeyPatch) -> list[EstimateOptions]:
    """Every estimate is the true light turned by 10 degrees; the options of the second are kept."""
    asked: list[EstimateOptions] = []
    turned = face.environment.rotate_azimuth(math.radians(10))
    grid = posterior_at(0).grid
    cell = int((grid.directions @ face.environment.brightest_direction()).argmax())
    scores = face_score(turned, face)

    def lit(self, face, methods):
        estimates = {m: an_estimate(turned, cell=cell, name=m) for m in methods}
        return made(
            LitFace,
            fit=face.truth,
            view=SimpleNamespace(observation=7, blocks=torch.arange(3)),
            estimates=estimates,
            metrics={m: dict(scores) for m in methods},
            seconds={"head": 0.5},
        )

    def by_method(observation, methods, seconds, options, cpu_seconds=None):
        assert observation == 7
        asked.append(options)
        seconds["autoencoder"], cpu_seconds["autoencoder"] = 3.0, 2.0
        return {methods[0]: an_estimate(face.environment)}

    monkeypatch.setattr(synthetic_faces.SyntheticFaces, "lit", lit)
    monkeypatch.setattr(synthetic_faces, "light_by_method", by_method)
    monkeypatch.setattr(FaceSource, "read", lambda self, name: face)
    for name in ("strip", "beside"):
        monkeypatch.setattr(synthetic_faces, name, no_picture)
    return asked


def test_a_rendered_face_has_rows_by_method_and_by_the_thesis_solver(
    face: KnownFace, lit: list[EstimateOptions], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    evaluation = synthetic_faces.SyntheticFaces(count=1, size=64)
    item = evaluation.measure("face0000", tmp_path / "a.png")
    assert list(item.metrics) == [*evaluation.methods, "autoencoder_thesis"]
    assert [options.solver for options in lit] == [THESIS]
    thesis = item.metrics["autoencoder_thesis"]
    assert (thesis["seconds"], thesis["cpu_seconds"]) == (3, 2)
    assert thesis["full_dw_mae"] == pytest.approx(0, abs=1e-6)
    ours = item.metrics["sphere"]
    assert set(ours) == set(item.metrics["autoencoder"])
    sun = face.environment.brightest_direction()
    turned = face.environment.rotate_azimuth(math.radians(10)).brightest_direction()
    apart = math.degrees(float(angle_between(sun, turned)))
    assert ours["sun_angle_deg"] == pytest.approx(apart, abs=0.1)
    assert (ours["pose_deg"], ours["in_region"]) == (pytest.approx(0, abs=1e-4), 1)
    assert ours["peak_mib"] > 50
    assert not {"pose_deg", "in_region", "peak_mib"} & set(item.metrics["sh9"])
    assert item.facts == {
        "sun_visible": True,
        "landmark_error": face.truth.landmark_error,
        "pose_deg": ours["pose_deg"],
        "pixels": 3,
        "direction": "sure",
        **{name: item.facts[name] for name in ("evidence", "peak_mib")},
        "chosen": "auto",
        "seconds": {"head": 0.5},
    }
    hidden = replace(face, sun_visible=False, tone=4)
    monkeypatch.setattr(FaceSource, "read", lambda self, name: hidden)
    few = replace(evaluation, methods=("sh9", "autoencoder"))
    item = few.measure("face0000", tmp_path / "a.png")
    assert item.facts["skin tone"] == 4
    assert "in_region" not in item.metrics["autoencoder"]
    plain = replace(evaluation, methods=("sh9",)).measure("face0000", tmp_path / "a.png")
    assert list(plain.metrics) == ["sh9"]
    assert "direction" not in plain.facts


def test_an_ablation_adds_what_is_known(
    face: KnownFace, lit: list[EstimateOptions], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def light_of(face, fit, methods, seconds, *, options):
        assert fit is face.truth
        return SimpleNamespace(metrics={methods[0]: {"mae": 0.5}})

    monkeypatch.setattr(synthetic_faces, "light_of", light_of)
    for name in ("with_true_albedo", "from_true_light"):
        monkeypatch.setattr(
            synthetic_faces, name, lambda observation, face: an_estimate(face.environment)
        )
    evaluation = synthetic_faces.SyntheticFaces(count=1, ablation=True, methods=("autoencoder",))
    item = evaluation.measure("face0000", tmp_path / "a.png")
    ends = ("", "_thesis", "_true", "_true_albedo", "_true_start")
    assert list(item.metrics) == [f"autoencoder{end}" for end in ends]
    assert item.metrics["autoencoder_true"] == {"mae": 0.5}
    for end in ends[3:]:
        assert item.metrics[f"autoencoder{end}"]["mae"] == pytest.approx(0, abs=1e-6)


def test_people_without_a_folder_are_150() -> None:
    assert len(synthetic_faces.SyntheticFaces().items()) == 150
    assert synthetic_faces.SyntheticFaces(count=2).items() == ["face0000", "face0001"]
    assert synthetic_faces.SyntheticFaces().name == "synthetic-faces"
    assert synthetic_faces.SyntheticFaces(data=Path("faces")).name == "rendered-faces"


def test_every_face_has_a_seed_of_its_own(face: KnownFace, monkeypatch: pytest.MonkeyPatch) -> None:
    seeds: list[tuple[int, int]] = []

    def rendered(seed: int, size: int) -> KnownFace:
        seeds.append((seed, size))
        return face

    monkeypatch.setattr(known_faces, "rendered_here", rendered)
    source = FaceSource(data=None, count=3, size=64, seed=5)
    for name in source.names():
        source.read(name)
    assert seeds == [(5, 64), (1005, 64), (2005, 64)]
    assert source.config() == {"size": 64, "seed": 5}


def test_grounds_differ_from_face_to_face(face: KnownFace, monkeypatch: pytest.MonkeyPatch) -> None:
    grounds = []

    def render(sky, ground, *, seed, size):
        assert size == 32
        grounds.append((seed, tuple(ground.tolist())))
        return face

    monkeypatch.setattr(known_faces, "render_face", render)
    firsts = []

    def simulated(count, *, first_seed, lowest_transmittance):
        assert (count, lowest_transmittance) == (1, known_faces.LOWEST_TRANSMITTANCE)
        firsts.append(first_seed)
        return [(None, None)]

    monkeypatch.setattr(known_faces, "simulated_skies", simulated)
    for seed in range(12):
        known_faces.synthetic_face(seed, 32)
    assert [seed for seed, _ in grounds] == firsts == list(range(12))
    assert 4 < len({ground for _, ground in grounds}) <= 9


def test_auto_chooses_of_its_rivals_and_takes_what_they_take(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = []

    def estimate(self, observation, light):
        asked.append((light, self.solver.evidence))
        return made(Estimate, light=light)

    monkeypatch.setattr(EstimateOptions, "estimate", estimate)
    monkeypatch.setattr(known_faces, "choose", lambda rivals: rivals[-1])
    seconds: dict[str, float] = {}
    cpu: dict[str, float] = {}
    seen, methods = made(Observation), ("autoencoder", "lamps", "auto")
    found = light_by_method(seen, methods, seconds, EstimateOptions(), cpu)
    assert list(found) == ["autoencoder", "lamps", "auto"]
    assert asked == [("autoencoder", True), ("lamps", True)]
    assert seconds["auto"] == seconds["autoencoder"] + seconds["lamps"]
    assert cpu["auto"] == cpu["autoencoder"] + cpu["lamps"]
    asked.clear()
    light_by_method(seen, ("sh9",), {}, EstimateOptions())
    assert asked == [("sh9", False)]
    with pytest.raises(InputError, match="name them first"):
        light_by_method(seen, ("auto",), {}, EstimateOptions())


@pytest.mark.parametrize(
    ("through", "seen"), [(None, False), (0.0, False), (1.0, True), ("least", True)]
)
def test_a_sun_is_visible_that_comes_through(face: KnownFace, through, seen: bool) -> None:
    least = known_faces.LOWEST_TRANSMITTANCE
    own = {each.name: getattr(face, each.name) for each in fields(SyntheticFace)}
    rendered = made(
        RenderedFace,
        **own,
        cluster=3,
        sun_transmittance=least if through == "least" else through,
    )
    found = known_faces.known_face(rendered)
    assert (found.sun_visible, found.tone) == (seen, 3)
    assert found.picture is face.picture


def test_the_true_albedo_and_light_are_what_a_problem_is_given(
    face: KnownFace, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = []

    class Problem:
        def __init__(self, model, light_prior, albedo_prior, modes) -> None:
            given.append((model, light_prior, albedo_prior, modes, []))

        def add(self, observation) -> None:
            given[-1][-1].append(observation)

    monkeypatch.setattr(synthetic_faces, "SkyProblem", Problem)
    monkeypatch.setattr(synthetic_faces, "solve", lambda problems: [made(Estimate, grey=1)])
    monkeypatch.setattr(synthetic_faces, "true_parameters", lambda environment: torch.zeros(1, 65))
    seen = made(Observation)
    synthetic_faces.with_true_albedo(seen, face)
    synthetic_faces.from_true_light(seen, face)
    (_, _, known, modes, added), (model, _, prior, _, again) = given
    assert added == again == [seen]
    torch.testing.assert_close(known.means, face.albedo.log()[None])
    torch.testing.assert_close(known.precision_factors, 100 * torch.eye(3)[None])
    assert torch.equal(modes, face.albedo[None])
    assert torch.equal(model.starts(), torch.zeros(1, 65))
    assert len(prior.means) >= 1


def test_an_ablation_of_lamps_leaves_one_part_out_in_each_row(
    monkeypatch: pytest.MonkeyPatch, lamp_folder: Path
) -> None:
    asked = []

    def estimate(self, observation, light):
        asked.append((self.solver.weights, observation))
        return made(Estimate, light=light)

    seen = made(Observation, normal_modes=torch.ones(1))
    other = made(Observation, normal_modes=torch.ones(2))
    fitted = []
    monkeypatch.setattr(EstimateOptions, "estimate", estimate)
    monkeypatch.setattr(lamps, "replace", changed)
    face = SimpleNamespace(readings=7)
    found = SimpleNamespace(detect=lambda encoded: [face])
    monkeypatch.setattr(lamps, "choose_landmarker", lambda *_: found)
    monkeypatch.setattr(lamps, "find_spec", lambda name: name)
    monkeypatch.setattr(
        lamps, "fit_visible", lambda model, photo, head, name: fitted.append((name, head.readings))
    )
    monkeypatch.setattr(lamps, "observe_face", lambda *_: made(FaceView, observation=other))
    photo = made(Photo, encoded=None, pixels=None, clipped=None)
    rows = lamps.Lamps(data=lamp_folder)._ablation(photo, made(FaceView, observation=seen))
    names = ("_balanced", "_varying_skin", "_trusted_normals", "_68_points", "_dlib")
    assert list(rows) == [f"{lamps.OURS}{name}" for name in names]
    usual = EstimateOptions().solver.weights
    assert asked[0][0] == replace(usual, white_balance_spread=0.0)
    assert asked[1][0] == replace(usual, pigment_spread=1.0)
    assert all(weights == usual for weights, _ in asked[2:])
    assert asked[2][1].normal_modes is None
    assert asked[3][1] is asked[4][1] is other
    assert fitted == [("_68_points", None), ("_dlib", 7)]


def test_what_auto_chose_is_a_fact() -> None:
    found = {"sh9": an_estimate(room()), "auto": an_estimate(room(), name="lamps")}
    assert choice_facts(found) == {
        "chosen": "lamps",
        "evidence": {"sh9": -100.0, "auto": -100.0},
    }
    assert choice_facts({"sh9": an_estimate(room())}) == {}
    items = [Item(name="a", metrics={}, facts={"chosen": c}) for c in ("lamps", "autoencoder")]
    (check,) = lamps_chosen([*items, Item(name="b", metrics={})]).values()
    assert (check.value, check.ok) == (0.5, False)
    assert lamps_chosen([Item(name="b", metrics={})]) == {}


# photographs


def test_a_photograph_with_a_note_is_told_by_its_side(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    notes = {
        "a.png": {"light": "sun-hard", "desc": "hard sun from viewer's right"},
        "b.png": {"light": "sun-back", "desc": "hard sun from viewer's right"},
        "c.png": {"light": "soft", "desc": "light from viewer's left"},
    }
    (tmp_path / "index.json").write_text(json.dumps(notes))
    light = room((60, 0.5))
    across = float(light.mean_direction(upper_only=True)[0])
    assert across > 0.1

    def by_method(observation, methods, seconds, options):
        seconds |= {"landmarks": 1.0} | dict.fromkeys(methods, 10.0)
        return {m: an_estimate(light, name=m) for m in methods}

    fit = SimpleNamespace(landmark_error=0.02, facing_angle_rad=math.radians(30))
    view = SimpleNamespace(observation=None)
    monkeypatch.setattr(real_faces, "read_photo", lambda path, require_colour: require_colour)

    def observe_largest(photo, name, seconds):
        assert photo  # of which colour is required
        return fit, view

    monkeypatch.setattr(real_faces, "observe_largest", observe_largest)
    monkeypatch.setattr(real_faces, "light_by_method", by_method)
    for name in ("seen_and_rendered", "strip", "beside"):
        monkeypatch.setattr(real_faces, name, no_picture)
    real_faces._read_index.cache_clear()
    evaluation = real_faces.RealFaces(data=tmp_path)
    assert evaluation.items() == list(notes)
    assert replace(evaluation, every=2).items() == ["a.png", "c.png"]
    items = [evaluation.measure(name, tmp_path / "p.png") for name in notes]
    assert list(items[0].metrics) == list(real_faces.PHOTO_METHODS)
    sides = [item.metrics["sh9"].get("right_side") for item in items]
    assert sides == [1.0, None, 0.0]
    ours = items[0].metrics[real_faces.OURS]
    assert ours == {
        "finite": 1.0,
        "residual": 0.25,
        "light_x": across,
        "right_side": 1.0,
        "seconds": 11.0,  # the photograph's and its own, not the others'
    }
    assert items[0].facts["facing_deg"] == pytest.approx(30)
    facts = {k: v for k, v in items[0].facts.items() if k not in ("facing_deg", "evidence")}
    assert facts == {
        "light": "sun-hard",
        "note": "hard sun from viewer's right",
        "side": "right",
        "light_x": across,
        "landmark_error": 0.02,
        "seconds": {"landmarks": 1.0} | dict.fromkeys(real_faces.PHOTO_METHODS, 10.0),
        "verdicts": dict.fromkeys(real_faces.PHOTO_METHODS, SUMMARY),
        "chosen": "auto",
        "advice": ["step back"],
    }
    real_faces._read_index.cache_clear()


def test_goals_of_photographs(tmp_path: Path) -> None:
    (tmp_path / "index.json").write_text(json.dumps({"a.png": {}}))
    real_faces._read_index.cache_clear()
    evaluation = real_faces.RealFaces(data=tmp_path)
    for finite, right, met in ((1.0, 0.8, True), (0.99, 0.79, False)):
        row = {"finite": {"mean": finite}, "right_side": {"mean": right, "n": 7}}
        checks = evaluation.checks({real_faces.OURS: row}, [])
        assert list(checks) == [
            "probes without NaN or infinity",
            "light from the side that the note names, of 7 photographs",
        ]
        assert {check.ok for check in checks.values()} == {met}
    assert evaluation.checks({}, []) == {}
    real_faces._read_index.cache_clear()


def test_a_photograph_with_a_probe_is_scored_by_it(
    face_captures, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import shutil

    shutil.copytree(face_captures.folder, tmp_path / "faces")
    write_azimuths(tmp_path / "faces", TURNS_DEG)
    fit = SimpleNamespace(landmark_error=0.02)
    view = SimpleNamespace(observation=None, image=torch.zeros(4, 4, 3))
    lights = {"sh9": room((0, 0.5)), "sunsky": room((90, 0.5))}
    asked = []

    def estimate(self, observation, method):
        asked.append(method)
        return an_estimate(lights[method])

    monkeypatch.setattr(real_faces, "read_photo", lambda path, require_colour: require_colour)
    monkeypatch.setattr(
        real_faces, "observe_largest", lambda photo, name: (fit, view) if photo else None
    )
    monkeypatch.setattr(real_faces, "figure_columns", no_picture)
    monkeypatch.setattr(real_faces, "beside", no_picture)
    monkeypatch.setattr(EstimateOptions, "estimate", estimate)
    evaluation = real_faces.CapturedFaces(data=tmp_path / "faces", methods=("sh9", "sunsky"))
    capture = evaluation._captures()[PHOTO]
    truth = real_faces.true_light(tmp_path / "faces", capture)
    item = evaluation.measure(PHOTO, tmp_path / "out" / "p.png")
    assert asked == ["sh9", "sunsky"]
    assert item.name == PHOTO
    assert item.metrics == {
        name: real_faces.aligned_scores(light, truth, capture) for name, light in lights.items()
    }
    assert item.facts == {
        "person": capture.person,
        "visible_sun": capture.visible_sun,
        "azimuth_deg": capture.azimuth_deg,
        "landmark_error": 0.02,
    }
    assert len(evaluation.items()) == 2 == 2 * len(replace(evaluation, every=2).items())


def test_captures_are_to_be_told_best_by_the_autoencoder() -> None:
    metrics = ("si_rmse", "full_dw_mae", "sun_dw_mae")

    def rows(ours: float) -> dict:
        return {
            name: {metric: {"mean": value} for metric in metrics}
            for name, value in (("autoencoder", ours), ("sh9", 0.5), ("sh25", 0.6))
        }

    evaluation = real_faces.CapturedFaces.__new__(real_faces.CapturedFaces)
    checks = evaluation.checks(rows(0.4), [])
    assert len(checks) == 6
    assert all(check.ok for check in checks.values())
    missed = [name for name, check in evaluation.checks(rows(0.55), []).items() if not check.ok]
    assert missed == [f"autoencoder {metric} below sh9" for metric in metrics]
    one = {name: {"si_rmse": row["si_rmse"]} for name, row in rows(0.4).items() if name != "sh25"}
    assert list(evaluation.checks(one, [])) == ["autoencoder si_rmse below sh9"]


# times


def test_items_of_speed_are_photographs_and_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.full((4, 4, 3), 9, np.uint8))
    evaluation = speed.Speed(data=tmp_path, count=2)
    runs = ["1 worker", "2 workers", "2 workers, batches of 16 (autoencoder)"]
    assert evaluation.items() == ["0.png", "1.png", *runs]
    asked = []

    def command(self, workers, batch):
        asked.append((workers, batch))
        return {"photos_per_minute": 5.0}

    monkeypatch.setattr(speed.Speed, "_command", command)
    item = evaluation.measure(runs[2], tmp_path / "p.png")
    assert asked == [(2, 16)]
    assert item == Item(name=runs[2], metrics={runs[2]: {"photos_per_minute": 5.0}})
    times = {"landmarks": 1.0, "light": 2.0}
    estimated = []
    monkeypatch.setattr(
        speed, "estimate_photo",
        lambda path, model, device: estimated.append(path.name) or SimpleNamespace(seconds=times),
    )  # fmt: skip
    monkeypatch.setattr(speed, "write_results", lambda folder, result: None)
    speed._estimated_once.cache_clear()
    item = evaluation.measure("1.png", tmp_path / "p.png")
    assert estimated == ["0.png", "1.png"]  # what only the first one does is not counted
    assert list(item.metrics) == ["landmarks", "light", "report and files", "all"]
    assert item.metrics["light"] == {"seconds": 2.0}
    assert set(item.metrics["all"]) == {"seconds", "cpu_seconds", "peak_mib"}
    assert 0 <= item.metrics["all"]["seconds"] < 5
    assert item.metrics["all"]["peak_mib"] > 50
    speed._estimated_once.cache_clear()


def test_a_run_of_the_command_is_timed_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(2):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.full((4, 4, 3), 9, np.uint8))
    words = []

    def run(command, *, check, capture_output):
        assert check
        words.extend(command)
        assert sorted(path.name for path in Path(command[4]).iterdir()) == ["0.png", "1.png"]

    done = [SimpleNamespace(status="done", seconds=s) for s in (1.0, 3.0, 8.0)]
    entries = dict(enumerate([*done, SimpleNamespace(status="failed", seconds=99.0)]))
    used = iter([10.0, 18.0])
    monkeypatch.setattr(speed.subprocess, "run", run)
    monkeypatch.setattr(speed, "read_manifest", lambda path: entries)
    monkeypatch.setattr(speed, "_children_cpu_seconds", lambda: next(used))
    ticks = iter([100.0, 130.0])
    monkeypatch.setattr(speed.time, "perf_counter", lambda: next(ticks))
    found = speed.Speed(data=tmp_path)._command(2, 16)
    monkeypatch.undo()
    assert words[1:4] == ["-m", "skylight", "estimate"]
    options = dict(zip(words[5::2], words[6::2], strict=True))
    assert {k: v for k, v in options.items() if k != "--out"} == {
        "--workers": "2",
        "--batch": "16",
        "--light": "autoencoder",  # photographs are solved together for skies alone
        "--device": "auto",
    }
    assert found["photos_per_minute"] == 60 * 4 / 30
    assert found["seconds_of_a_photo"] == 3
    assert found["cpu_seconds"] == 2
    assert found["peak_mib"] >= 0
