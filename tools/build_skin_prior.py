"""Build ``skylight/faces/data/skin_prior.safetensors``: a prior of skin albedo.

    python tools/build_skin_prior.py --reference DIR

``DIR`` holds two files (see NOTICE for their origin):

* ``nist_skin_reflectance_100.npz``: ``wavelength_nm`` (401,), 380 to 780 nm, and ``reflectance``
  (100, 401), the inner forearms of 100 people;
* ``chromophore_absorption.npz``: ``Melanin_wl`` (nm) with ``Melanin_mua_per_cm``, and
  ``prahl_molar_extinction`` (n, 3): nm, oxy- and deoxyhaemoglobin (1 / (cm mol/l)).

The 100 are mostly light, and an inner forearm is paler than its owner's face. So every spectrum is
also taken with graded amounts of melanin and blood added (:func:`with_pigment`), turned to linear
Rec.709 under D65, and a Gaussian mixture is fitted to the logarithms. What skin reflects at its
surface is light's colour, and the shading model has a term of its own for it, so most of it is
taken off: left in, the darkest skins are grey, and pale skin under a dim sky looks like them. The
result depends on the inputs and ``--seed`` only.
"""

import argparse
import math
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from skylight.models._prior import GaussianMixture

# CIE standard illuminant D65, relative power at 380, 390, ... 780 nm (ISO 11664-2, CIE 15:2004).
# fmt: off
D65 = np.array(
    [
        49.98, 54.65, 82.75, 91.49, 93.43, 86.68, 104.86, 117.01, 117.81, 114.86, 115.92, 108.81,
        109.35, 107.80, 104.79, 107.69, 104.41, 104.05, 100.00, 96.33, 95.79, 88.69, 90.01, 89.60,
        87.70, 83.29, 83.70, 80.03, 80.21, 82.28, 78.28, 69.72, 71.61, 74.35, 61.60, 69.89, 75.09,
        63.59, 46.42, 66.81, 63.38,
    ]
)
# fmt: on
# CIE XYZ to linear Rec.709 (IEC 61966-2-1:1999)
XYZ_TO_RGB = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear Rec.709

# Share of light that turns back at the surface and meets no pigment: Fresnel's at normal
# incidence, ((n - 1) / (n + 1))^2 with n = 1.4 for skin. It is why the darkest skins are not the
# most colourful.
SURFACE = (0.4 / 2.4) ** 2

# How much of it is left in the albedo, evenly: photographs are not that exact. A choice.
SURFACE_LEFT = (0.0, 0.25, 0.5)

# Luminance, surface included, that the mean subject is darkened to (L* 27), grade by grade, evenly
# in its logarithm, from its own 0.36. A choice: about the darkest skin there is.
DARKEST = 0.05
TONES = 9
# Added blood, as the mean number of vessels that light crosses: it raises a* of the mean subject by
# 0 to 5. Of 600 people, cheeks are 3.7 redder than inner arms (Han, Choi & Son 2006, "Skin color of
# Koreans", Skin Res. Technol. 12(3)), and faces differ.
BLOOD = (0.0, 0.1, 0.2, 0.3, 0.4)
# Variance of log-albedo added to every channel: what :func:`with_pigment` is wrong by (6 %) and
# measurements (3 %, a choice). What light and camera are wrong by are parameters of their own.
MODEL_ERROR = 0.06**2 + 0.03**2


def matching_functions(nm: Float[ndarray, " n"]) -> Float[ndarray, "3 n"]:
    """CIE 1931 x, y, z as sums of two-sided Gaussians.

    Wyman, Sloan & Shirley 2013, "Simple analytic approximations to the CIE XYZ color matching
    functions", JCGT 2(2), listing 1: a exp(-((nm - m) s)^2 / 2), s = s1 below m and s2 above.
    """

    def lobe(a: float, m: float, s1: float, s2: float) -> ndarray:
        return a * np.exp(-0.5 * ((nm - m) * np.where(nm < m, s1, s2)) ** 2)

    return np.stack(
        [
            lobe(0.362, 442.0, 0.0624, 0.0374)
            + lobe(1.056, 599.8, 0.0264, 0.0323)
            + lobe(-0.065, 501.1, 0.0490, 0.0382),
            lobe(0.821, 568.8, 0.0213, 0.0247) + lobe(0.286, 530.9, 0.0613, 0.0322),
            lobe(1.217, 437.0, 0.0845, 0.0278) + lobe(0.681, 459.0, 0.0385, 0.0725),
        ]
    )


def sensitivities(nm: Float[ndarray, " n"]) -> Float[ndarray, "3 n"]:
    """Weights w with w @ reflectance = linear Rec.709 under D65, on evenly spaced ``nm``.

    Before the last line a white reflector comes out as (0.998, 1.001, 0.999), the fits' error;
    scaling the channels makes it (1, 1, 1).
    """
    light = np.interp(nm, np.arange(380.0, 781.0, 10.0), D65)
    weights = XYZ_TO_RGB @ (matching_functions(nm) * light)
    return weights / weights.sum(axis=1, keepdims=True)


