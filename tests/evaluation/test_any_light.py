"""Light of any kind: lamps of an estimate against the truth's, the grey light, maps and goals."""

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from skylight.errors import InputError
from skylight.evaluation import _any_light as any_light
from skylight.evaluation._any_light import (
    GREY,
    OURS,
    AnyLight,
    blurred,
    grey_light,
    lamp_scores,
    lamps_of,
    level_scores,
    main_lamp_coverage,
    share_of_maps_better,
)
from skylight.evaluation._known_faces import choice_facts, rendered_here
from skylight.evaluation._main import evaluate
from skylight.evaluation._pictures import strip
from skylight.evaluation._run import Item
from skylight.evaluation._tables import summarise
from skylight.faces._skin import SkinPrior
from skylight.inverse._posterior import SunPosterior
from skylight.inverse._result import Lamp
from skylight.inverse._scores import MapLamp, find_lamps
from skylight.people._maps import TurnedMap
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix
from skylight.transport._observation import Observation
from tests.evaluation.rendered import write_face

LAMP = TurnedMap(file="lamp.exr", category="indoor", turn_deg=30.0)


def direction(azimuth_deg: float, elevation_deg: float = 0.0) -> torch.Tensor:
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    vector = [math.cos(e) * math.sin(a), math.sin(e), -math.cos(e) * math.cos(a)]
    return torch.tensor(vector, dtype=torch.float64)


def room(*lamps: tuple[float, float], elevation_deg: float = 10.0) -> EnvironmentMap:
    """Lamps of 5 degrees at these azimuths with these shares of all light; the rest is even."""
    grid = DirectionGrid.latlong(256)
    rest = (1 - sum(share for _, share in lamps)) / (4 * math.pi)
    light = torch.full((len(grid.directions),), rest, dtype=torch.float64)
    for azimuth, share in lamps:
        disc = grid.directions @ direction(azimuth, elevation_deg) > math.cos(math.radians(5))
        light[disc] += share / grid.solid_angles[disc].sum()
    fine = EnvironmentMap(radiance=light.float().reshape(256, 512, 1).repeat(1, 1, 3))
    return fine.resize(64)


def estimate_of(light: EnvironmentMap) -> SimpleNamespace:
    return SimpleNamespace(
        light="autoencoder",
        environment=light,
        white_balance=torch.ones(3),
        lamps=(),
        log_evidence=-100.0,
        posterior=posterior_at(0),
        verdict=SimpleNamespace(summary="direction sure"),
        faces=(SimpleNamespace(residual=0.1),),
    )


def peaks(light: EnvironmentMap) -> list[MapLamp]:
    """The lamps of an estimate without any of its own."""
    return lamps_of("autoencoder", (), light)


def rendered_folder(out: Path, maps: list[TurnedMap | None], light: EnvironmentMap) -> Path:
    """One picture for each map, which says that it was lit by that."""
    face = replace(rendered_here(20_000_000, 64), environment=light, ground_albedo=None)
    for number, turned in enumerate(maps):
        write_face(out, number, face, turned)
    return out


def posterior_at(cell: int) -> SunPosterior:
    grid = DirectionGrid.sky(32)
    region = torch.zeros(len(grid.directions), dtype=torch.bool)
    region[cell] = True
    return SunPosterior(
        grid=grid,
        density=region.double() / grid.solid_angles[cell],
        region=region,
        parts=(),
        sun_gain=0.5,
        exposure_interval=(0.5, 2.0),
        albedo_scale_interval=(0.5, 2.0),
    )


def test_the_main_lamp_is_asked_for_where_it_holds_enough_of_the_light() -> None:
    truth = find_lamps(room((0, 0.5), (90, 0.25)))
    assert lamp_scores(peaks(room((12, 0.6))), truth)["main_lamp_deg"] == pytest.approx(
        11.8, abs=0.2
    )
    # the larger lamp of an estimate is the main one, however small it is
    faint = room((90, 0.02), (-40, 0.03))
    assert lamp_scores(peaks(faint), truth)["main_lamp_deg"] == pytest.approx(40, abs=1)
    assert lamp_scores(peaks(room()), truth)["main_lamp_deg"] == 90
    assert "main_lamp_deg" not in lamp_scores(peaks(room((0, 0.5))), find_lamps(room((0, 0.35))))


