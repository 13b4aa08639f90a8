"""
From a face to light
====================

One photograph of a person outdoors goes in, a high-dynamic-range map of the light comes out.
First a real photograph; then a rendered one, whose light is known, to see how far an estimate can
be trusted.
"""

# %%
# The photograph
# --------------
# A path would do as well: ``skylight.read_photo("portrait.jpg")`` reads JPEG, PNG, TIFF, EXR and
# HDR, undoes the tone curve that the file names, and notes which pixels are over-exposed. Here it
# is the portrait of the astronaut Eileen Collins that scikit-image installs (NASA, public domain).

import math
import tempfile
from pathlib import Path

import torch
from matplotlib import pyplot as plt
from skimage.data import astronaut

import skylight
from skylight._figures import relit, show, show_probe
from skylight.estimation._demo import score
from skylight.estimation._summary import draw_region, sure_of_the_sun
from skylight.faces._synthetic import render_face
from skylight.imaging._photo import photo_from_codes
from skylight.skies._simulated import simulated_skies
from skylight.sphere._frame import angles_from_direction
from skylight.transport._scene import evaluation_scene

photo = photo_from_codes(astronaut())
result = skylight.estimate_photo(photo)
estimate = result.estimate

# %%
# The estimate
# ------------
# ``environment`` is an environment map in the camera's frame: its centre is the viewing direction.
# ``sun_direction`` is its brightest direction, and ``posterior`` the uncertainty of that. The
# contour in the map bounds the smallest region with 90 % of the posterior.

azimuth, zenith = (math.degrees(angle) for angle in angles_from_direction(estimate.sun_direction))
print(f"brightest at azimuth {azimuth:+.0f} degrees, {zenith:.0f} from the zenith")
print(sure_of_the_sun(estimate.posterior))
print(estimate.verdict.summary, *estimate.advice, sep="\n")

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.6), width_ratios=(1, 2.4))
show(left, photo.encoded, "Photograph")
show_probe(right, estimate.environment, "Estimated light")
draw_region(right, estimate.posterior, estimate.environment.layout[0])
figure.tight_layout()

# %%
# This portrait was taken in a studio, under lamps, which the light of any place has too: check the
# verdict, the posterior and ``advice`` before using an estimate.
#
# Relit objects
# -------------
# Diffuse objects show low frequencies of the light, polished metal all of them.

scene = evaluation_scene(144, 32)
figure, axes = plt.subplots(1, 2, figsize=(9, 3.6))
for axis, picture, name in zip(
    axes, relit(scene, estimate.environment), ("Diffuse", "Metal"), strict=True
):
    show(axis, picture, name)
figure.tight_layout()

# %%
# Other programs
# --------------
# Files are written in the orientation of the other program. :doc:`../conventions` has drawings.

with tempfile.TemporaryDirectory() as folder:
    skylight.write_environment_map(
        Path(folder) / "for_blender.hdr", estimate.environment, convention="blender"
    )
    skylight.write_environment_map(Path(folder) / "probe.exr", estimate.environment)
    print(sorted(path.name for path in Path(folder).iterdir()))

# %%
# Known illumination
# ------------------
# A random head under a simulated sky that no model was trained on, with noise and 8-bit
# quantisation. Here the estimate can be compared with the truth.

(_, sky), *_ = simulated_skies(1, first_seed=5000, lowest_transmittance=0.8)
truth = render_face(sky, torch.tensor([0.22, 0.21, 0.18]), seed=2, size=320, azimuth_rad=-2.2)
found = skylight.estimate(truth.encoded)

strength = float(scene.shade(found.environment).mean() / scene.shade(truth.environment).mean())
shown = skylight.EnvironmentMap(radiance=found.environment.radiance / strength)
white = float(truth.environment.upper().radiance.quantile(0.98))
figure, axes = plt.subplots(2, 2, figsize=(11, 5.6), width_ratios=(1, 2.4))
show(axes[0, 0], truth.encoded, "The rendered photograph")
show_probe(axes[0, 1], truth.environment, "True light", white=white)
show(axes[1, 0], relit(scene, shown, like=truth.environment)[0], "Objects in the estimated light")
show_probe(axes[1, 1], shown, "Estimated light, scaled to the truth", white=white)
figure.tight_layout()

# %%
# The scores of the project, on one scene. Brightness and skin cannot be told apart by a picture
# alone (a prior over skin divides them), so the level may be off by what the albedo is: here the
# shading is ``strength`` times as bright.

print(f"strength {strength:.2f}")
for name, value in score(found.environment, truth.environment).items():
    print(f"{name:14} {value:.3f}")

# %%
# What these numbers are over 150 faces, with all that went wrong, is in :doc:`../measurements`;
# how an estimate comes about is told in :doc:`../concepts/inverse_lighting`.
