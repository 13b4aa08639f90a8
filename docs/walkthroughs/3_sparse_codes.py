"""
Light as a sparse code
======================

An environment map holds 25,000 numbers, most of them redundant. Spherical harmonics represent it
with few coefficients, but blur the sun. A sparse code is a sum of few lobes, each with a shape,
a rotation, a weight and a colour.
"""

# %%
# A map
# -----
# A synthetic room: a camera in the centre of a box with painted walls, a window and a lamp. These
# codes are best for indoor light. ``skylight code MAP`` does the following with a file.

import torch
from matplotlib import pyplot as plt

from skylight import SphericalSparseCoder
from skylight._figures import show
from skylight.imaging._colour import tone_map
from skylight.maps._sparse_codes import outlines
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, pixel_from_direction

directions = DirectionGrid.latlong(64, 128).directions
walls = torch.tensor([2.5, 1.3, 2.0]).double()  # metres to the side, up and ahead
distance, wall = (walls / directions.abs().clamp(min=1e-9)).min(1)
x, y, z = (directions * distance[:, None]).T
ceiling, floor = (wall == 1) & (y > 0), (wall == 1) & (y < 0)
window = (wall == 0) & (x > 0) & (y > -0.3) & (y < 0.9) & (z.abs() < 0.8)
lamp = ceiling & ((x + 1.2) ** 2 + (z + 0.8) ** 2 < 0.15)
radiance = torch.tensor([0.5, 0.45, 0.4]).repeat(len(directions), 1)
radiance[ceiling] = torch.tensor([0.7, 0.7, 0.7])
radiance[floor] = torch.tensor([0.25, 0.15, 0.1])
radiance[(wall == 0) & (x < 0)] = torch.tensor([0.4, 0.2, 0.15])
radiance[window] = torch.tensor([5.0, 6.5, 9.0])
radiance[lamp] = torch.tensor([12.0, 9.0, 5.0])
light = EnvironmentMap(radiance=radiance.reshape(64, 128, 3)).resize(32)
print(light.layout, f"{light.radiance.numel()} numbers")

# %%
# The code
# --------
# ``ani`` holds Gaussians of several widths, round and drawn out. Every filter is compared with
# what is left of the map at every place and at every rotation; the best is added, all weights are
# fitted again, and so on. ``path`` gives the code at several lengths on the way. (For batches of
# maps as tensors, to train with, call the coder itself.)

counts = [1, 2, 4, 8, 16, 32, 64]
coder = SphericalSparseCoder("ani", height=32, activations=max(counts))
codes = coder.path(light.radiance, counts)
for code in codes:
    print(f"{len(code):3} activations, {code.floats:4} numbers: error {code.relative_error:.3f}")

# %%
# Comparison with spherical harmonics
# -----------------------------------
# The error is relative and weighted by solid angle. Harmonics of degree n take ``3 (n + 1)^2``
# numbers; an activation takes four (three colours, and one word for position, twist and filter).
# Other dictionaries: ``iso`` has isotropic Gaussians only, ``vmf`` lobes of one width, ``box`` the
# filters of ``ani`` and boxes of pixels.

target = light.flat.double()
weight = light.grid.solid_angles[:, None]


def error(approximation):
    """Relative L2 error over solid angle."""
    return (
        float(((approximation - target).square() * weight).sum() / (target.square() * weight).sum())
        ** 0.5
    )


figure, axis = plt.subplots(figsize=(6.4, 3.8))
for name in ("ani", "iso", "vmf"):
    found = (
        codes
        if name == "ani"
        else SphericalSparseCoder(name, height=32, activations=64).path(light.radiance, counts)
    )
    axis.plot(
        [code.floats for code in found], [code.relative_error for code in found], "o-", label=name
    )
degrees = range(0, 9)
basis = {n: harmonics.evaluate(light.grid.directions, n) for n in degrees}
fits = [harmonics.project(target, light.grid, n, method="least_squares") for n in degrees]
axis.plot(
    [3 * (n + 1) ** 2 for n in degrees],
    [error(basis[n] @ fit) for n, fit in zip(degrees, fits, strict=True)],
    "s--",
    color="0.5",
    label="harmonics",
)
axis.set(xscale="log", xlabel="numbers", ylabel="relative error", ylim=(0, None))
axis.legend()
figure.tight_layout()

# %%
# The activations
# ---------------
# Each outline is an activation at half its height. The first ones make up the window and the lamp,
# the wide ones the walls. Negative values, from the ringing of sharp lobes about lights
# that are far brighter than their surroundings, are shown as black.

chosen = codes[counts.index(16)]
figure, axes = plt.subplots(3, 1, figsize=(8, 11))
white = 2.0
show(axes[0], tone_map(light.radiance, white=white), "The map")
show(
    axes[1],
    tone_map(coder.decode(chosen).detach().float().clamp(min=0), white=white),
    "16 activations",
)
show(
    axes[2],
    tone_map(coder.decode(codes[-1]).detach().float().clamp(min=0), white=white),
    "64 activations",
)
for outline in outlines(coder, chosen):
    if outline is None:
        continue
    row, column = pixel_from_direction(outline.around, *light.layout)
    jump = (column.diff().abs() > light.layout[1] / 2).nonzero()[:, 0] + 1
    for part_row, part_column in zip(
        torch.tensor_split(row, jump.tolist()),
        torch.tensor_split(column, jump.tolist()),
        strict=True,
    ):
        axes[1].plot(part_column, part_row, color="#e4572e", linewidth=1)
axes[1].set(xlim=(-0.5, light.layout[1] - 0.5), ylim=(light.layout[0] - 0.5, -0.5))
figure.tight_layout()

# %%
# Decoding at any resolution
# --------------------------
# A code is a function on the sphere, so it can be decoded at any size and rotated without
# resampling. Band limits, and sharper filters for finer maps, are described in
# :doc:`../sparse_coding`.

print(tuple(coder.decode(codes[-1], height=128).shape))
