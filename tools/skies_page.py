"""Write ``docs/skies.md`` and its pictures from ``benchmarks/results/skies.json``.

    python -m tools.check_skies --data FOLDER
    python -m tools.skies_page

No number of the tables is written by hand.
"""

import io
import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from skylight.io._atomic import atomic_path

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "skies.json"
IMAGES = ROOT / "docs" / "images"


def main() -> None:
    found = json.loads(RESULTS.read_text())
    pictures = {"skies_beam": beam_plot, "skies_day": day_plot, "skies_colour": colour_plot}
    for name, draw in pictures.items():
        save(IMAGES / f"{name}.png", draw(found))
    with atomic_path(ROOT / "docs" / "skies.md") as temporary:
        temporary.write_text(page(found))
    print(ROOT / "docs" / "skies.md")


def save(path: Path, figure: Figure) -> None:
    picture = io.BytesIO()  # the temporary name has no suffix to tell the format by
    figure.savefig(picture, format="png", dpi=90, metadata={"Software": None})
    plt.close(figure)
    with atomic_path(path) as temporary:
        temporary.write_bytes(picture.getvalue())


def beam_plot(found: dict) -> Figure:
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for axis, part, title in zip(
        axes, ("beam", "sky"), ("normal beam", "sky on level ground"), strict=True
    ):
        for colour, depth in enumerate(sorted({r["aerosol_depth"] for r in found["beam_and_sky"]})):
            rows = [r for r in found["beam_and_sky"] if r["aerosol_depth"] == depth]
            heights = [r["sun_height_deg"] for r in rows]
            style = {"color": f"C{colour}"}
            axis.plot(heights, [r[part] for r in rows], label=f"depth {depth}", **style)
            axis.plot(heights, [r[f"{part}_theirs"] for r in rows], "o", **style)
        axis.set(xlabel="sun height, degrees", ylabel="klx", title=title, ylim=(0, None))
    axes[0].legend(title="ours; dots: SPECTRL2", fontsize=8)
    return figure


def day_plot(found: dict) -> Figure:
    day = found["day"]
    figure, axis = plt.subplots(figsize=(6.5, 3.6), layout="constrained")
    axis.plot(day["minutes"], day["measured"], "ko", ms=4, label="measured")
    for depth, watts in day["ours"].items():
        axis.plot(day["minutes"], watts, label=f"ours, aerosol depth {depth}")
    axis.set(xlabel="minutes after 09:30", ylabel="global horizontal, W/m²")
    axis.legend()
    return figure


def colour_plot(found: dict) -> Figure:
    rows = found["colours"]
    figure, axis = plt.subplots(figsize=(5, 4), layout="constrained")
    for colour, name in (("C1", "sun"), ("C0", "sky")):
        axis.plot(
            *zip(*(r[name] for r in rows), strict=True),
            "o-",
            ms=3,
            color=colour,
            label=f"{name}, ours",
        )
        theirs = zip(*(r[f"{name}_theirs"] for r in rows), strict=True)
        axis.plot(*theirs, "x--", ms=4, color=colour, label=f"{name}, SPECTRL2")
    axis.set(xlabel="x (CIE 1931)", ylabel="y", title="sun at 70 to 1 degrees, depth 0.1")
    axis.legend()
    return figure


def table(head: str, rows: list[list[object]]) -> str:
    columns = head.split("|")
    lines = ["|" + "|".join(f" {c.strip()} " for c in columns) + "|", "|---" * len(columns) + "|"]
    for row in rows:
        cells = (f"{c:.3g}" if isinstance(c, float) else str(c) for c in row)
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def triple(values: list[float]) -> str:
    return " ".join(f"{v:.3f}" for v in values)


