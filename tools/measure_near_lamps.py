"""What it costs to take a lamp in a room for a distant light.

    python -m tools.measure_near_lamps

Heads of random people, matt, are rendered by Mitsuba under a sphere that seen from the middle of
the face has a radius of 5 degrees, at several distances d, and at 1 km. How bright the light is
does not count, since a picture does not tell: shading s_d is scaled to the mean of the distant one,
s. The error is ::

    sqrt(mean_p (s_d mean(s) / mean(s_d) - s)^2) / mean(s)

over the pixels p of bare skin, before an estimate explains a part of it by other distant light.
"""

import argparse
import math

import numpy as np
from jaxtyping import Bool, Float

from skylight.people._independent_render import IndependentScene, Solid, SphereLamp
from skylight.people._light import RenderOptions
from skylight.people._people import Person, bare_skin, person, seen_parts
from skylight.people._skin import SmoothHead

DISTANCES_M = (0.5, 1.0, 2.0, 4.0, 8.0)
FAR_M = 1000.0
RADIUS_RAD = math.radians(5)
# azimuth from the camera's side to the picture's right, and elevation, degrees
LAMPS = {"above the camera": (0, 35), "half to the side": (45, 30), "beside": (90, 0)}
ALBEDO = 0.3  # of skin, for the light that it throws onto itself
OPTIONS = RenderOptions(size=96)
FOCAL = 2.0


def shading(
    who: Person, azimuth_deg: float, elevation_deg: float, distance_m: float, samples: int
) -> Float[np.ndarray, "h w"]:
    """The head under a lamp at ``distance_m`` from the middle of the face."""
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    towards = np.array([math.cos(e) * math.sin(a), math.sin(e), math.cos(e) * math.cos(a)])
    lamp = SphereLamp(
        centre=who.points[bare_skin()].mean(0) + distance_m * towards,
        radius=distance_m * math.sin(RADIUS_RAD),
        radiance=1.0,
    )
    head = Solid(vertices=who.points, triangles=SmoothHead.load().faces, albedo=ALBEDO)
    scene = IndependentScene([head], lamp)
    pose = np.eye(3), np.zeros(3)
    return scene.radiance(who.truth.camera, *pose, samples=samples).mean(-1)


def relative_error(
    near: Float[np.ndarray, "h w"], far: Float[np.ndarray, "h w"], skin: Bool[np.ndarray, "h w"]
) -> float:
    """RMS of ``near``, scaled to the mean of ``far``, less ``far``, over that mean."""
    s_d, s = near[skin].astype(float), far[skin].astype(float)
    return float(np.sqrt(np.mean((s_d * s.mean() / s_d.mean() - s) ** 2)) / s.mean())


def main() -> None:
    parser = argparse.ArgumentParser(description="the cost of distant light where lamps are near")
    parser.add_argument("--people", type=int, default=6)
    parser.add_argument("--samples", type=int, default=256)
    options = parser.parse_args()
    errors: dict[tuple[float, str], list[float]] = {}
    for number in range(options.people):
        who = person(number, FOCAL, OPTIONS)
        skin = seen_parts(who).bare
        for name, angles in LAMPS.items():
            far = shading(who, *angles, FAR_M, options.samples)
            for distance in DISTANCES_M:
                near = shading(who, *angles, distance, options.samples)
                errors.setdefault((distance, name), []).append(relative_error(near, far, skin))
    print("| distance | " + " | ".join(LAMPS) + " |\n" + "|---" * (1 + len(LAMPS)) + "|")
    for distance in DISTANCES_M:
        cells = [f"{100 * np.mean(errors[distance, name]):.1f} %" for name in LAMPS]
        print(f"| {distance:g} m | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
