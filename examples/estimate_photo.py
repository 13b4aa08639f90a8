"""The light of a photograph as a map for a renderer, and where its sun stands.

    python examples/estimate_photo.py portrait.jpg

The map is laid out for Blender, whose camera then looks the way the photographer's did.
"""

import math
import sys

import skylight
from skylight.sphere._frame import angles_from_direction

found = skylight.estimate(sys.argv[1], progress=lambda stage, share: print(f"{stage} {share:.0%}"))
azimuth, zenith = (math.degrees(angle) for angle in angles_from_direction(found.sun_direction))
print(f"brightest {azimuth:+.0f} degrees right of the camera's view, {zenith:.0f} from the zenith")
print(f"{found.status}; skin albedo {found.albedo.tolist()}", *found.advice, sep="\n")
skylight.write_environment_map("light.exr", found.environment, convention="blender")