def page(found: dict) -> str:
    sun, day = found["sun_positions"], found["day"]
    beams = [
        [
            r["aerosol_depth"],
            r["sun_height_deg"],
            r["beam"],
            100 * (r["beam"] / r["beam_theirs"] - 1),
            r["sky"],
            100 * (r["sky"] / r["sky_theirs"] - 1),
            r["beam"] / r["sky"],
            r["beam_theirs"] / r["sky_theirs"],
            r["bird_ratio"],
        ]
        for r in found["beam_and_sky"]
    ]
    fits = [
        [depth, fit["scale"], 100 * fit["shape_rms"], 100 * fit["shape_max"]]
        for depth, fit in day["fits"].items()
    ]
    zenith = [
        [
            r["turbidity"],
            r["sun_zenith_deg"],
            r["kcd"],
            r["kcd_preetham"],
            r["at_60"],
            r["at_60_preetham"],
            f"{r['x']:.3f} {r['y']:.3f}",
            f"{r['x_preetham']:.3f} {r['y_preetham']:.3f}",
        ]
        for r in found["zenith"]
    ]
    hosek = [
        [
            r["name"],
            r["aerosol_depth"],
            r["sun_height_deg"],
            100 * r["difference"],
            100 * r["difference_preetham"],
            r["log_correlation"],
            r["zenith"],
            r["zenith_theirs"],
            r.get("level", ""),
        ]
        for r in found["hosek_wilkie"]
    ]
    spectra = [
        [r["turbidity"], r["sun_height_deg"], triple(r["ours"]), triple(r["theirs"])]
        for r in found["sun_spectra"]
    ]
    colours = [
        [
            r["height_deg"],
            *(triple(r[k]) for k in ("sun", "sun_theirs", "sky", "sky_theirs")),
            f"{r['kelvin']:.0f}" if "kelvin" in r else "",
            f"{r['kelvin_theirs']:.0f}" if "kelvin" in r else "",
        ]
        for r in found["colours"]
    ]
    return TEXT.format(
        **{k: found[k] for k in ("command", "commit", "date", "machine")},
        sun=sun,
        efficacy=day["efficacy_lm_per_w"],
        beams=table(
            "depth at 550 nm | sun height | beam, klx | off, % | sky, klx | off, % "
            "| beam / sky | SPECTRL2 | Bird, broadband",
            beams,
        ),
        fits=table("aerosol depth | scale to measured | shape, rms % | largest %", fits),
        zenith=table(
            "turbidity | sun from zenith | zenith, kcd/m² | Preetham | at 60° / zenith "
            "| Preetham | x y | Preetham",
            zenith,
        ),
        hosek=table(
            "reference | aerosol depth | sun height | difference, % | Preetham, % "
            "| correlation of logs | zenith / mean | theirs | our level / theirs",
            hosek,
        ),
        spectra=table("turbidity | sun height | ours: 650 550 450 nm | theirs", spectra),
        colours=table(
            "sun height | sun x y | SPECTRL2 | sky x y | SPECTRL2 | sun, K | SPECTRL2", colours
        ),
    )


