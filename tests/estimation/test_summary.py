"""The lines for the terminal: what light it is, and where its lamps are."""

from dataclasses import replace

import pytest
import torch

from skylight.estimation._summary import PhotoEstimate, summary
from skylight.imaging._capture_metadata import CaptureMetadata
from skylight.inverse._auto import choose
from skylight.inverse._result import Lamp
from tests.inverse.test_lamps import ONE, found_in


@pytest.fixture(scope="module")
def found():
    return found_in((ONE, 3.0))


def lines(estimate):
    told = PhotoEstimate(estimate=estimate, photos=(), names=(), seen=(), taken=CaptureMetadata())
    return [(line[:12].strip(), line[12:]) for line in summary(told).split("\n")]


def of(name, told):
    return [text for label, text in told if label == name]


def test_one_lamp_is_a_lamp(found):
    told = lines(found)
    assert not of("sun", told)
    assert not of("model", told)
    # (0.7, 0.4, 0.6) is to the right of the face and on the camera's side, behind the picture
    assert of("main light", told)[0].startswith("azimuth +131°, zenith 67°")
    (lamp,) = of("lamp", told)
    assert lamp.startswith("90 % sure within a circle of")


def test_the_likeliest_kind_of_place_is_told_without_a_share(found):
    assert not of("place", lines(found))
    told = lines(replace(found, kinds={"home": 0.9, "outdoors": 0.1}))
    assert of("place", told) == ["home (the likeliest kind)"]


def test_every_lamp_is_named(found):
    second = Lamp(
        direction=torch.tensor([-1.0, 0.0, 0.0], dtype=torch.float64),
        irradiance=0.1 * torch.ones(3),
        spread_rad=0.1,
    )
    told = lines(replace(found, lamps=(*found.lamps, second)))
    main, other = of("lamp", told)
    assert main.startswith("90 % sure within")
    assert other.startswith("another at azimuth -90°, zenith 90°")


def test_light_without_lamps_has_none(found):
    told = lines(replace(found, lamps=(), posterior=replace(found.posterior, is_seen=False)))
    (lamp,) = of("lamp", told)
    assert lamp == "none for certain: the face is lit evenly, or it is hidden behind the head"
    assert of("direction", told)[0].startswith("unknown: the face is lit too evenly to tell")
    assert of("light", told)[0].startswith("light from the front right")
    assert of("most light", told)


def test_three_words_or_why_there_are_none(found):
    told = lines(found)
    assert [label for label, _ in told[:4]] == ["light", "direction", "brightness", "colour"]
    assert of("light", told)[0].endswith("light from the front right")
    assert of("direction", told)[0].startswith("sure: within ")
    told = lines(replace(found, doubt="hardly a face"))
    assert of("verdict", told) == ["unreliable: hardly a face"]
    assert not {"direction", "brightness", "colour"} & {label for label, _ in told}


def test_the_model_that_was_chosen_is_named(found):
    sky = replace(found, light="autoencoder", lamps=(), log_evidence=found.log_evidence - 1000)
    assert of("model", lines(choose([sky, found]))) == ["lamps (100 % sure)"]