def test_lamps_with_a_fifth_of_the_light_are_to_be_found_near_where_they_are() -> None:
    truth = find_lamps(room((0, 0.3), (90, 0.25), (180, 0.1)))
    for estimate, found in (
        (room((0, 0.3), (90, 0.25)), 1.0),
        (room((15, 0.3), (150, 0.3)), 0.5),  # the one at 90 is 60 degrees off
        (room((25, 0.3), (180, 0.3)), 0.0),  # the one at 180 is too small to count
        (room((0, 0.03), (90, 0.03)), 0.0),  # and so are these, of an estimate
    ):
        assert lamp_scores(peaks(estimate), truth)["lamps_found"] == found
    assert lamp_scores(peaks(room()), find_lamps(room((0, 0.15)))) == {}


def test_lamps_that_an_estimate_lists_are_its_lamps() -> None:
    """Not the peaks of its map, of which its ambient light may have some."""
    lamps = tuple(
        Lamp(direction=direction(azimuth), irradiance=torch.full((3,), e), spread_rad=0.1)
        for azimuth, e in ((100, 2.0), (-60, 1.0))
    )
    light = room((0, 0.9))
    found = lamps_of("lamps", lamps, light)
    for one, lamp in zip(found, lamps, strict=True):
        assert torch.equal(one.direction, lamp.direction)
    # of light whose integral is 1; a lobe of 0.1 rad lights what faces it by 1 % less than a point
    assert [one.share for one in found] == pytest.approx([2.0 / 0.99, 1.0 / 0.99], rel=1e-3)
    # it says that there are none, whatever its map has
    assert lamps_of("lamps", (), light) == []


def test_coverage_is_asked_for_where_the_posterior_has_the_main_lamp() -> None:
    grid = DirectionGrid.sky(32)
    cell = 20 * 128 + 40
    above = [MapLamp(direction=grid.directions[cell], share=0.5)]
    assert main_lamp_coverage(posterior_at(cell), above)["in_region"] == 1
    assert main_lamp_coverage(posterior_at(cell + 5), above)["in_region"] == 0
    below = [MapLamp(direction=direction(10, -15), share=0.5)]
    assert main_lamp_coverage(posterior_at(cell), below) == {}
    small = [replace(above[0], share=0.3)]
    assert main_lamp_coverage(posterior_at(cell), small) == {}


def test_the_grey_light_explains_the_mean_of_the_prior_skin() -> None:
    """Skin of the prior's mean albedo under constant light of radiance 0.7, partly in shadow."""
    grid = DirectionGrid.latlong(8)
    generator = torch.Generator().manual_seed(0)
    matrix = torch.rand(5, len(grid), generator=generator)
    albedo = SkinPrior.load().mean.float()
    shading = matrix @ torch.full((len(grid), 3), 0.7)
    observation = Observation(
        pixels=albedo * shading,
        weights=torch.tensor([1.0, 0.5, 0.0, 2.0, 1.0]),
        places=torch.arange(10).reshape(5, 2),
        transport=TransportMatrix(matrix=matrix, grid=grid),
    )
    light = grey_light(observation)
    torch.testing.assert_close(light.radiance, torch.full((64, 128, 3), 0.7))
    red = replace(observation, pixels=observation.pixels * torch.tensor([2.0, 1.0, 0.5]))
    assert torch.equal(grey_light(red).radiance[..., 0], grey_light(red).radiance[..., 2])


def test_colour_and_level_are_those_of_a_map_that_is_brighter_and_redder() -> None:
    """e = log 2 + (a, 0, -a) of the whole map: the level is log 2, the colour a sqrt(2/3)."""
    truth = room((30, 0.4))
    a = 0.2
    factor = 2 * torch.exp(torch.tensor([a, 0.0, -a]))
    lit = EnvironmentMap(radiance=truth.radiance * factor)
    scores = level_scores(lit, truth)
    for part in ("whole", "lower"):
        assert scores[f"{part}_level"] == pytest.approx(math.log(2), rel=1e-4)
        assert scores[f"{part}_colour"] == pytest.approx(a * math.sqrt(2 / 3), rel=1e-4)
    bright = [EnvironmentMap(radiance=1e4 * each.radiance) for each in (lit, truth)]
    want = math.sqrt(math.log(2) ** 2 + a**2 * 2 / 3)  # far above what counts as dark
    assert level_scores(*bright)["log_radiance"] == pytest.approx(want, rel=1e-3)
    # half as bright or a larger map: as far off
    assert level_scores(truth, lit)["whole_level"] == pytest.approx(math.log(2), rel=1e-4)
    assert level_scores(truth.resize(128), truth) == pytest.approx(
        dict.fromkeys(scores, 0.0), abs=1e-5
    )


