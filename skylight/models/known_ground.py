"""The albedo of the ground, where it was measured or is known."""

import math
from dataclasses import dataclass
from pathlib import Path

from skylight.errors import InputError
from skylight.io.json_files import read_number, read_object, require_keys
from skylight.models.names import LightName

USUAL_SPREAD = 0.1
_KIND = "ground albedo"
_CHANNELS = ("red", "green", "blue")


@dataclass(frozen=True, kw_only=True)
class KnownGround:
    """Linear Rec.709 ``albedo`` of the ground, and the ``spread`` of its log.

    ``spread`` is the standard deviation in each channel: by how much, relatively, the ground
    round a face may differ from what was measured.
    """

    albedo: tuple[float, float, float]
    spread: float = USUAL_SPREAD

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) and 0 < value < 1 for value in self.albedo):
            told = ", ".join(f"{value:g}" for value in self.albedo)
            raise InputError(f"a ground's albedo is above 0 and below 1 in each colour: {told}")
        if not (math.isfinite(self.spread) and 0.01 <= self.spread <= 2):
            raise InputError(
                f"the spread of a ground's albedo is relative, 0.01 to 2, not {self.spread:g}"
            )

    @staticmethod
    def told(text: str) -> "KnownGround":
        """From "R,G,B" or "R,G,B,SPREAD", or the name of a JSON file with these by name.

        Such a file has the keys kind ("ground albedo"), red, green, blue and spread.

        Raises
        ------
        InputError
            It is neither, or no albedo.
        """
        if text.lower().endswith(".json"):
            return _load(Path(text))
        try:
            numbers = [float(part) for part in text.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) not in (3, 4):
            raise InputError(
                f"--ground-albedo {text!r}: give R,G,B or R,G,B,SPREAD, such as 0.2,0.17,0.14,0.1, "
                'or a .json file of kind "ground albedo" with red, green, blue and spread'
            )
        red, green, blue, *spread = numbers
        return KnownGround(albedo=(red, green, blue), spread=(spread or [USUAL_SPREAD])[0])


def check_has_ground(light: LightName, ground: KnownGround | None) -> None:
    """:class:`InputError` for a ground and a light without one."""
    if ground is not None and light not in ("auto", "autoencoder", "sunsky"):
        raise InputError(
            f"--ground-albedo is for skies over a ground, and {light} has none: leave it out, or "
            "choose --light autoencoder or sunsky"
        )


def _load(path: Path) -> KnownGround:
    content = read_object(path, _KIND)
    require_keys(path, content, [*_CHANNELS, "spread"])
    try:
        red, green, blue, spread = (read_number(content, name) for name in (*_CHANNELS, "spread"))
        return KnownGround(albedo=(red, green, blue), spread=spread)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
