"""Which light model is looked for: the default, what a place says, and what only skies have."""

import pytest

from skylight._names import (
    DEFAULT_LIGHT,
    DEFAULT_SKY,
    LIGHT_NAMES,
    PLACES,
    SKY_LIGHTS,
    check_detail_name,
    light_at,
)
from skylight._options import kind_of_place
from skylight.errors import InputError
from skylight.estimation._settings import EstimateSettings
from skylight.estimation.film._estimate import FilmSettings
from skylight.inverse._estimate import light_problems, light_there
from skylight.inverse._lamps import LampsProblem
from skylight.inverse._sky import SkyProblem, SolverOptions
from skylight.models._bundle import SHIPPED
from skylight.models._ground import KnownGround
from skylight.models._lamps import LampsLight
from tests.inverse.test_sun_prior import about

GROUND = KnownGround(albedo=(0.2, 0.2, 0.2))


@pytest.mark.parametrize("place", PLACES)
def test_the_default_is_for_every_place(place):
    assert light_at(DEFAULT_LIGHT, place) == DEFAULT_LIGHT
    assert light_at("auto", place) == ("auto" if place == "auto" else DEFAULT_LIGHT)


def test_a_model_that_was_chosen_stays_or_is_refused():
    assert light_at("sunsky", "outdoors") == "sunsky"
    assert light_at("sh9", "indoors") == "sh9"
    with pytest.raises(InputError, match="lamps is no light for the place outdoors"):
        light_at("lamps", "outdoors")
    with pytest.raises(InputError, match="unknown place 'garden': choose one of auto, outdoors"):
        light_at("auto", "garden")
    with pytest.raises(InputError, match="a place chooses a light model"):
        light_problems(LampsLight(1), place="indoors", device="cpu")


@pytest.mark.parametrize("light", LIGHT_NAMES)
def test_only_the_default_gives_way_to_a_sky(light, caplog):
    gives_way = light == DEFAULT_LIGHT
    assert light_at(light, "auto", "a moon") == (DEFAULT_SKY if gives_way else light)
    lines = [one.getMessage() for one in caplog.records]
    assert len(lines) == gives_way
    assert all("a moon: only skies have that, so the light is autoencoder" in one for one in lines)
    if light in SKY_LIGHTS[:2]:
        assert light_at(light, "outdoors", "a moon") == light


def test_where_there_is_no_sky_nothing_gives_way(caplog):
    assert light_at(DEFAULT_LIGHT, "indoors", "a moon") == DEFAULT_LIGHT
    assert light_at("auto", "outdoors", "a moon") == DEFAULT_SKY
    assert len(caplog.records) == 1


def test_what_is_asked_of_skies_makes_the_light_one():
    """Each of what only skies have, at both doors; the settings tell the light that is taken."""
    for asked in ({"model": SHIPPED}, {"solver": "thesis"}):
        settings = EstimateSettings(device="cpu", **asked)
        assert settings.light == settings.facts()["light"] == DEFAULT_SKY
        assert EstimateSettings(place="outdoors", device="cpu", **asked).light == DEFAULT_SKY
    assert FilmSettings().estimate.light == DEFAULT_LIGHT
    assert FilmSettings(estimate=EstimateSettings(light="sunsky")).estimate.light == "sunsky"
    assert light_there(DEFAULT_LIGHT, "auto", model=SHIPPED) == DEFAULT_SKY
    (problem,) = light_problems(DEFAULT_LIGHT, model=SHIPPED, device="cpu")
    assert isinstance(problem, SkyProblem)
    with pytest.raises(InputError, match="lamps has no trained model: leave --model out"):
        EstimateSettings(light="lamps", model=SHIPPED, device="cpu")
    with pytest.raises(InputError, match="holds skies, for --light autoencoder"):
        EstimateSettings(place="indoors", model=SHIPPED, device="cpu")


def test_the_default_takes_the_ground_and_the_clock():
    assert EstimateSettings(ground=GROUND, device="cpu").light == DEFAULT_LIGHT
    (problem,) = light_problems(
        DEFAULT_LIGHT,
        options=SolverOptions(ground=GROUND),
        sun_priors=[about(0.0, 40.0)],
        device="cpu",
    )
    assert isinstance(problem, LampsProblem)
    assert problem.ground == GROUND
    assert problem.faces.sun_prior is not None


@pytest.mark.parametrize("light", ["lamps", "auto"])
def test_a_flash_is_looked_for_at_the_camera(light):
    (flash,) = light_problems(light, place="flash", device="cpu")
    (room,) = light_problems(light, place="indoors", device="cpu")
    assert isinstance(flash, LampsProblem)
    assert isinstance(room, LampsProblem)
    assert flash.towards is not None
    assert flash.towards.tolist() == [[0.0, 0.0, 1.0]]
    assert room.towards is None


def test_settings_of_a_place():
    there = EstimateSettings(light="auto", place="indoors", device="cpu")
    assert there.light == DEFAULT_LIGHT
    assert there.facts()["place"] == "indoors"
    assert "place" not in EstimateSettings(device="cpu").facts()
    with pytest.raises(InputError, match="lamps has none"):
        EstimateSettings(light="lamps", ground=GROUND, device="cpu")
    with pytest.raises(InputError, match="unknown detail 'all': choose none, photo, mirrored"):
        check_detail_name("all")


def test_the_option_takes_a_kind_and_a_position():
    assert kind_of_place(None) == ("auto", None)
    assert kind_of_place("indoors") == ("indoors", None)
    assert kind_of_place("41.89,12.49") == ("auto", "41.89,12.49")
    assert kind_of_place("outdoors,-41.89,12.49") == ("outdoors", "-41.89,12.49")