def test_the_lower_half_alone_counts_below() -> None:
    truth = room()
    dark = truth.radiance.clone()
    dark[32:] /= 4
    scores = level_scores(EnvironmentMap(radiance=dark), truth)
    assert scores["lower_level"] == pytest.approx(math.log(4), rel=1e-5)
    assert scores["whole_level"] == pytest.approx(math.log(8 / 5), rel=1e-5)
    dark[32:] = 0
    black = level_scores(EnvironmentMap(radiance=dark), truth)
    assert math.isfinite(black["lower_level"])
    assert black["lower_level"] > scores["lower_level"]


def test_the_blur_is_a_mean_that_knows_no_place() -> None:
    even = EnvironmentMap(radiance=torch.full((64, 128, 3), 0.3))
    torch.testing.assert_close(blurred(even), torch.full((64, 128, 3), 0.3).double())
    grid = DirectionGrid.latlong(64)
    for row, column in ((2, 5), (31, 127), (50, 64)):
        spot = torch.zeros(64, 128, 3)
        spot[row, column] = 1 / float(grid.solid_angles[row * 128 + column])
        seen = blurred(EnvironmentMap(radiance=spot))[..., 0].reshape(-1)
        assert float(seen @ grid.solid_angles) == pytest.approx(1, rel=0.02)
        at = grid.directions[row * 128 + column]
        distance = 1 - grid.directions @ at
        # exp(-(1 - cos a) / s^2) about the spot
        near = distance < 3 * math.radians(3) ** 2
        ratio = seen[near] / seen[row * 128 + column] / torch.exp(-distance[near] / 0.0523599**2)
        assert float((ratio - 1).abs().max()) < 0.05


