"""Reflectances and lamps' colours that places are made of.

Reflectances are those of samples of the USGS Spectral Library, version 7 (Kokaly et al. 2017, U.S.
Geological Survey Data Series 1035, in the public domain), whose names stand beside them: linear
Rec.709 by the observer of 1931 under a black body's light of 6504 K. A thing's colour lies between
two samples of its kind, in the logarithm, and is lighter or darker by 0.2.

Ceilings and walls are paint instead, in and a little below the ranges of reflectance that EN
12464-1 recommends (ceilings 0.7 to 0.9, walls 0.5 to 0.8), nearly all of them white to cream.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skylight.places._scene import SUN_LUX, Material, Real, Triple, black_body
from skylight.sphere._envmap import LUMINANCE

MOST = 0.9  # albedo
Samples = tuple[tuple[float, float, float], ...]
# fmt: off
LAWN = (0.060, 0.081, 0.029)  # Lawn_Grass_GDS91_green
GOLDEN_GRASS = (0.220, 0.159, 0.080)  # Grass_Golden_Dry_GDS480
OLD_ASPHALT = (0.103, 0.084, 0.066)  # Asphalt_GDS376_Blck_Road_old
DARK_SHINGLE = (0.099, 0.100, 0.093)  # Asphalt_Shingle_GDS367_DkGry
TAR = (0.025, 0.025, 0.026)  # Asphalt_Tar_GDS346_Blck_Roof
OLD_TAR_PAPER = (0.055, 0.047, 0.040)  # Tar_Paper_GDS285B_Weath_Blk
ROAD_CONCRETE = (0.322, 0.282, 0.215)  # Concrete_GDS375_Lt_Gry_Road
CONCRETE = (0.559, 0.517, 0.444)  # Concrete_WTC01-37A
GREY_BRICK = (0.241, 0.226, 0.199)  # Brick_GDS354_Building_Lt_Gry
BROWN_PAVING = (0.137, 0.107, 0.091)  # Brick_GDS348_Pave_DkBrwngrey
GREY_PAVING = (0.079, 0.073, 0.068)  # Brick_GDS355_Paving_Dk_Gry
TAN_PAVING = (0.182, 0.099, 0.054)  # Brick_GDS347_Paving_Tan
RED_PAVING = (0.178, 0.073, 0.052)  # Brick_GDS349_Paving_Red
RED_BRICK = (0.252, 0.103, 0.072)  # Brick_GDS353_Building_MedRed
DARK_BRICK = (0.161, 0.071, 0.053)  # Brick_GDS350_Dk_Red_Building
OLD_BASALT = (0.146, 0.127, 0.101)  # Basalt_weathered_BR93-43
NEW_CEDAR = (0.224, 0.102, 0.041)  # Cedar_Shake_GDS357_Fresh
CEDAR = (0.199, 0.117, 0.060)  # Cedar_Shake_GDS358_SlgWeathr
BROWN_CEDAR = (0.128, 0.087, 0.055)  # Cedar_Shake_GDS359_MedWeathr
OLD_CEDAR = (0.152, 0.125, 0.095)  # Cedar_Shake_GDS361_HiWeather
PINE = (0.445, 0.322, 0.210)  # Wood_Beam_GDS363_Nw_Pine_2X4
PLYWOOD = (0.523, 0.312, 0.182)  # Plywood_GDS365_Fresh_Pine
WHITE_PLASTIC = (0.775, 0.785, 0.759)  # Plastic_HDPE_GDS384_Wht_Opaq
WHITE_PVC = (0.674, 0.664, 0.605)  # Plastic_PVC_GDS338_White
BLACK_PLASTIC = (0.023, 0.024, 0.026)  # Plastic_ABS_GDS341_BlackPipe
GREY_CARPET = (0.080, 0.079, 0.080)  # Nylon_Carpet_GDS536_Gry_Pile
BROWN_CARPET = (0.200, 0.094, 0.056)  # Nylon_Carpet_GDS535_LtBrown
BURLAP = (0.212, 0.147, 0.068)  # Burlap_Fabric_GDS430_Brown
COTTON = (0.618, 0.595, 0.614)  # Cotton_Fabric_GDS437_White
ZINC = (0.271, 0.292, 0.297)  # Sheet_Metal_GDS352_crg_Galvn
LIGHT_PAINT = (0.531, 0.516, 0.454)  # Painted_Aluminum_GDS333_LgGr
DEAD_WILLOW = (0.196, 0.118, 0.060)  # Willow_Dead_FluvTailSite_A
MARSH_WRACK = (0.122, 0.089, 0.054)  # Marsh_wrack_DWV3-0511_dryNPV

GROUNDS: dict[str, tuple[float, Samples, Material]] = {  # (its share, samples, the rest of it)
    "grass": (0.2, (LAWN, LAWN, (0.155, 0.142, 0.065)),  # Grass_dry.4+.6green_AMX27
              Material(albedo=LAWN, texture=0.3, grain_m=0.8)),
    "dry grass": (0.07, (GOLDEN_GRASS, (0.136, 0.098, 0.066),  # Cheatgrass_ANPC1_field_calib
                         (0.249, 0.203, 0.102)),  # Grass_dry.8+.2green_AMX31
                  Material(albedo=GOLDEN_GRASS, texture=0.3, grain_m=0.8)),
    "asphalt": (0.15, (OLD_ASPHALT, DARK_SHINGLE, GREY_PAVING, OLD_TAR_PAPER),
                Material(albedo=OLD_ASPHALT, texture=0.12, grain_m=2.0)),
    "wet asphalt": (0.03, (TAR, OLD_TAR_PAPER),
                    Material(albedo=TAR, gloss=0.03, roughness=0.12, texture=0.3, grain_m=2.0)),
    "concrete": (0.09, (ROAD_CONCRETE, CONCRETE, GREY_BRICK),
                 Material(albedo=ROAD_CONCRETE, texture=0.12, grain_m=1.5)),
    "paving": (0.12, (GREY_BRICK, BROWN_PAVING, GREY_PAVING, ROAD_CONCRETE, TAN_PAVING),
               Material(albedo=GREY_BRICK, texture=0.2, grain_m=0.7)),
    "brick": (0.03, (RED_PAVING, TAN_PAVING, BROWN_PAVING, RED_BRICK),
              Material(albedo=RED_PAVING, texture=0.2, grain_m=0.5)),
    "planks": (0.02, (OLD_CEDAR, BROWN_CEDAR, CEDAR),
               Material(albedo=OLD_CEDAR, texture=0.2, grain_m=0.3)),
    "soil": (0.06, ((0.174, 0.146, 0.102),  # Marsh_sediment_DWV3-0511_dry
                    (0.146, 0.105, 0.059),  # Phlogopite_Sand_Mix_BR93-20
                    (0.473, 0.337, 0.205),  # Stonewall_Playa_CU93-52A
                    (0.040, 0.032, 0.026)),  # BurnArea_Traverse_WRF00-01
             Material(albedo=MARSH_WRACK, texture=0.3, grain_m=0.8)),
    "leaves": (0.05, (DEAD_WILLOW, MARSH_WRACK,
                      (0.201, 0.111, 0.048),  # Lodgepole-Pine_LP-Needles-2
                      (0.095, 0.061, 0.031)),  # LeafySpurge_Spurge-A1-Oct97
               Material(albedo=MARSH_WRACK, texture=0.4, grain_m=0.4)),
    "gravel": (0.05, (OLD_BASALT, ROAD_CONCRETE, (0.177, 0.156, 0.123)),  # Pyroxene_Basalt
               Material(albedo=OLD_BASALT, texture=0.2, grain_m=0.5)),
    "sand": (0.05, ((0.278, 0.240, 0.173),  # Sand_GrndIsle1_no_oil
                    (0.261, 0.214, 0.149),  # Sand_DWO-3-DEL2ar1_no_oil
                    (0.188, 0.143, 0.089),  # Sand_DWO-3-DEL2a_no_vis.oil
                    (0.495, 0.352, 0.221)),  # Stonewall_Playa_Dry_Mud_2001
             Material(albedo=ROAD_CONCRETE, texture=0.1, grain_m=1.0)),
    "snow": (0.05, ((0.827, 0.832, 0.833), (0.719, 0.723, 0.721),  # Melting_snow_mSnw01a, 03
                    (0.625, 0.628, 0.622)),  # 05
             Material(albedo=WHITE_PLASTIC, texture=0.05, grain_m=1.5)),
    "water": (0.03, ((0.027, 0.037, 0.030),  # Seawater_Coast_Chl_SW1
                     (0.019, 0.026, 0.046),  # Seawater_Open_Ocean_SW2_lwch
                     (0.057, 0.066, 0.072)),  # Water+Montmor_SWy-2+0.50g-l
              Material(albedo=TAR, gloss=0.02, roughness=0.1)),
}
CROWNS: Samples = (
    (0.052, 0.079, 0.031), (0.050, 0.071, 0.032),  # Maple_Leaves_DW92-1, Aspen_Leaf-A_DW92-2
    (0.126, 0.148, 0.091), (0.117, 0.138, 0.050),  # Oak_Oak-Leaf-1_fresh, Walnut_Leaf_SUN
    (0.076, 0.091, 0.038), (0.081, 0.104, 0.050),  # Pinon_Pine_ANP92-14A, Engelmann-Spruce
)
BARK: Samples = (OLD_CEDAR, BROWN_CEDAR, (0.068, 0.066, 0.035))  # Gray-Pine_CA01-PISA-1_branch
FLOORS: tuple[tuple[float, Samples, Material], ...] = (  # (its share, samples, the rest of it)
    (0.4, (PINE, PLYWOOD, NEW_CEDAR, CEDAR, BROWN_CEDAR),
     Material(albedo=PINE, gloss=0.03, roughness=0.15, texture=0.2, grain_m=0.3)),
    (0.3, (CONCRETE, ROAD_CONCRETE, GREY_BRICK, WHITE_PVC, GREY_PAVING),
     Material(albedo=CONCRETE, gloss=0.04, roughness=0.12, texture=0.1, grain_m=0.6)),
    (0.3, (GREY_CARPET, BROWN_CARPET, BURLAP, ROAD_CONCRETE, GREY_BRICK),
     Material(albedo=GREY_CARPET, texture=0.12, grain_m=0.5)),
)
FACADES: tuple[Samples, ...] = (
    (RED_BRICK, DARK_BRICK, TAN_PAVING), (CONCRETE, ROAD_CONCRETE, GREY_BRICK),
    (CEDAR, BROWN_CEDAR, OLD_CEDAR), (LIGHT_PAINT, WHITE_PVC, ZINC),
)
FURNITURE: tuple[Samples, ...] = (
    (PINE, PLYWOOD, NEW_CEDAR, CEDAR, BROWN_CEDAR), (WHITE_PLASTIC, LIGHT_PAINT, COTTON),
    (BLACK_PLASTIC, GREY_CARPET, ZINC), (BURLAP, BROWN_CARPET, COTTON, GREY_CARPET),
)
DYED: Samples = (
    (0.301, 0.018, 0.035), (0.032, 0.202, 0.118),  # Nylon_Fabric_GDS431_Red, GDS432_Grn
    (0.028, 0.134, 0.425), (0.009, 0.041, 0.028),  # GDS433_Blu, Polyester_Pile_GDS435_DkGrn
    (0.495, 0.464, 0.363), (0.078, 0.075, 0.034),  # Terrycloth_GDS537_Yel, Nylon_GDS428_OlvDrab
    (0.522, 0.057, 0.100), (0.193, 0.455, 0.508),  # Plastic_Vinyl_GDS398_Red, Pipe_GDS344_Blue
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

    def between(self, samples: Samples) -> np.ndarray:
        """An albedo between two of the samples, lighter or darker by 0.2."""
        one, other = (np.log(samples[self.count(0, len(samples) - 1)]) for _ in range(2))
        mixed = one + self.uniform(0, 1) * (other - one)
        albedo = np.exp(mixed + self.normal(0, 0.2))
        return albedo * min(1.0, MOST / albedo.max())

    def made_of(self, samples: Samples, like: Material) -> Material:
        return replace(like, albedo=self.between(samples))

    def ground(self, name: str | None = None) -> tuple[str, Material]:
        """A ground's name, and itself."""
        name = name or list(GROUNDS)[self.one_of([share for share, _, _ in GROUNDS.values()])]
        _, samples, like = GROUNDS[name]
        return name, self.made_of(samples, like)

    def floor(self) -> Material:
        _, samples, like = FLOORS[self.one_of([share for share, _, _ in FLOORS])]
        return self.made_of(samples, like)

    def furniture(self) -> Material:
        dyed = self.chance(0.12)
        albedo = self.between(DYED if dyed else FURNITURE[self.one_of([0.35, 0.25, 0.2, 0.2])])
        return Material(albedo=albedo, gloss=0.04 if self.chance(0.3) else 0.0, texture=0.1)

    def facade(self) -> Material:
        """The outside of a house: brick, stone, wood or metal, or plaster."""
        if self.chance(0.4):
            return self.paint(0.5, 0.15, vivid=0.1)
        albedo = self.between(FACADES[self.count(0, len(FACADES) - 1)])
        return Material(albedo=albedo, texture=0.12, grain_m=0.8)

    def paint(self, bright: Real, spread: Real, *, vivid: Real = 0.05) -> Material:
        """A matt wall: mostly white to cream; ``vivid`` of them ochre to red, or teal to blue."""
        strong = self.chance(vivid)
        level = min(0.88, max(0.1, self.normal(bright * (0.7 if strong else 1), spread)))
        warm = self.normal(0.0, 0.5) if strong else self.normal(0.1, 0.06)  # of log R / B
        green = self.normal(0.0, 0.1) if strong else self.normal(0.01, 0.01)
        colour = np.exp([0.45 * warm, green, -0.55 * warm])
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
