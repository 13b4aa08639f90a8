# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel says, and with which of Blender's icons."""

# by how skylight's verdict begins
VERDICTS = {
    "direction sure": ("CHECKMARK", "The light comes from where it is set up."),
    "direction rough": ("QUESTION", "The light comes from about there: compare with the photo."),
    "direction unknown": ("LIGHT_HEMI", "The face does not tell where the light comes from."),
    "unreliable": ("ERROR", "Do not trust this light: it does not explain the face."),
}
UNKNOWN = "QUESTION", ""


def of_verdict(verdict: str) -> tuple[str, str]:
    """(icon, sentence) of a verdict such as "direction sure, brightness rough, colour rough"."""
    return next((told for begin, told in VERDICTS.items() if verdict.startswith(begin)), UNKNOWN)
