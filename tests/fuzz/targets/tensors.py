"""Safetensors: priors, dictionaries of filters, states of training, films that were followed.

What begins like a description of tensors (:mod:`tests.fuzz.tensor_files`) has the right checksum.
"""

import numpy as np
import torch

from skylight.csc._dictionary import FilterBank
from skylight.estimation.film._follow import (
    FOLLOWED,
    Followed,
    Keyframe,
    Shot,
    read_followed,
    write_followed,
)
from skylight.faces._landmarks import DetectedFace
from skylight.imaging._camera_turns import Link
from skylight.io._tensors import read_tensors
from skylight.models._bundle import load_network
from skylight.models._prior import GaussianMixture
from skylight.training._checkpoint import NEWEST, read_state, write_state
from tests.fuzz.files import PLACE, read_by_any, written
from tests.fuzz.tensor_files import described, write_described

_FOLDER = PLACE / "tensors"
_IDENTITY = "a run"


def seeds() -> list[bytes]:
    _FOLDER.mkdir(exist_ok=True)
    bank = FilterBank(torch.eye(4, dtype=torch.float64), "four")
    mixture = GaussianMixture(torch.ones(1), torch.zeros(1, 2), torch.eye(2)[None])
    state = {"identity": _IDENTITY, "step": 3, "weights": [torch.ones(2)], "rng": {1: (2, 3)}}
    whole = [written("a.safetensors", bank.save), written("b.safetensors", mixture.save)]
    write_state(PLACE, state)
    write_followed(PLACE, _followed())
    names = ("a.safetensors", "b.safetensors", NEWEST, FOLLOWED)
    return [*whole, *(described(*read_tensors(PLACE / name)) for name in names)]


def read(content: bytes) -> None:
    _FOLDER.mkdir(exist_ok=True)
    path = _FOLDER / NEWEST
    write_described(path, content)
    path.with_name(FOLLOWED).unlink(missing_ok=True)
    path.with_name(FOLLOWED).hardlink_to(path)
    readers = (
        lambda: FilterBank.load(path),
        lambda: GaussianMixture.load(path),
        lambda: load_network(path),
        lambda: read_state(_FOLDER, _IDENTITY, lambda _: None),
        lambda: read_followed(_FOLDER),
    )
    read_by_any(readers)


def _followed() -> Followed:
    draw = np.random.default_rng(0)
    readings = draw.random((1, 478, 2))
    face = DetectedFace(points=draw.random((68, 2)), score=0.5, readings=readings)
    keyframe = Keyframe(
        number=0, time_s=0.0, face=face, picture=np.zeros((4, 4, 3), dtype=np.uint8)
    )
    link = Link(start=0, end=1, before=draw.random((3, 2)), after=draw.random((3, 2)))
    shot = Shot(first=0, begin_s=0.0, end_s=1.0, seen_s=1.0, keyframes=[keyframe], links=[link])
    return Followed(shot=shot, size=(4, 4), frames=2, end_s=1.0, notes=("cut short",))
