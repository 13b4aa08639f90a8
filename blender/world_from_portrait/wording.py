# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel says, and with which of Blender's icons."""

# by the first word of skylight's verdict
VERDICTS = {
    "reliable": ("CHECKMARK", "The light can be trusted."),
    "ambiguous": ("QUESTION", "The main light may stand elsewhere: see report.png."),
    "overcast": ("LIGHT_HEMI", "The face shows no sun; its direction is a guess."),
    "even": ("LIGHT_HEMI", "The face shows no lamp; the light is soft."),
    "doubtful": ("QUESTION", "What was seen contradicts itself: compare with the photo."),
    "unreliable": ("ERROR", "Do not trust this light: it does not explain the face."),
}
UNKNOWN = "QUESTION", ""


def of_verdict(verdict: str) -> tuple[str, str]:
    """(icon, sentence) of a verdict such as "ambiguous: wide region"."""
    return VERDICTS.get(verdict.partition(":")[0], UNKNOWN)
