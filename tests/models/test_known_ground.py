"""Grounds that are known: read, written, refused, and what prior they make."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.models._ground import KnownGround, check_has_ground, ground_prior


def test_the_prior_is_log_normal() -> None:
    """The closed form of the density of three independent normals."""
    known = KnownGround(albedo=(0.3, 0.2, 0.1), spread=0.2)
    at = torch.tensor([[0.35, 0.2, 0.08]]).log()
    z = (at[0].numpy() - np.log([0.3, 0.2, 0.1])) / 0.2
    expected = -0.5 * (z**2).sum() - 3 * math.log(0.2 * math.sqrt(2 * math.pi))
    assert float(ground_prior(known).log_prob(at)) == pytest.approx(expected, rel=1e-5)


def test_options_and_files(tmp_path: Path) -> None:
    assert KnownGround.told("0.2,0.17,0.14") == KnownGround(albedo=(0.2, 0.17, 0.14), spread=0.1)
    known = KnownGround(albedo=(0.2, 0.17, 0.14), spread=0.3)
    assert KnownGround.told("0.200,0.170,0.140,0.300") == known
    (tmp_path / "ground.json").write_text(
        '{"kind": "ground albedo", "red": 0.2, "green": 0.17, "blue": 0.14, "spread": 0.3, '
        '"greys": 6}'
    )
    assert KnownGround.told(str(tmp_path / "ground.json")) == known


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0.2", "give R,G,B"),
        ("a,b,c", "give R,G,B"),
        ("0.2,0.2,0.2,0.1,1", "give R,G,B"),
        ("0.2,0,0.1", "above 0 and below 1"),
        ("0.2,1.5,0.1", "above 0 and below 1"),
        ("0.2,nan,0.1", "above 0 and below 1"),
        ("0.2,0.2,0.2,0", "0.01 to 2"),
        ("0.2,0.2,0.2,inf", "0.01 to 2"),
        ("none.json", "none.json"),
    ],
)
def test_refusals(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        KnownGround.told(text)


def test_a_file_of_something_else(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text('{"kind": "ground albedo", "red": 2, "green": 0.1, "blue": 0.1, "spread": 0.1}')
    with pytest.raises(InputError, match=r"a\.json: a ground's albedo is above 0"):
        KnownGround.told(str(path))


def test_lights_without_a_ground_refuse_it() -> None:
    known = KnownGround(albedo=(0.2, 0.2, 0.2))
    check_has_ground("auto", known)
    check_has_ground("sh9", None)
    with pytest.raises(InputError, match="is for skies over a ground, and lamps has none"):
        check_has_ground("lamps", known)
