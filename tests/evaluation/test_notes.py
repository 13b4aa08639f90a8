"""Sides of the light in notes, as people write them."""

import pytest

from skylight.evaluation._real_faces import side_of_light


@pytest.mark.parametrize(
    ("note", "side"),
    [
        ("hard sun from viewer's left and above, right half nearly black", "left"),
        ("direct light from front/upper left, deep shadow under brow and at right", "left"),
        ("outdoor, soft light from viewer's right; 3/4 view", "right"),
        ("soft key from front, slightly viewer's right", "right"),
        ("window light front/left plus back rim", "left"),
        ("direct light from the front and above; both cheeks lit, left one brighter", "left"),
        ("soft directional light, right cheek and neck darker", "left"),
        ("hard low sun: lit left jaw and neck, hair glow", "left"),
        ("bright light from viewer's right, bluish fill at left", "right"),
        # none, both, or from behind
        ("soft frontal light; cap, right edge partly occluded", None),
        ("hair over left", None),
        ("key from viewer's left plus rim from the right", None),
        ("soft light with two sides: left cheek brighter", None),
        ("sun behind viewer's right on the hair", None),
        ("", None),
    ],
)
def test_side_of_light(note, side):
    assert side_of_light(note) == side


def test_a_mirrored_note_names_the_other_side():
    note = "sun from viewer's left: lit left cheek, right side darker"
    swapped = note.replace("left", "LEFT").replace("right", "left").replace("LEFT", "right")
    assert (side_of_light(note), side_of_light(swapped)) == ("left", "right")
