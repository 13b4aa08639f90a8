"""
The partitions probe
====================

Walls divide the sphere into cells, and in each cell is one white face that is lit by it alone.
The brightness of that face is the light of that cell. With a handful of such numbers any mesh can
be lit, shadows and bounces included, by one product for each vertex.
"""

# %%
# Cells
# -----
# A design is a set of directions; what is closest to one of them is its cell. Even designs, and
# designs whose cells follow the sun's path over a day.

import torch
import trimesh
from matplotlib import pyplot as plt

from skylight._figures import show
from skylight.imaging._colour import tone_map
from skylight.imaging._metrics import shading_metrics
from skylight.probes.cameras._drawing import looking_at
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._picture import draw_cells
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions.relight._atlas import Receivers, refined
from skylight.probes.partitions.relight._composite import Relighting
from skylight.probes.partitions.relight._scene import Scene
from skylight.probes.partitions.relight._transfer import TransferSampling, transfer_coefficients
from skylight.skies._simulated import simulated_skies
from skylight.transport._cameras import Camera
from skylight.transport._path_tracer import DiffuseScene, Sampling, shade
from skylight.transport._render import rasterize

names = ("6d", "14d", "38d", "14d-outdoor")
cells = {name: Cells.of(named_design(name)) for name in names}
figure, axes = plt.subplots(2, 2, figsize=(9, 5))
for axis, name in zip(axes.flat, names, strict=True):
    show(
        axis,
        draw_cells(cells[name], size=240),
        f"{name}: {cells[name].count} cells, from two sides",
    )
figure.tight_layout()

# %%
# From shading to light
# ---------------------
# ``encode_map`` gives the shading that the faces of an ideal probe show under a map, and ``light``
# inverts shading to one radiance for each cell. For a printed probe, whose walls are not
# infinitely thin, the same module takes a matrix that was ray cast on the print
# (:doc:`../partition_probe`). Its albedo is a parameter that could be learned; here it is known.

((_, sky),) = simulated_skies(1, first_seed=7006)
light = sky.with_ground(torch.tensor([0.15, 0.14, 0.12])).rotate_azimuth(0.8).resize(64)
probes = {name: PartitionProbe(each, 0.8).requires_grad_(False) for name, each in cells.items()}
shading = {name: probe.encode_map(light) for name, probe in probes.items()}
seen = {name: probe.light(shading[name]) for name, probe in probes.items()}
white = float(light.radiance.quantile(0.98))
figure, axes = plt.subplots(2, 2, figsize=(10, 5.2))
for axis, name in zip(axes.flat, ("map", "6d", "14d", "38d"), strict=True):
    radiance = (
        light.radiance
        if name == "map"
        else seen[name][cells[name].cell_of(light.grid.directions)].reshape(light.radiance.shape)
    )
    show(axis, tone_map(radiance, white=white), name)
figure.tight_layout()

# %%
# A mesh and its transfer coefficients
# ------------------------------------
# ``t_i(x)`` is the radiance of a point x under unit light from cell i. It depends on the mesh and
# the cells, not on the light, so it is precomputed. Here: a knot on a ground.

knot = trimesh.creation.torus(0.5, 0.2, major_sections=48, minor_sections=24)
knot.apply_transform(trimesh.transformations.rotation_matrix(-0.3, [1, 0.6, 0]))
knot.apply_translation([0, -knot.bounds[0][1], 0])
ball = trimesh.creation.icosphere(3, 0.3)
ball.apply_translation([1.0, 0.3, 0.5])
white_paint = torch.full((3,), 0.8, dtype=torch.float64)
things = [
    Scene.of(
        torch.from_numpy(mesh.vertices.copy()),
        torch.from_numpy(mesh.faces.copy()).long(),
        white_paint,
    )
    for mesh in (knot, ball)
]
corners = 2.5 * torch.tensor([[-1.0, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]]).double()
ground = Scene.of(corners, torch.tensor([[0, 1, 2], [0, 2, 3]]), white_paint)
scene = Scene.joined([refined(ground, 0.12), *things])
print(f"{len(scene.vertices)} vertices, {len(scene.faces)} triangles")

# %%
# A camera looks at it; what it sees are the points to be lit.

pose = looking_at(torch.tensor([0.0, 2.2, 3.6]).double(), torch.tensor([0.1, 0.3, 0.0]).double())
placed = scene.placed(pose.matrix())
camera = Camera(focal_px=300, width=220, height=160, center_px=(110, 80))
picture = rasterize(camera, placed.vertices, placed.faces, placed.raycaster)
visible = Receivers.seen(picture, placed)
points = Receivers(
    positions=pose.inverse().points(visible.positions),
    normals=pose.inverse().directions(visible.normals),
    geometric_normals=pose.inverse().directions(visible.geometric_normals),
    albedo=visible.albedo,
)
sampling = TransferSampling(rays=256, bounces=3)
relightings = {
    name: Relighting(transfer_coefficients(scene, cells[name], points, sampling=sampling))
    for name in names
}

# %%
# Relighting
# ----------
# Relighting is one matrix product. The reference is path traced in the true
# map.

traced = shade(
    points.positions,
    points.normals,
    DiffuseScene.uniform(scene.vertices, scene.faces, 0.8),
    light,
    albedo=0.8,
    sampling=Sampling(samples=128, bounces=3),
    generator=torch.Generator().manual_seed(0),
).mean
pictures = {"path traced": picture.image(traced)} | {
    name: picture.image(relightings[name](seen[name])) for name in names
}
mask = picture.image(torch.ones(len(traced), 3))[..., 0] > 0
white = 1.4 * float(traced.quantile(0.97))
figure, axes = plt.subplots(2, 3, figsize=(11, 5.6))
for axis in axes.flat:
    axis.axis("off")
for axis, (name, image) in zip(axes.flat, pictures.items(), strict=False):
    show(axis, tone_map(image, white=white), name)
figure.tight_layout()
for name in names:
    scores = shading_metrics(pictures[name].float(), pictures["path traced"].float(), mask)
    print(name, {metric: round(value, 3) for metric, value in scores.items()})

# %%
# Under clouds a few cells suffice. A sun is harder: its position within a cell is not measured, so
# its shadow is soft and displaced, and ``14d-outdoor`` and the ``sun``
# designs lay their cells along its path for that. :doc:`../measurements` has the table over 22
# rooms and 18 sunny skies.
