"""Exposure settings of a camera, and the luminance that its pixels stand for."""

import math
from dataclasses import dataclass

# ISO 2720:1974 allows 10.6 to 13.4 for light meters of reflected light; cameras have 12.5
CALIBRATION = 12.5
MID_GREY = 0.18  # linear, sRGB's code 118: where ISO 12232 places the metered luminance
UNCERTAINTY_STOPS = 1.0


@dataclass(frozen=True, kw_only=True)
class CameraExposure:
    """Exposure time in ``seconds``, f-number ``aperture``, and sensitivity ``iso``."""

    seconds: float
    aperture: float
    iso: float

    @property
    def value(self) -> float:
        """The exposure value at ISO 100, ``log2(N^2 / t) - log2(S / 100)``."""
        return 2 * math.log2(self.aperture) - math.log2(self.seconds) - math.log2(self.iso / 100)

    @property
    def cd_per_m2(self) -> float:
        """Luminance, in cd/m^2, of what a linear pixel value of 1 shows::

            L(p) = p / 0.18 K N^2 / (t S),   K = 12.5

        (ISO 2720: a scene of luminance ``K N^2 / (t S)`` is exposed well; ISO 12232, standard
        output sensitivity: it is then given sRGB's code 118, 0.18 of the largest value.) Good to
        :data:`UNCERTAINTY_STOPS`: makers choose K, and how bright mid-grey is rendered; tone curves
        are no sRGB; lenses absorb a tenth to a half, the more off the middle. A picture that was
        brightened later, by a program that kept the camera's data, is off by that.
        """
        return CALIBRATION * self.aperture**2 / (self.seconds * self.iso) / MID_GREY

    def described(self) -> dict[str, float]:
        """As estimate.json has it."""
        return {
            "cd_per_m2": self.cd_per_m2,
            "uncertainty_stops": UNCERTAINTY_STOPS,
            "exposure_time_s": self.seconds,
            "f_number": self.aperture,
            "iso": self.iso,
        }

    def attributes(self) -> dict[str, object]:
        """OpenEXR's standard attributes of a map in the picture's units.

        ``whiteLuminance`` is "the luminance, in Nits, of the RGB value (1.0, 1.0, 1.0)".
        """
        return {
            "whiteLuminance": self.cd_per_m2,
            "expTime": self.seconds,
            "aperture": self.aperture,
            "isoSpeed": self.iso,
        }