@pytest.fixture
def estimated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every method finds the lamp 10 degrees aside; nobody has to be found in a tiny picture."""

    def lit(self, face, methods):
        turned = room((40, 0.5))
        estimate = estimate_of(turned)
        grid = DirectionGrid.latlong(8)
        observation = Observation(
            pixels=torch.full((3, 3), 0.2),
            weights=torch.ones(3),
            places=torch.arange(6).reshape(3, 2),
            transport=TransportMatrix(matrix=torch.full((3, len(grid)), 0.01), grid=grid),
        )
        estimates = dict.fromkeys(methods, estimate)
        score = any_light.face_score(turned, face)
        return SimpleNamespace(
            fit=face.truth,
            view=SimpleNamespace(observation=observation, blocks=torch.arange(3)),
            estimates=estimates,
            metrics={method: dict(score) for method in methods},
            facts=choice_facts(estimates),
        )

    monkeypatch.setattr(AnyLight, "lit", lit)
    # one column is enough of a picture
    monkeypatch.setattr(any_light, "strip", lambda truth, _: strip(truth, {}))


@pytest.mark.usefixtures("estimated")
def test_a_face_under_a_map_from_end_to_end(tmp_path: Path) -> None:
    bare = replace(LAMP, category=None)
    data = rendered_folder(tmp_path / "faces", [LAMP, bare], room((30, 0.5)))
    note = data / "face0001" / "face.json"
    behind = {"kind": "wall", "depth_m": 1.5, "blur_px": 4.0}
    note.write_text(json.dumps(json.loads(note.read_text()) | {"background": behind}))
    path = evaluate("any-light", quick=True, data=data, out=tmp_path / "out", workers=1)
    results = json.loads(path.read_text())
    assert results["problems"] == {}
    assert list(results["rows"]) == [OURS, "sh25", "autoencoder", "lamps", "auto", GREY]
    for method in (OURS, "sh25", "autoencoder", "lamps", "auto"):
        row = results["rows"][method]
        # azimuth at an elevation of 10 degrees
        assert row["main_lamp_deg"]["mean"] == pytest.approx(9.85, abs=0.2)
        assert row["lamps_found"]["mean"] == 1
        assert row["in_region"] == {"mean": 0, "median": 0, "std": 0, "n": 2}
        assert not any(name.startswith("sun_") for name in row)
    assert results["rows"][GREY]["main_lamp_deg"]["mean"] == 90
    assert results["rows"][GREY]["lamps_found"]["mean"] == 0
    facts = results["items"]["face0000"]
    assert facts["chosen"] == "autoencoder"
    assert (facts["map"], facts["turn_deg"], facts["category"]) == ("lamp.exr", 30, "indoor")
    assert facts["lamps"] == pytest.approx([0.5], abs=0.02)
    assert "category" not in results["items"]["face0001"]
    assert "background" not in facts  # of before there were any
    for method in (OURS, GREY):
        assert {*any_light.LEVELS} <= {*results["rows"][method]}
    assert {"category: indoor", "background: wall"} <= {*results["groups"]}
    assert (tmp_path / "out" / "pictures" / "face0001.png").is_file()


def test_faces_under_skies_are_refused(tmp_path: Path) -> None:
    data = rendered_folder(tmp_path / "faces", [LAMP, None], room())
    assert AnyLight(data=data, count=1).items() == ["face0000"]
    with pytest.raises(InputError, match="face0001: lit by a simulated sky"):
        AnyLight(data=data)
    (data / "face0000" / "face.json").write_text("[]")
    with pytest.raises(InputError, match="face0000: no facts of a rendered face"):
        AnyLight(data=data, count=1)


def item(number: int, file: str, **metrics: tuple[float, float]) -> Item:
    """(mae, others) of each method."""
    rows = {
        method: {"mae": mae, "rmse": other, "full_dw_mae": other, "si_rmse": other}
        for method, (mae, other) in metrics.items()
    }
    return Item(name=str(number), metrics=rows, facts={"map": file})


def test_methods_are_compared_by_the_mean_over_each_maps_faces() -> None:
    items = [
        item(0, "a", sphere=(1.0, 1.0), sh25=(2.0, 2.0), grey=(2.0, 2.0)),
        item(1, "a", sphere=(3.0, 1.0), sh25=(2.5, 2.0), grey=(2.5, 2.0)),  # better in the mean
        item(2, "b", sphere=(1.0, 1.0), sh25=(2.0, 2.0), grey=(0.5, 2.0)),  # grey is better
        item(3, "c", sphere=(1.0, 3.0), sh25=(2.0, 2.0), grey=(2.0, 4.0)),  # sh25 in all but mae
        Item(name="4", metrics={}, facts={"map": "d"}, problem="no face"),
    ]
    others = ["sh25", "grey"]
    assert share_of_maps_better(items, others, ("mae",)) == pytest.approx(2 / 3)
    assert share_of_maps_better(items, others, ("rmse",)) == pytest.approx(2 / 3)
    assert share_of_maps_better(items, others, ("mae", "rmse")) == pytest.approx(1 / 3)


def test_goals_are_those_of_the_default_light(tmp_path: Path) -> None:
    data = rendered_folder(tmp_path / "faces", [LAMP], room())
    evaluation = AnyLight(data=data)
    others = {"sh25": (2.0, 2.0), "autoencoder": (2.0, 2.0), "grey": (2.0, 2.0)}
    assert evaluation.checks(summarise([item(0, "a", **others)]), []) == {}
    for own, ok in ((1.0, True), (2.5, False)):
        items = [item(i, "a", sphere=(own, own), **others) for i in range(3)]
        for one, (angle, part) in zip(items, ((5.0, 1.0), (6.0, 1.0), (90.0, 0.2)), strict=True):
            worse = 1 if ok else 3
            extra = {"main_lamp_deg": angle * worse, "lamps_found": part / worse}
            extra |= dict.fromkeys(any_light.LEVELS, 0.05 if ok else 0.7)
            one.metrics[OURS].update(extra)
            one.facts["chosen"] = "lamps" if ok else "autoencoder"
        checks = evaluation.checks(summarise(items), items)
        assert len(checks) == 2 + 2 + 4 + 1 + 5
        assert {check.ok for check in checks.values()} == {ok}
    for share, met in ((1.0, False), (0.9, True), (0.8, False)):
        rows = summarise(items)
        rows[OURS]["in_region"] = {"mean": share}
        name = "main lamp in the 90 % region"
        assert evaluation.checks(rows, items)[name].ok is met