TEXT = """\
# Are the clear skies physical?

Generated by `tools/skies_page.py` from `benchmarks/results/skies.json`; do not edit. Measured by
`{command}`, commit {commit}
(+: changed since), {date}, {machine};
[measurements](measurements.md#how-old-they-are) says what changed since. The bounds that hold at
every change are in
`tests/skies/test_references.py` and `tests/skies/test_atmosphere.py`.

One relative unit of ours is the extraterrestrial illuminance of the sun, 133.3 klx (Darula,
Kittler & Gueymard 2005). Unless said otherwise the observer is at sea level, the aerosol has
Angstrom's exponent 1.3, single-scattering albedo 0.92 and asymmetry 0.76.

## Beam and sky, against an independent spectral model

SPECTRL2 (Bird & Riordan 1986, as in pvlib) in the same air, its spectra weighted by the eye's
sensitivity. Bird's broadband ratio counts infrared light too, of which little is scattered, so it
stands above the visible one.

{beams}

![beam and sky](images/skies_beam.png)

The beam agrees to 0.5 % from 20 degrees upwards and to 2.4 % at 10 degrees. SPECTRL2's sky light is
an empirical share of what the beam loses; ours is 1 to 8 % brighter from 20 degrees upwards, and 13
to 18 % at 10 degrees. Against photons followed one by one, in layers of the same coefficients, our
diffuse light is within 2 % and three standard errors of theirs. Of skies under a low sun or in
thick haze the mean over nine directions is within 4 %, and each direction within 5 % and three
standard errors, together 8 to 19 % (`tests/skies/test_atmosphere.py`).

## A measured clear day

Global horizontal irradiance in Ithaca, 2013-05-27 (Kider et al. 2014), means of bursts of
five minutes.
Our illuminance becomes W/m² by {efficacy:.1f} lm/W, the efficacy of ASTM G173's global spectrum.
The haze of the day is unknown, so its depth is not fitted: three usual ones. The scale is what
takes ours to the measured level, the shape what remains after it; a minute or two of it may be the
clock, whose start was inferred from the hour of the peak.

{fits}

![a clear day](images/skies_day.png)

## Where the sun stands

{sun[rows]} geometric positions by the US Naval Observatory: zenith angle off by at most
{sun[zenith_max]:.1e} degrees ({sun[zenith_mean]:.1e} on average), azimuth, as an angle on the
sky, by at most {sun[azimuth_max]:.1e} ({sun[azimuth_mean]:.1e}). The test allows 2e-4; the
algorithm claims 3e-4.

## Zenith, against Preetham's formulas

Aerosol depth from turbidity by Preetham's own relation, beta = 0.04608 T - 0.04586 at 1 um.

{zenith}

Our zenith has a third to two thirds of Preetham's luminance. The level of ours follows from the
sky's illuminance, which agrees with SPECTRL2 and with the measured day above; a zenith twice as
bright would not. (Zotti, Wilkie & Purgathofer 2007, "A critical review of the Preetham skylight
model", compare that model with the CIE's skies and with measured ones.) Preetham's zenith is
bluer than ours by 0.015 to 0.03 in x and y. The gradation, light at 60 degrees over that of the
zenith, differs by 7 to 43 %; how far such models differ among themselves is in the next table.

## Sky and sun, against Hosek & Wilkie

Reference renderings of Mitsuba's tests. Their turbidity is not Preetham's: their own sun at two
heights says how much haze it means (third column: at most a few tenths where Preetham's relation
gives up to 0.9), and that depth is used. Difference: mean absolute difference of luminance after
one common scale, over the mean luminance of the sky, from 3 degrees above the horizon upwards; in
the column after it the same for Preetham's sky of their turbidity, which is the spread that
models of this kind have among themselves.

{hosek}

Ours agree to 9 to 17 %. Their spectral skies are 1.6 to 1.8 times as bright as ours (last column,
the level of the reference as delivered) for the haze that their sun sees: their sky and their sun
do not seem to belong to one air, so only the shape is held by a test.

The sun at two heights over the sun at the zenith:

{spectra}

At 550 nm the depth is taken from the references, so only haze-free air (turbidity 1) and the
other two wavelengths test anything. Their haze takes all colours more alike than Angstrom's
exponent 1.3. Their haze-free air takes 6.5 % more of the blue than ours, whose optical depth is
Bodhaine's (1999); SPECTRL2's air and Hansen & Travis' (1974) agree with that one.

## Colour

{colours}

![colours](images/skies_colour.png)

The sun reddens without fail on its way down and the sky is blue, both with the chromaticities of
daylight; down to 10 degrees of height the sky's are within 0.006 of SPECTRL2's in x and y. The
sun's are within 0.006 down to 5 degrees, and 96 to 116 K below SPECTRL2's at every height. At 2
degrees and below the sun's yellow and red are too pure for Rec.709's primaries: there blue is 0.
"""


if __name__ == "__main__":
    main()
