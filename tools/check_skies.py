"""Compare simulated clear skies with measurements and with other models.

    python -m tools.check_skies --data FOLDER   # writes benchmarks/results/skies.json

FOLDER holds the collected data (``reference/``). ``tools/skies_page.py`` makes the page of it.
"""

import argparse
import itertools
import math
import platform
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta, timezone
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pvlib
import torch

from skylight.evaluation._main import commit
from skylight.io._bounded import write_json
from skylight.models.sunsky import perez
from skylight.skies._atmosphere import EARTH_RADIUS_KM, Atmosphere, ClearSky
from skylight.skies._scattering import BANDS_NM, colour_matching
from skylight.skies._sun import Place, sun_angles
from skylight.sphere._frame import DirectionGrid, direction_from_angles
from tools.colorimetry import bright, chromaticity, colour_temperature

ROOT = Path(__file__).parents[1]
GRID = DirectionGrid.sky(32)
DIRECTIONS, SOLID = GRID.directions.float(), GRID.solid_angles.float()
COMPARED_NM = (650.0, 550.0, 450.0)  # of our wavelengths, those that are compared one by one
SOLAR_CONSTANT_KLX = 133.3  # Darula, Kittler & Gueymard 2005, "Reference luminous solar constant"
# Preetham's sky: (turbidity, sun zenith deg): zenith's kcd/m2, x, y; luminance 60 degrees from both
# zenith and sun over the zenith's. Computed from appendix A.2 of Preetham, Shirley & Smits 1999
# as restated by Bruneton (ebruneton/clear-sky-models).
PREETHAM = {
    (2.17, 45.0): (4.9662, 0.24174, 0.24503, 1.4962),
    (2.5, 30.0): (8.1930, 0.25235, 0.25776, 0.9264),
    (3.0, 60.0): (5.1392, 0.24493, 0.25257, 1.4524),
    (6.0, 45.0): (14.8933, 0.26145, 0.27545, 0.8411),
}


def aerosol_depth(turbidity: float) -> float:
    """Optical depth at 550 nm: Angstrom's beta 0.04608 T - 0.04586 at 1 um, exponent 1.3.

    Preetham et al. 1999, appendix A.1.
    """
    return (0.04608 * turbidity - 0.04586) * 0.55**-1.3


@cache
def clear_sky(depth: float, ground_albedo: float = 0.15) -> ClearSky:
    """Seen from the level of the sea, where the references' optical depths hold."""
    air = Atmosphere(aerosol_optical_depth=depth, ground_albedo=ground_albedo, observer_km=0.0)
    return ClearSky(air)


def towards(azimuth_rad: float, zenith_rad: float) -> torch.Tensor:
    angles = torch.tensor([azimuth_rad, zenith_rad], dtype=torch.float32)
    return direction_from_angles(angles[0], angles[1])


