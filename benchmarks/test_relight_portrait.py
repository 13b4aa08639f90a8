"""Seconds of a relit portrait of one megapixel beside its estimate: the person, then each light."""

import cv2
import numpy as np
import pytest
import torch

from skylight.estimation._kept import KeptFace
from skylight.estimation._photos import estimate_photo
from skylight.imaging._colour import srgb_to_linear
from skylight.imaging._photo import Photo
from skylight.portrait import key_light, relit_portrait
from skylight.portrait._files import shown, taken_apart

SIDE = 1024


@pytest.fixture(scope="module")
def face() -> KeptFace:
    data = pytest.importorskip("skimage.data")
    encoded = cv2.resize(data.astronaut(), (SIDE, SIDE), interpolation=cv2.INTER_CUBIC)
    photo = Photo(
        pixels=srgb_to_linear(torch.from_numpy(np.ascontiguousarray(encoded)).float() / 255),
        clipped=torch.from_numpy((encoded == 255).any(2)),
        encoded=encoded,
        focal_px=None,
    )
    return KeptFace.of(estimate_photo(photo))


def test_person(benchmark, face):
    """The person in the photograph: hair, matte, shadow rays, and the light found on them."""
    benchmark.pedantic(taken_apart, (face,), {"workers": 1}, rounds=3, warmup_rounds=1)


def test_light(benchmark, face):
    """One key light more, to the picture's codes."""
    portrait, light = taken_apart(face), key_light(face, "left")
    benchmark.pedantic(
        lambda: shown(relit_portrait(face, light, portrait=portrait)), rounds=5, warmup_rounds=1
    )
