"""What the page says in words: as the package says it, and no more than is known."""

from typing import Any

import pytest
import torch

from skylight.inverse._verdict import place
from skylight.sphere._frame import direction_from_angles
from tests.studio.composite.composite_modules import called
from tests.studio.conftest import STAGES


def test_light_comes_from_where_the_verdict_says() -> None:
    angles = [(azimuth, zenith) for azimuth in range(-178, 180, 7) for zenith in range(1, 180, 7)]
    told = called("frame", *(("whereFrom", *pair) for pair in angles), folder="shared/")
    for (azimuth, zenith), words in zip(angles, told, strict=True):
        towards = direction_from_angles(
            *torch.tensor([azimuth, zenith], dtype=torch.float64).deg2rad()
        )
        assert words == place(towards), (azimuth, zenith)


def left(*times: tuple[str, float, float]) -> list[Any]:
    return called("time_left", *(("secondsLeft", *one) for one in times), folder="shared/")


def test_time_left_is_the_pace_so_far() -> None:
    """A machine that takes k times as long has k times as much before it."""
    states = [(stage, share) for stage in STAGES for share in (0.0, 0.5)]
    usual, slow = (
        left(*((stage, share, seconds) for stage, share in states)) for seconds in (3.0, 12.0)
    )
    known = [(one, four) for one, four in zip(usual, slow, strict=True) if one is not None]
    assert usual[:2] == [None, None]  # too early to say
    assert len(known) >= 5
    for one, four in known:
        assert four == pytest.approx(4 * one)
    assert [one for one, _ in known] == sorted((one for one, _ in known), reverse=True)
    assert left(("writing the results", 1.0, 10.0)) == [pytest.approx(0, abs=1e-9)]
    assert left(("printing", 0.5, 10.0)) == [None]


def test_time_left_is_told_no_finer_than_it_is_known() -> None:
    seconds = [0, 2.9, 7.2, 19.6, 33.0, 61.0, 200.0, None]
    told = called("time_left", *(("leftInWords", one) for one in seconds), folder="shared/")
    assert told == [
        "nearly done",
        "nearly done",
        "about 7 s left",
        "about 20 s left",
        "about 35 s left",
        "about 60 s left",
        "about 4 min left",
        "",
    ]
