"""The place of a photograph, for who knows it: it chooses the light model, and nothing else."""

import pytest

from skylight._names import DEFAULT_LIGHT, check_detail_name, light_at
from skylight._options import kind_of_place
from skylight.errors import InputError
from skylight.estimation._settings import EstimateSettings
from skylight.inverse._estimate import light_problems
from skylight.inverse._lamps import LampsProblem
from skylight.models._ground import KnownGround
from skylight.models._lamps import LampsLight


@pytest.mark.parametrize("light", ["auto", DEFAULT_LIGHT])
def test_a_place_chooses_the_model(light):
    assert light_at(light, "auto") == light
    assert light_at(light, "outdoors") == "autoencoder"
    assert light_at(light, "indoors") == light_at(light, "flash") == "lamps"


def test_a_model_that_was_chosen_stays_or_is_refused():
    assert light_at("sunsky", "outdoors") == "sunsky"
    assert light_at("sh9", "indoors") == "sh9"
    with pytest.raises(InputError, match="lamps is no light for the place outdoors"):
        light_at("lamps", "outdoors")
    with pytest.raises(InputError, match="unknown place 'garden': choose one of auto, outdoors"):
        light_at("auto", "garden")
    with pytest.raises(InputError, match="a place chooses a light model"):
        light_problems(LampsLight(1), place="indoors", device="cpu")


def test_a_flash_is_looked_for_at_the_camera():
    (flash,) = light_problems("auto", place="flash", device="cpu")
    (room,) = light_problems("auto", place="indoors", device="cpu")
    assert isinstance(flash, LampsProblem)
    assert isinstance(room, LampsProblem)
    assert flash.towards is not None
    assert flash.towards.tolist() == [[0.0, 0.0, 1.0]]
    assert room.towards is None


def test_settings_of_a_place():
    there = EstimateSettings(place="indoors", device="cpu")
    assert there.light_there == "lamps"
    assert there.facts()["place"] == "indoors"
    assert "place" not in EstimateSettings(device="cpu").facts()
    with pytest.raises(InputError, match="lamps has none"):
        EstimateSettings(place="flash", ground=KnownGround(albedo=(0.2, 0.2, 0.2)), device="cpu")
    with pytest.raises(InputError, match="unknown detail 'all': choose none, photo, mirrored"):
        check_detail_name("all")


def test_the_option_takes_a_kind_and_a_position():
    assert kind_of_place(None) == ("auto", None)
    assert kind_of_place("indoors") == ("indoors", None)
    assert kind_of_place("41.89,12.49") == ("auto", "41.89,12.49")
    assert kind_of_place("outdoors,-41.89,12.49") == ("outdoors", "-41.89,12.49")
