"""Reflectances and lamps' colours that places are made of.

Broadband albedos of grounds lie in the ranges of Oke (1987), "Boundary Layer Climates", table 1.1,
those of rooms in the ranges that EN 12464-1 recommends (ceilings 0.7 to 0.9, walls 0.5 to 0.8,
floors 0.2 to 0.6) with darker ones beside them; hues are those of the things as they are named.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skylight.places._scene import SUN_LUX, Material, Real, Triple, black_body
from skylight.sphere._envmap import LUMINANCE

# fmt: off
GROUNDS: dict[str, tuple[float, Material]] = {  # its share of grounds
    "grass": (0.22, Material(albedo=(0.055, 0.085, 0.026), texture=0.3, grain_m=0.8)),
    "dry grass": (0.07, Material(albedo=(0.17, 0.145, 0.08), texture=0.3, grain_m=0.8)),
    "asphalt": (0.16, Material(albedo=(0.1, 0.1, 0.1), texture=0.12, grain_m=2.0)),
    "wet asphalt": (0.04, Material(albedo=(0.05, 0.05, 0.052), gloss=0.03, roughness=0.12,
                                   texture=0.3, grain_m=2.0)),
    "concrete": (0.1, Material(albedo=(0.29, 0.28, 0.26), texture=0.12, grain_m=1.5)),
    "paving": (0.12, Material(albedo=(0.25, 0.23, 0.205), texture=0.2, grain_m=0.7)),
    "brick": (0.03, Material(albedo=(0.2, 0.115, 0.085), texture=0.2, grain_m=0.5)),
    "soil": (0.06, Material(albedo=(0.135, 0.095, 0.06), texture=0.3, grain_m=0.8)),
    "leaves": (0.05, Material(albedo=(0.12, 0.08, 0.04), texture=0.4, grain_m=0.4)),
    "gravel": (0.05, Material(albedo=(0.24, 0.225, 0.2), texture=0.2, grain_m=0.5)),
    "sand": (0.04, Material(albedo=(0.36, 0.29, 0.2), texture=0.1, grain_m=1.0)),
    "snow": (0.04, Material(albedo=(0.8, 0.81, 0.83), texture=0.05, grain_m=1.5)),
    "water": (0.02, Material(albedo=(0.02, 0.03, 0.033), gloss=0.02, roughness=0.1)),
}
FLOORS: tuple[Material, ...] = (
    Material(albedo=(0.3, 0.19, 0.1), gloss=0.03, roughness=0.15, texture=0.2, grain_m=0.3),
    Material(albedo=(0.19, 0.11, 0.055), gloss=0.03, roughness=0.15, texture=0.2, grain_m=0.3),
    Material(albedo=(0.42, 0.32, 0.21), gloss=0.03, roughness=0.2, texture=0.15, grain_m=0.3),
    Material(albedo=(0.45, 0.42, 0.38), gloss=0.04, roughness=0.08, texture=0.08, grain_m=0.6),
    Material(albedo=(0.25, 0.24, 0.23), gloss=0.03, roughness=0.15, texture=0.15, grain_m=0.8),
    Material(albedo=(0.2, 0.19, 0.19), texture=0.1, grain_m=0.5),
    Material(albedo=(0.16, 0.12, 0.1), texture=0.15, grain_m=0.5),
    Material(albedo=(0.3, 0.27, 0.24), texture=0.15, grain_m=0.5),
    Material(albedo=(0.08, 0.09, 0.13), texture=0.1, grain_m=0.5),
)
FURNITURE: tuple[tuple[float, float, float], ...] = (
    (0.3, 0.18, 0.09), (0.16, 0.09, 0.05), (0.45, 0.34, 0.22), (0.7, 0.69, 0.67),
    (0.04, 0.04, 0.045), (0.25, 0.25, 0.26), (0.35, 0.3, 0.24), (0.1, 0.13, 0.2),
    (0.3, 0.07, 0.06), (0.12, 0.18, 0.1), (0.4, 0.28, 0.08), (0.18, 0.13, 0.12),
)
# fmt: on
HOME_KELVIN = ((2700.0, 0.5), (3000.0, 0.25), (4000.0, 0.17), (5500.0, 0.08))
OFFICE_KELVIN = ((3000.0, 0.15), (3500.0, 0.2), (4000.0, 0.4), (5000.0, 0.15), (6500.0, 0.1))


@dataclass(frozen=True)
class Draw:
    """Draws of one place."""

    rng: np.random.Generator

    def uniform(self, low: Real, high: Real) -> float:
        return float(self.rng.uniform(low, high))

    def scale(self, low: Real, high: Real) -> float:
        """A positive number whose logarithm is uniform."""
        return math.exp(self.uniform(math.log(low), math.log(high)))

    def normal(self, mean: Real, spread: Real) -> float:
        return float(self.rng.normal(mean, spread))

    def chance(self, share: Real) -> bool:
        return bool(self.rng.random() < share)

    def count(self, low: int, high: int) -> int:
        """From ``low`` to ``high``, both included."""
        return int(self.rng.integers(low, high + 1))

    def one_of(self, shares: Triple) -> int:
        """An index, by weights."""
        weights = np.asarray(shares, float)
        return int(self.rng.choice(len(weights), p=weights / weights.sum()))

    def ground(self) -> tuple[str, Material]:
        """A ground's name, and itself lighter or darker by 0.2 (of the logarithm)."""
        name = list(GROUNDS)[self.one_of([share for share, _ in GROUNDS.values()])]
        return name, self.varied(GROUNDS[name][1])

    def varied(self, material: Material) -> Material:
        albedo = np.asarray(material.albedo) * math.exp(self.normal(0, 0.2))
        return replace(material, albedo=albedo.clip(0, 0.9))

    def floor(self) -> Material:
        return self.varied(FLOORS[self.count(0, len(FLOORS) - 1)])

    def furniture(self) -> Material:
        colour = FURNITURE[self.count(0, len(FURNITURE) - 1)]
        gloss = 0.04 if self.chance(0.3) else 0.0
        return self.varied(Material(albedo=colour, gloss=gloss, texture=0.1))

    def paint(self, bright: Real, spread: Real, *, vivid: Real = 0.12) -> Material:
        """A matt wall: mostly white to cream, ``vivid`` of them of a colour."""
        strong = self.chance(vivid)
        level = min(0.88, max(0.1, self.normal(bright * (0.7 if strong else 1), spread)))
        red = self.normal(0.0, 0.35) if strong else self.normal(0.05, 0.03)
        blue = self.normal(-0.1, 0.45) if strong else self.normal(-0.1, 0.06)
        colour = np.exp([red, 0.0, blue])
        albedo = (level * colour / (colour @ LUMINANCE)).clip(0.02, 0.9)
        return Material(albedo=albedo, texture=0.03, grain_m=1.0)

    def white(
        self, kelvins: Sequence[tuple[float, float]], *, tube: bool = False
    ) -> tuple[float, float, float]:
        """A lamp's colour of luminance 1; fluorescent tubes are a little green."""
        kelvin = kelvins[self.one_of([share for _, share in kelvins])][0]
        kelvin *= math.exp(self.normal(0, 0.04))
        green = self.normal(0.05, 0.04) if tube else self.normal(0.0, 0.02)
        return black_body(round(kelvin, -1), round(green, 2))


def lumens(colour: Triple, flux: Real, area: Real) -> np.ndarray:
    """Radiance of surfaces of ``area`` m2 that send ``flux`` lumens, Lambertian."""
    return np.asarray(colour) * flux / (math.pi * area * SUN_LUX)


def candelas(colour: Triple, intensity: Real) -> np.ndarray:
    """Intensity in the unit of scenes."""
    return np.asarray(colour) * intensity / SUN_LUX


def nits(colour: Triple, level: Real) -> np.ndarray:
    """Radiance of so many candelas per square metre."""
    return np.asarray(colour) * level / SUN_LUX
