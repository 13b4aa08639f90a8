"""``skylight relight-portrait``: a photographed person in another light."""

import math
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from skylight._names import DEFAULT_LIGHT, PLAIN_READING, LightName, MapReading, Place
from skylight._options import take_care
from skylight.errors import InputError
from skylight.io._atomic import require_place
from skylight.work._device import Device
from skylight.work._progress import stage_bar

Decoding = tyro.conf.create_mutex_group(required=False)
NewLight = tyro.conf.create_mutex_group(required=True)


def relight_portrait(
    photo: Positional[Path],
    under: Annotated[Path | None, NewLight] = None,
    turn: Annotated[float | None, NewLight] = None,
    sun: Annotated[str | None, NewLight] = None,
    strength: float | None = None,
    ev: float = 0.0,
    light: LightName = DEFAULT_LIGHT,
    model: Path | None = None,
    network: str | None = None,
    place: Place = "auto",
    face: int = 1,
    device: Device = "auto",
    out: Path | None = None,
    gamma: Annotated[float | None, Decoding] = None,
    linear: Annotated[bool, Decoding] = False,
    reading: Annotated[MapReading, tyro.conf.OmitArgPrefixes] = PLAIN_READING,
) -> None:
    """Show a photographed person in another light: a map's, or the one found, turned or moved.

    The light of the photograph is estimated as `skylight estimate` does; then skin
    gets the new light's shading, shadows and specular reflection in place of the old one's, hair
    and clothes their ratio, and what lies behind the ratio of the lights on upright surfaces.
    docs/portraits.md tells where that ends. A picture whose light could not be relied on says so
    below itself.

    Args:
        photo: Picture of a face: JPEG, PNG, TIFF, HEIC, EXR, Radiance HDR or RAW.
        under: Lat-long map of the new light (.exr, .hdr), whose centre is where the camera looks.
            Its units do not matter: the face stays as bright as it was.
        turn: Turn the light that was found about the vertical by so many degrees; positive ones
            move what is ahead to the right.
        sun: Move its sun, or its main lamp, to AZ,EL: degrees from where the camera looks towards
            its right, and above the horizon. Negative ones: --sun=-60,30.
        strength: Of --sun: its irradiance as a multiple of a horizontal surface's by all other
            light; by default what was found.
        ev: Exposure of the result in stops more.
        light: Light model of the estimate, as for `skylight estimate`.
        model: Folder of a trained model of your own, as for `skylight estimate`.
        network: Class of that model's network, where it is yours, as module:Class.
        place: Where the photograph was taken, as for `skylight estimate`.
        face: Whose: faces are counted from 1, the largest.
        device: Where light is traced and optimised.
        out: The picture: .png (8-bit sRGB) or .exr (linear, in the photograph's units); by default
            PHOTO's name with _relit.png, in the current folder.
        gamma: The picture's values are light to the power of 1/GAMMA, instead of sRGB.
        linear: The picture's values are proportional to light, instead of sRGB.
        reading: How the map of --under is read.
    """
    out = out or Path(f"{photo.resolve().stem}_relit.png")
    if out.suffix.lower() not in (".png", ".exr"):
        raise InputError(f"{out}: write a .png or an .exr")
    require_place(out)
    if out.resolve() == photo.resolve():
        raise InputError(f"{out} is the photograph itself: name another picture")
    if strength is not None and sun is None:
        raise InputError("--strength is the moved sun's: it goes with --sun")
    if turn is not None and not math.isfinite(turn):
        raise InputError(f"--turn wants degrees, got {turn}")
    if not -16 <= ev <= 16:
        raise InputError(f"--ev lies between -16 and 16 stops, got {ev:g}")
    moved = None if sun is None else _place(sun)
    from skylight.estimation._photos import estimate_photo
    from skylight.models._bundle import own_model
    from skylight.portrait._files import relit_portrait, write_relit
    from skylight.portrait._lights import light_of_map, light_with_sun_at, rotated_light

    given = None if under is None else light_of_map(under, reading)
    with stage_bar() as progress:
        result = estimate_photo(
            photo,
            light=light,
            model=own_model(model, network),
            place=place,
            face=face,
            device=device,
            decode="linear" if linear else gamma,
            progress=progress,
        )
        if given is not None:
            new = given
        elif moved is not None:
            new = light_with_sun_at(result.estimate, *moved, strength=strength)
        else:
            assert turn is not None  # one of the three is required
            new = rotated_light(result.estimate, turn)
        relit = relit_portrait(
            result,
            new,
            exposure=2.0**ev,
            keep="place" if given is None else "brightness",
            progress=lambda share: progress("relighting", share),
        )
        write_relit(out, relit)
    warning = (relit.warning,) if relit.warning else ()
    for line in (*result.estimate.advice, *warning, *relit.notes):
        take_care(line)
    print(f"verdict     {result.estimate.verdict.summary}")
    if given is not None:
        print(f"exposure    the map's light times {relit.exposure:.3g}")
    print(out)


def _place(sun: str) -> tuple[float, float]:
    """(azimuth, elevation) in degrees of AZ,EL."""
    try:
        azimuth, elevation = (float(part) for part in sun.split(","))
    except ValueError:
        azimuth = elevation = math.nan
    if not (math.isfinite(azimuth) and math.isfinite(elevation)):
        raise InputError(f"--sun wants AZ,EL in degrees, such as 40,35 (--sun=-40,35), got {sun!r}")
    return azimuth, elevation