def melanin(nm: Float[ndarray, " n"], chromophores: dict[str, ndarray]) -> Float[ndarray, " n"]:
    """Absorption of melanin, 1 at 550 nm.

    The table starts at 450 nm; it is a power law, 6.6e11 nm^-3.33 per cm (S. L. Jacques, "Skin
    Optics", Oregon Medical Laser Center News, January 1998), which is continued below.
    """
    table = np.log(chromophores["Melanin_wl"]), np.log(chromophores["Melanin_mua_per_cm"])
    exponent, _ = np.polyfit(*table, 1)
    return (nm / 550.0) ** exponent


def blood(nm: Float[ndarray, " n"], chromophores: dict[str, ndarray]) -> Float[ndarray, " n"]:
    """Share of light lost in crossing a vessel, 1 - exp(-2 r mu).

    Radius r = 25 um, blood of 150 g/l haemoglobin (64,500 g/mol), three quarters of it oxygenated.
    That blood keeps to vessels flattens its violet peak (van Veen, Verkruysse & Sterenborg 2002,
    Optics Letters 27(4)).
    """
    wavelength, oxy, deoxy = chromophores["prahl_molar_extinction"].astype(np.float64).T
    molar = np.interp(nm, wavelength, 0.75 * oxy + 0.25 * deoxy)
    per_cm = math.log(10) * molar * 150 / 64_500
    return 1 - np.exp(-2 * 25e-4 * per_cm)


def with_pigment(
    reflectance: Float[ndarray, "s n"],
    melanin_amount: float,
    melanin_spectrum: Float[ndarray, " n"],
    blood_amount: float,
    blood_spectrum: Float[ndarray, " n"],
) -> Float[ndarray, "s n"]:
    """s + (R - s) exp(-b blood) / (1 + m melanin), with s the surface's share.

    The melanin under a point varies, as grains and patches do: averaged over an exponential
    distribution of amounts, exp(-m mu) becomes 1 / (1 + m mu). With it the mean of the 100 darkens
    to the colour of the darkest of them within 6 %; with exp(-m mu) its blue is 40 % too low.
    """
    below = (reflectance - SURFACE) * np.exp(-blood_amount * blood_spectrum)
    return SURFACE + below / (1 + melanin_amount * melanin_spectrum)


def skin_albedos(
    nm: Float[ndarray, " n"],
    reflectance: Float[ndarray, "s n"],
    chromophores: dict[str, ndarray],
) -> Float[ndarray, "a 3"]:
    """Linear Rec.709 albedos of all subjects in every tone, redness and share of the surface."""
    weights = sensitivities(nm)
    spectra = melanin(nm, chromophores), blood(nm, chromophores)
    mean = reflectance.mean(axis=0, keepdims=True)

    amounts = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 2000)])
    luminance = np.array(
        [
            (LUMINANCE @ weights @ with_pigment(mean, m, spectra[0], 0.0, spectra[1]).T).item()
            for m in amounts
        ]
    )
    tones = np.geomspace(luminance[0], DARKEST, TONES)
    grades = np.interp(-tones, -luminance, amounts)
    whole = np.concatenate(
        [
            with_pigment(reflectance, m, spectra[0], b, spectra[1]) @ weights.T
            for m in grades
            for b in BLOOD
        ]
    )
    return np.concatenate([whole - (1 - left) * SURFACE for left in SURFACE_LEFT])


def fit(albedos: Float[ndarray, "a 3"], seed: int) -> GaussianMixture:
    """Mixture over log-albedo with 3 to 5 components, whichever has the lowest BIC."""
    samples = torch.from_numpy(np.log(albedos))

    def bic(mixture: GaussianMixture) -> float:
        # a component has a weight (they sum to one), 3 means and 6 covariances
        parameters = 10 * len(mixture.weights) - 1
        return parameters * math.log(len(samples)) - 2 * float(mixture.log_prob(samples).sum())

    fits = [
        GaussianMixture.fit(samples, count, seed=seed, covariance_floor=MODEL_ERROR)
        for count in (3, 4, 5)
    ]
    return min(fits, key=bic)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--reference", type=Path, required=True, help="folder of the two inputs")
    here = Path(__file__).resolve().parent.parent
    parser.add_argument(
        "--out", type=Path, default=here / "skylight/faces/data/skin_prior.safetensors"
    )
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    with np.load(args.reference / "nist_skin_reflectance_100.npz") as subjects:
        nm = subjects["wavelength_nm"].astype(np.float64)
        reflectance = subjects["reflectance"].astype(np.float64)
    with np.load(args.reference / "chromophore_absorption.npz") as stored:
        chromophores = dict(stored)

    albedos = skin_albedos(nm, reflectance, chromophores)
    mixture = fit(albedos, args.seed)
    mixture.save(args.out)
    print(f"{args.out}: {len(mixture.weights)} components from {len(albedos)} albedos")
    for weight, mean in zip(mixture.weights.tolist(), mixture.means.exp().tolist(), strict=True):
        print(f"  {weight:.3f}  albedo", " ".join(f"{value:.3f}" for value in mean))


if __name__ == "__main__":
    main()
