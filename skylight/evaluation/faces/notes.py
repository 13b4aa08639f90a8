"""The side of the light, from the notes on a photograph.

Sides are the viewer's: "right" is +X of the camera's frame.
"""

import re
from typing import Literal

Side = Literal["left", "right"]
_OTHER: dict[str, Side] = {"left": "right", "right": "left"}
_SIDE = "(left|right)"
# "from viewer's left", "from front/upper left", "light front/left", "slightly viewer's right"
_TOWARDS = re.compile(
    rf"\b(?:from|slightly|light)\s+(?:the\s+)?(?:viewer's\s+)?(?:\w+/)?(?:upper\s+)?{_SIDE}\b"
)
# "lit left cheek", "right cheek brighter", "both cheeks lit, left one brighter"
_LIT = re.compile(rf"\blit {_SIDE}\b|\b{_SIDE} (?:cheek|one|side) (?:brighter|lighter)\b")
# "right side darker", "right cheek and neck darker", "right half nearly black"
_DARK = re.compile(
    rf"\b{_SIDE} (?:cheek|side|half)(?: and neck)? (?:nearly )?(?:darker|dark|black)\b"
)


def side_of_light(note: str) -> Side | None:
    """The side named by a note; None where it names none, both, or light from behind.

    Light from behind is left out: it reaches the face round its edge, or not at all.
    """
    text = note.lower()
    if re.search(r"\bbehind\b|\btwo sides\b", text):
        return None
    sides: set[str] = {m.group(1) for m in _TOWARDS.finditer(text)}
    sides |= {m.group(1) or m.group(2) for m in _LIT.finditer(text)}
    sides |= {_OTHER[m.group(1)] for m in _DARK.finditer(text)}
    return sides.pop() if len(sides) == 1 else None  # type: ignore[return-value]
