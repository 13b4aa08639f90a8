"""Draw ``docs/images/compact_light.jpg``: a map, and its rest with the lamp that leaves it.

    python -m tools.draw_compact_light

The map is a simulated room, so that its lamp is known: it is printed beside the one found.
"""

import math
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot as plt

from skylight._figures import angles_deg
from skylight.imaging._preview import preview
from skylight.io._atomic import atomic_path
from skylight.places._simulated import simulate_place
from skylight.relight._compact import compact_lights
from skylight.relight._lamps import disc_diameter_rad
from skylight.sphere._frame import pixel_from_direction

OUT = Path(__file__).parents[1] / "docs" / "images" / "compact_light.jpg"
DAY, HEIGHT = 6, 256


def main() -> None:
    _, rendered = simulate_place(DAY, 0, HEIGHT)
    (known,) = rendered.lights
    light = rendered.map
    found = compact_lights(light, 1)
    (lamp,) = found.lamps
    print("put in:", angles_deg(known.direction), known.energy.tolist())
    print("found:", angles_deg(lamp.direction), lamp.irradiance.tolist())

    figure, axes = plt.subplots(1, 2, figsize=(10, 2.9), layout="constrained")
    shown = preview(light.radiance), preview(light.radiance, picture=found.rest.radiance)
    for axis, picture in zip(axes, shown, strict=True):
        axis.imshow(picture)
        axis.set_axis_off()
    axes[0].set_title("the map")
    wide = math.degrees(disc_diameter_rad(lamp.spread_rad))
    axes[1].set_title(f"the world, and a lamp {wide:.0f}° wide")
    row, column = pixel_from_direction(lamp.direction, *light.layout)
    axes[1].plot(float(column), float(row), "o", mfc="none", mec="#ff7f0e", ms=14, mew=2)
    with atomic_path(OUT) as temporary:
        figure.savefig(temporary, format="jpeg", dpi=100, pil_kwargs={"quality": 88})
    print(OUT)


if __name__ == "__main__":
    main()
