"""Build ``skylight/people/data/skin_colours.npz``: colours of synthetic skin.

    python tools/build_skin_spectra.py --reference DIR

``DIR`` holds the two files that ``tools/build_skin_prior.py`` names. Only the absorption of the
chromophores goes into the result; the 100 measured people check it, which is printed.

Skin is an epidermis with melanin over a dermis with blood. The dermis is infinitely deep
(Kubelka and Munk 1931): with K = 2 mu_a and S = 3/4 mu_s',

    R_d = 1 + K/S - sqrt((K/S)^2 + 2 K/S).

mu_s' = 46 (nm / 500)^-1.421 per cm (S. L. Jacques, "Optical properties of biological tissues: a
review", Phys. Med. Biol. 58, 2013; table 1) and mu_a = b mu_blood + baseline (S. L. Jacques, "Skin
Optics", Oregon Medical Laser Center News, January 1998, as is a melanosome's absorption). Light
crosses the epidermis, 60 um deep, twice at twice its depth on average, and meets an amount of
melanin that varies from grain to grain: over an exponential distribution of mean m this leaves

    T = 1 / (1 + 4 * 60 um * m * mu_melanin)   and inside   R_i = T R_d.

Diffuse light is thrown back from below the surface by k = 0.46, so what comes out of the light
that gets in is R = (1 - k) R_i / (1 - k R_i) (J. L. Saunderson 1942, JOSA 32). Fresnel's formula
for an index of refraction of 1.4 gives k = 0.53; 0.46 was chosen because it meets the measured
people better (median gap 4.2 against 5.2 %). The surface's own reflection is no part of the table:
it is rendered as specular reflection.
"""

import argparse
from pathlib import Path

import numpy as np
from build_skin_prior import SURFACE, blood, melanin, sensitivities
from jaxtyping import Float
from numpy import ndarray

MELANIN = np.geomspace(0.002, 0.8, 40)  # volume fractions of melanosomes in the epidermis
BLOOD = np.geomspace(0.002, 0.12, 24)  # volume fractions of blood in the dermis
EPIDERMIS_CM = 60e-4
MELANOSOME_550 = 500.0  # its inside's absorption per cm, about 6.6e11 550^-3.33 (Jacques 1998)
# Share of diffuse light that the surface throws back inside. Chosen, where Fresnel's formula has
# 0.53 for an index of 1.4: the measured people are met better.
INTERNAL = 0.46
VESSEL_CM = 50e-4  # diameter of a vessel: turns its share of lost light into an absorption


def baseline(nm: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    """Absorption of bloodless skin, per cm: 0.244 + 85.3 exp(-(nm - 154) / 66.2).

    Jacques, "Skin Optics", 1998.
    """
    return 0.244 + 85.3 * np.exp(-(nm - 154) / 66.2)


def reflectance(
    nm: Float[ndarray, " n"],
    melanosomes: float,
    blood_share: float,
    chromophores: dict[str, ndarray],
) -> Float[ndarray, " n"]:
    """Share of the light that enters the skin which comes out again."""
    blood_per_cm = blood(nm, chromophores) / VESSEL_CM  # as seen: vessels shade their own inside
    absorption = blood_share * blood_per_cm + (1 - blood_share) * baseline(nm)
    ratio = 2 * absorption / (0.75 * 46 * (nm / 500) ** -1.421)
    dermis = 1 + ratio - np.sqrt(ratio**2 + 2 * ratio)
    depth = 4 * EPIDERMIS_CM * melanosomes * MELANOSOME_550 * melanin(nm, chromophores)
    inside = dermis / (1 + depth)
    return (1 - INTERNAL) * inside / (1 - INTERNAL * inside)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--reference", type=Path, required=True, help="folder of the two inputs")
    here = Path(__file__).resolve().parent.parent
    default = here / "skylight/people/data/skin_colours.npz"
    parser.add_argument("--out", type=Path, default=default)
    args = parser.parse_args()
    with np.load(args.reference / "chromophore_absorption.npz") as stored:
        chromophores = dict(stored)
    with np.load(args.reference / "nist_skin_reflectance_100.npz") as subjects:
        nm = subjects["wavelength_nm"].astype(np.float64)
        measured = subjects["reflectance"].astype(np.float64)
    weights = sensitivities(nm)
    table = np.array(
        [[weights @ reflectance(nm, m, b, chromophores) for b in BLOOD] for m in MELANIN]
    )
    args.out.parent.mkdir(parents=True, exist_ok=True)
    np.savez(
        args.out,
        melanin=MELANIN.astype(np.float32),
        blood=BLOOD.astype(np.float32),
        albedo=table.astype(np.float32),
    )
    print(f"{args.out}: {table.shape[0]} x {table.shape[1]} colours")
    whole = SURFACE + (1 - SURFACE) * table
    people = measured @ weights.T
    gap = np.abs(np.log(whole[None] / people[:, None, None])).max(-1).reshape(len(people), -1)
    nearest = gap.min(1)
    print(f"  measured people are met within {np.median(nearest):.1%} (median, worst channel),")
    print(f"  {np.quantile(nearest, 0.95):.1%} (95th percentile)")
    best = np.unravel_index(gap.argmin(1), table.shape[:2])
    for name, values in (("melanin", MELANIN[best[0]]), ("blood", BLOOD[best[1]])):
        low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
        print(f"  their {name}: {low:.3f}, {middle:.3f}, {high:.3f} (5, 50, 95 %)")


if __name__ == "__main__":
    main()
