"""
The voxel probe
===============

A face of a voxel is shaded according to where it looks and which neighbours stand round it: six
orientations, 32 arrangements, 192 kinds in all. A printed cross of seven cubes shows thirty of
them to a camera. The rest can be worked out, and then any voxel model can be drawn in that light
by looking up textures.
"""

# %%
# The probe and its slots
# -----------------------
# ``star_probe(3)`` is the cross: three cubes along each axis. Of its faces' 192 slots it has
# these. The picture of a slot is called a lightmap; all of them fit into one small image.

import numpy as np
import torch
from matplotlib import pyplot as plt

from skylight._figures import show
from skylight.evaluation._voxel_probe import ALBEDO, VoxelScene, baked
from skylight.imaging._colour import tone_map
from skylight.imaging._metrics import shading_metrics
from skylight.probes.voxel._interreflection import GlobalReconstruction
from skylight.probes.voxel._model import VoxelModel, exposed_faces, star_probe
from skylight.probes.voxel._reconstruct import DirectReconstruction
from skylight.skies._simulated import simulated_skies
from skylight.transport._path_tracer import Sampling

probe = exposed_faces(star_probe(3))
known = probe.counts() > 0
print(f"{len(probe)} faces, {int(known.sum())} of {known.numel()} slots")

# %%
# Capture
# -------
# Photographs of a printed probe give those slots (``skylight probe voxel capture``;
# :doc:`../voxel_probe` goes from the printer on). Here the photographs are left out: ``baked``
# path traces the shading of the faces, as a perfect capture, under a simulated sky whose sun is
# behind clouds.

((_, sky),) = simulated_skies(1, first_seed=7006)
light = sky.with_ground(torch.tensor([0.15, 0.14, 0.12])).resize(64)
captured = baked(3, light, Sampling(samples=128), seed=0)

# %%
# Completion
# ----------
# A face's direct light is a sum over five parts of its hemisphere, each of which a neighbour can
# take away. Five independent faces therefore determine all: a face under a ceiling, which the probe
# does not have, is ``4 none - left - right - forward - backward``. ``DirectReconstruction`` finds
# such sums; ``GlobalReconstruction`` includes interreflection, and matches transfer
# vectors in spherical harmonics (:doc:`../concepts/voxel_probe`).

direct = DirectReconstruction(known)
bounces = GlobalReconstruction(known, albedo=ALBEDO)
completed = {"direct": direct.complete(captured), "global": bounces.complete(captured)}


def sheet(lightmap):
    """12 rows of 16 slots: two rows for each orientation."""
    slots = lightmap.radiance.reshape(12, 16, *lightmap.radiance.shape[2:])
    return slots.permute(0, 2, 1, 3, 4).flatten(2, 3).flatten(0, 1)


white = float(completed["global"].radiance.quantile(0.98))
figure, axes = plt.subplots(1, 2, figsize=(11, 4.4))
show(axes[0], tone_map(sheet(captured), white=white), "Captured")
show(axes[1], tone_map(sheet(completed["global"]), white=white), "Completed")
figure.tight_layout()

# %%
# A relit model
# -------------
# A castle, made of 1,000 voxels or so (``skylight probe voxel render`` reads .vox files and
# meshes). Drawing it needs a look-up for each pixel, and no shadow rays, which makes it
# fast enough for video.

solid = np.zeros((17, 14, 17), dtype=bool)
solid[1:16, 0:6, 1:16] = True
solid[3:14, 0:6, 3:14] = False
solid[1:16:2, 6, 1:16:14] = solid[1:16:14, 6, 1:16:2] = True
for x in (0, 13):
    for z in (0, 13):
        solid[x : x + 4, 0:10, z : z + 4] = True
        solid[x : x + 4 : 3, 10, z : z + 4 : 3] = True
solid[7:10, 0:4, 1:3] = solid[7:10, 0:4, 14:16] = False
castle = VoxelScene.of(VoxelModel(occupied=solid))

# %%
# The same model path traced in the true light is the reference. Faces are looked up by their
# closest neighbours alone, so shadows of distant voxels are missing, as in the yard.

truth, masks, noise = castle.traced(light, Sampling(samples=64), seed=1)
drawn = {name: castle.drawn(lightmap) for name, lightmap in completed.items()}
white = 2 * float(truth[0][masks[0]].mean())
figure, axes = plt.subplots(1, 3, figsize=(12, 4.2))
for axis, (name, picture) in zip(
    axes, {"path traced": truth[0], **{k: v[0] for k, v in drawn.items()}}.items(), strict=True
):
    show(axis, tone_map(picture, white=white), name)
figure.tight_layout()

for name, pictures in drawn.items():
    scores = shading_metrics(pictures[0], truth[0], masks[0])
    print(name, {metric: round(value, 3) for metric, value in scores.items()})

# %%
# Over three models and eight lights the mean error is in :doc:`../measurements`, with those of the
# thesis.