def irradiances(sky: ClearSky, zenith_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """(normal beam, diffuse on level ground), RGB, relative to extraterrestrial luminance."""
    beam = sky.sun_irradiance(torch.tensor([zenith_rad]))[0]
    diffuse = (DIRECTIONS[:, 1] * SOLID) @ sky.radiance(DIRECTIONS, towards(0.0, zenith_rad))
    return beam.numpy(), diffuse.numpy()


def zenith_against_preetham() -> list[dict]:
    rows = []
    for (turbidity, sun_deg), (theirs, x, y, at_60) in PREETHAM.items():
        sky = clear_sky(aerosol_depth(turbidity))
        sun = towards(0.0, math.radians(sun_deg))
        # 60 degrees from the zenith and from the sun: cos azimuth from the spherical triangle
        s = math.radians(sun_deg)
        cos_az = (0.5 - 0.5 * math.cos(s)) / (math.sin(math.radians(60)) * math.sin(s))
        side = towards(math.acos(cos_az), math.radians(60))
        up = torch.tensor([0.0, 1.0, 0.0])
        light = sky.radiance(torch.stack([up, side]), sun).double().numpy()
        zenith, aside = bright(light)
        ours_x, ours_y = chromaticity(light[0])
        rows.append(
            {
                "turbidity": turbidity,
                "sun_zenith_deg": sun_deg,
                "kcd": float(zenith * SOLAR_CONSTANT_KLX),
                "kcd_preetham": theirs,
                "at_60": float(aside / zenith),
                "at_60_preetham": at_60,
                "x": ours_x,
                "y": ours_y,
                "x_preetham": x,
                "y_preetham": y,
            }
        )
    return rows


def hosek_wilkie_depth(data: Path, turbidity: float) -> float:
    """The aerosol depth at 550 nm that Hosek & Wilkie's own sun says a turbidity has.

    By how much less a sun at 0.52 rad than one at the zenith comes through than in their
    haze-free air (turbidity 1), over the difference of the air masses.
    """
    spectra = np.load(data / "reference" / "mitsuba_sunsky_refs.npz")
    steps = (1.0, 3.2, 5.5, 7.8, 10.0)
    loss = [-np.log(_sun_ratio(spectra, t, 0.52)[1]) for t in steps]
    depths = (np.array(loss) - loss[0]) / (1 / math.sin(0.52) - 1)
    return float(np.interp(turbidity, steps, depths))


def _sun_ratio(spectra: Mapping, turbidity: float, height: float) -> np.ndarray:
    """Their sun at a height over that at the zenith, at :data:`COMPARED_NM`."""
    low, top = (
        spectra[f"spd/sun_spectrum_t{turbidity}_eta{h}_gamma0.000e+00"][2:12]
        for h in (f"{height:.2f}", "1.57")
    )
    log_ratio = np.log(low[:, 1] / top[:, 1])
    return np.exp(np.interp(COMPARED_NM, low[:, 0], log_ratio))


def hosek_wilkie(data: Path) -> list[dict]:
    """Luminance of the reference skies above the horizon: shape after one common scale."""
    skies = np.load(data / "reference" / "mitsuba_sunsky_refs.npz")
    theta, phi = np.linspace(0, math.pi, 32)[:16], np.linspace(0, 2 * math.pi, 64)[:63]
    rows = []
    for name in sorted(n for n in skies.files if n.startswith(("img/sky_rgb", "img/sky_spec_"))):
        kind, at, turbidity, albedo = name.removeprefix("img/sky_").split("_")
        image = skies[name][:16, :63].astype(float)
        if kind == "spec":  # W/m2/sr/nm
            theirs = image @ colour_matching(383.5 + 47 * np.arange(10))[:, 1] * 47 * 0.683
            elevation = float(at.removeprefix("eta"))
        else:
            theirs, elevation = bright(image), _elevation(float(at.removeprefix("hour")))
        depth = hosek_wilkie_depth(data, float(turbidity[1:]))
        sun_phi = np.angle((theirs * np.sin(theta)[:, None]).sum(0) @ np.exp(1j * phi))
        zenith, around = np.meshgrid(theta, phi - sun_phi, indexing="ij")
        views = direction_from_angles(
            torch.tensor(around.ravel()).float(), torch.tensor(zenith.ravel()).float()
        )
        sky = clear_sky(depth, float(albedo[1:]))
        light = sky.radiance(views, towards(0.0, math.pi / 2 - elevation))
        ours = bright(light.double().numpy()).reshape(theirs.shape) * SOLAR_CONSTANT_KLX
        weight = np.sin(zenith) / np.sin(zenith).sum()
        towards_sun = (views @ towards(0.0, math.pi / 2 - elevation)).clamp(-1, 1)
        preetham = perez(views[:, 1], torch.acos(towards_sun), torch.tensor(float(turbidity[1:])))
        preetham = preetham.double().numpy().reshape(theirs.shape)
        level = (weight * ours).sum() / (weight * theirs).sum()
        row = {
            "name": name.removeprefix("img/"),
            "turbidity": float(turbidity[1:]),
            "aerosol_depth": depth,
            "sun_height_deg": math.degrees(elevation),
            "difference": _difference(ours, theirs, weight),
            "difference_preetham": _difference(preetham, theirs, weight),
            "log_correlation": np.corrcoef(np.log(ours.ravel()), np.log(theirs.ravel()))[0, 1],
            "zenith": ours[0].mean() / (weight * ours).sum(),
            "zenith_theirs": theirs[0].mean() / (weight * theirs).sum(),
        }
        row |= {"level": level} if kind == "spec" else {}
        rows.append({k: v if isinstance(v, str) else float(v) for k, v in row.items()})
    return rows


def _difference(ours: np.ndarray, theirs: np.ndarray, weight: np.ndarray) -> float:
    """Mean absolute difference after one common scale, over the mean."""
    ours, theirs = ours / (weight * ours).sum(), theirs / (weight * theirs).sum()
    return float((weight * np.abs(ours - theirs)).sum())


def _elevation(hour: float) -> float:
    """Of the sun over Mitsuba's default place and date, radians."""
    place = Place(latitude_deg=35.6894, longitude_deg=139.6917)
    start = datetime(2010, 7, 10, tzinfo=timezone(timedelta(hours=9)))
    return math.pi / 2 - float(sun_angles(place, [start + timedelta(hours=hour)])[1][0])


def sun_spectra(data: Path) -> list[dict]:
    """The sun at lower heights over the sun at the zenith, at :data:`COMPARED_NM`."""
    spectra = np.load(data / "reference" / "mitsuba_sunsky_refs.npz")
    rows = []
    for turbidity, height in itertools.product((1.0, 3.2, 5.5, 7.8, 10.0), (0.52, 1.05)):
        sky = clear_sky(hosek_wilkie_depth(data, turbidity))
        cosines = torch.tensor([math.sin(height), 1.0], dtype=torch.float64)
        through = sky.transmittance(torch.full_like(cosines, EARTH_RADIUS_KM), cosines).numpy()
        ours = through[:, [BANDS_NM.index(nm) for nm in COMPARED_NM]]
        rows.append(
            {
                "turbidity": turbidity,
                "sun_height_deg": math.degrees(height),
                "ours": (ours[0] / ours[1]).tolist(),
                "theirs": _sun_ratio(spectra, turbidity, height).tolist(),
            }
        )
    return rows


def sun_positions(data: Path) -> dict:
    """Against the 6259 geometric positions by the US Naval Observatory, degrees.

    An error of azimuth counts as what it is on the sky: times the sine of the zenith angle.
    """
    lines = (data / "reference" / "usno_sun_positions_6259.txt").read_text().splitlines()
    cells = [line.split() for line in lines]
    times = [datetime.fromisoformat(f"{c[0]}T{c[1]}").replace(tzinfo=UTC) for c in cells]
    latitude, longitude, height, azimuth, zenith = np.array([c[2:] for c in cells], float).T
    table = pvlib.solarposition.get_solarposition(
        pd.DatetimeIndex(times), latitude, longitude, altitude=height
    )
    ours = np.array([table["azimuth"], table["zenith"]])
    # sun_angles asks the same for one place; here are as many places as times
    aside = 0.0
    for i in range(0, len(cells), 50):
        place = Place(latitude_deg=latitude[i], longitude_deg=longitude[i], altitude_m=height[i])
        one = np.degrees(sun_angles(place, [times[i]]))[:, 0]
        aside = max(aside, float(np.abs(one - ours[:, i]).max()))
    off_zenith = np.abs(ours[1] - zenith)
    off_azimuth = np.abs((ours[0] - azimuth + 180) % 360 - 180) * np.sin(np.radians(zenith))
    return {
        "rows": len(cells),
        "sun_angles_off": aside,
        "zenith_max": float(off_zenith.max()),
        "zenith_mean": float(off_zenith.mean()),
        "azimuth_max": float(off_azimuth.max()),
        "azimuth_mean": float(off_azimuth.mean()),
    }


def day_at_ithaca(data: Path) -> dict:
    """Global horizontal irradiance of 2013-05-27 (Kider et al. 2014), the clear 390 minutes.

    Our illuminance becomes W/m2 by the luminous efficacy of ASTM G173's global spectrum, lm/W.
    The haze of that day is not known; three usual depths are shown.
    """
    reference = data / "reference"
    spectra = np.array(
        [
            line.split()[:3]
            for line in (reference / "astm_g173.txt").read_text().splitlines()
            if line[:1].isdigit()
        ],
        float,
    )
    nm, total = spectra[:, 0], spectra[:, 2]
    lumens = 683 * np.trapezoid(total * colour_matching(nm)[:, 1], nm)
    efficacy = lumens / np.trapezoid(total, nm)
    minutes, measured = np.loadtxt(reference / "kider_full_day_irradiance_2013-05-27.txt").T
    bursts = [(minutes >= m) & (minutes < m + 15) for m in np.arange(0, 390, 15)]
    at = np.array([minutes[b].mean() for b in bursts])
    measured = np.array([measured[b].mean() for b in bursts])
    start = datetime(2013, 5, 27, 13, 30, tzinfo=UTC)  # 09:30 local
    place = Place(latitude_deg=42.44337, longitude_deg=-76.48163, altitude_m=250.0)
    zeniths = sun_angles(place, [start + timedelta(minutes=m) for m in at])[1]
    distance = float(pvlib.irradiance.get_extra_radiation(start.date())) / 1366.1
    ours, fits = {}, {}
    for depth in (0.05, 0.1, 0.2):
        klx = []
        for zenith in zeniths:
            beam, diffuse = irradiances(clear_sky(depth), zenith)
            klx.append(bright(beam * math.cos(zenith) + diffuse) * SOLAR_CONSTANT_KLX)
        watts = 1000 * np.array(klx) * distance / efficacy
        scale = (watts @ measured) / (watts @ watts)
        off = scale * watts / measured - 1
        ours[str(depth)] = watts.tolist()
        fits[str(depth)] = {
            "scale": float(scale),
            "shape_rms": float(np.sqrt((off**2).mean())),
            "shape_max": float(np.abs(off).max()),
        }
    return {
        "efficacy_lm_per_w": float(efficacy),
        "minutes": at.tolist(),
        "sun_height_deg": (90 - np.degrees(zeniths)).tolist(),
        "measured": measured.tolist(),
        "ours": ours,
        "fits": fits,
    }


def spectrl2(depth: float, zenith_deg: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(nm, normal beam, diffuse horizontal), W/m2/nm: Bird & Riordan 1986 in air like ours."""
    light = pvlib.spectrum.spectrl2(
        apparent_zenith=np.array([zenith_deg]),
        aoi=np.array([zenith_deg]),
        surface_tilt=0,
        ground_albedo=0.15,
        surface_pressure=101325.0,
        relative_airmass=np.array([pvlib.atmosphere.get_relative_airmass(zenith_deg)]),
        precipitable_water=1.5,
        ozone=0.3,
        aerosol_turbidity_500nm=depth * (500 / 550) ** -1.3,
        dayofyear=94,  # the Earth at its mean distance
        scattering_albedo_400nm=0.92,
        alpha=1.3,
        wavelength_variation_factor=0.0,
        aerosol_asymmetry_factor=0.76,
    )
    return light["wavelength"], light["dni"][:, 0], light["dhi"][:, 0]


def beam_and_sky() -> list[dict]:
    """Illuminances in klx by SPECTRL2 (Bird & Riordan 1986; pvlib) in the same air, and ours.

    Also the ratio of beam to sky by Bird's broadband model (Bird & Hulstrom 1981; W/m2).
    """
    rows = []
    for depth, height in itertools.product((0.05, 0.1, 0.2, 0.4), (10, 20, 30, 45, 60, 70)):
        zenith = 90.0 - height
        nm, dni, dhi = spectrl2(depth, zenith)
        seen = colour_matching(nm)[:, 1] * 0.683
        dni, dhi = (float(np.trapezoid(light * seen, nm)) for light in (dni, dhi))
        beam, sky = irradiances(clear_sky(depth), math.radians(zenith))
        mass = float(pvlib.atmosphere.get_relative_airmass(zenith))
        at_380, at_500 = (depth * (nm / 550) ** -1.3 for nm in (380, 500))
        broad = pvlib.clearsky.bird(np.array([zenith]), np.array([mass]), at_380, at_500, 1.5)
        rows.append(
            {
                "aerosol_depth": depth,
                "sun_height_deg": height,
                "beam": float(bright(beam) * SOLAR_CONSTANT_KLX),
                "beam_theirs": dni,
                "sky": float(bright(sky) * SOLAR_CONSTANT_KLX),
                "sky_theirs": dhi,
                "bird_ratio": float(broad["dni"][0] / broad["dhi"][0]),
            }
        )
    return rows


def colours() -> list[dict]:
    """Chromaticity of sun and sky (all of it on level ground): ours and SPECTRL2's spectra.

    Kelvin by McCamy's formula, where it holds.
    """
    rows = []
    for height in (70, 45, 30, 20, 15, 10, 7, 5, 3, 2, 1):
        beam, sky = irradiances(clear_sky(0.1), math.radians(90 - height))
        nm, *theirs = spectrl2(0.1, 90.0 - height)
        row: dict = {"height_deg": height}
        for name, ours, spectrum in zip(("sun", "sky"), (beam, sky), theirs, strict=True):
            xyz = np.trapezoid(spectrum[:, None] * colour_matching(nm), nm, axis=0)
            row[name] = chromaticity(ours)
            row[f"{name}_theirs"] = float(xyz[0] / xyz.sum()), float(xyz[1] / xyz.sum())
        if height >= 5:
            row["kelvin"] = colour_temperature(*row["sun"])
            row["kelvin_theirs"] = colour_temperature(*row["sun_theirs"])
        rows.append(row)
    return rows


def measure(data: Path) -> dict:
    return {
        "command": "python -m tools.check_skies --data FOLDER",
        "commit": commit(),
        "date": datetime.now(UTC).date().isoformat(),
        "machine": f"{platform.machine()}, torch {torch.__version__}",
        "zenith": zenith_against_preetham(),
        "hosek_wilkie": hosek_wilkie(data),
        "sun_spectra": sun_spectra(data),
        "sun_positions": sun_positions(data),
        "day": day_at_ithaca(data),
        "beam_and_sky": beam_and_sky(),
        "colours": colours(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="the collected data")
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "results" / "skies.json")
    options = parser.parse_args()
    if not (options.data / "reference").is_dir():
        raise SystemExit(f"{options.data}: no folder 'reference' in it; give the collected data")
    write_json(options.out, measure(options.data))
    print(options.out)


if __name__ == "__main__":
    main()
