"""The albedo of the ground, where it was measured or is known."""

import math
from dataclasses import dataclass
from pathlib import Path

from skylight.errors import InputError
from skylight.io.json_files import read_number, read_object, require_keys, write_json
from skylight.models.names import SKY_LIGHTS, LightName

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

    def option(self) -> str:
        """As ``--ground-albedo`` takes it."""
        return ",".join(f"{value:.3g}" for value in (*self.albedo, self.spread))

    def save(self, path: Path, facts: dict[str, object]) -> None:
        """Write it as JSON, with ``facts`` of how it was measured."""
        albedo = dict(zip(_CHANNELS, self.albedo, strict=True))
        write_json(path, {"kind": _KIND, **albedo, "spread": self.spread, **facts})

    @staticmethod
    def told(text: str) -> "KnownGround":
        """From "R,G,B" or "R,G,B,SPREAD", or the name of a file that :meth:`save` wrote.

        Raises
        ------
        InputError
            It is neither, or no albedo.
        """
        if text.lower().endswith(".json"):
            return load_ground(Path(text))
        try:
            numbers = [float(part) for part in text.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) not in (3, 4):
            raise InputError(
                f"--ground-albedo {text!r}: give R,G,B or R,G,B,SPREAD, such as 0.2,0.17,0.14,0.1, "
                "or a file (.json) of `skylight probe ground`"
            )
        red, green, blue, *spread = numbers
        return KnownGround(albedo=(red, green, blue), spread=(spread or [USUAL_SPREAD])[0])


def check_has_ground(light: LightName, ground: KnownGround | None) -> None:
    """:class:`InputError` for a ground and a light without one."""
    if ground is not None and light not in SKY_LIGHTS:
        raise InputError(
            f"--ground-albedo is for skies over a ground, and {light} has none: leave it out, or "
            "choose --light autoencoder or sunsky"
        )


def load_ground(path: Path) -> KnownGround:
    """The ground that :meth:`KnownGround.save` wrote.

    Raises
    ------
    InputError
        The file is missing or no such file, or its values cannot be.
    """
    content = read_object(path, _KIND)
    require_keys(path, content, [*_CHANNELS, "spread"])
    try:
        red, green, blue, spread = (read_number(content, name) for name in (*_CHANNELS, "spread"))
        return KnownGround(albedo=(red, green, blue), spread=spread)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
