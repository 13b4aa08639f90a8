"""Spheres to light."""

import numpy as np
import torch
import trimesh

from skylight.transport._cameras import Camera
from skylight.transport._rays import Raycaster
from skylight.transport._render import rasterize


def icosphere(subdivisions, centre=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return (
        torch.from_numpy(np.array(mesh.vertices)) + torch.tensor(centre).double(),
        torch.from_numpy(np.array(mesh.faces)),
    )


def seen_sphere(subdivisions, height=48):
    vertices, faces = icosphere(subdivisions, (0.0, 0.0, -4.0))
    camera = Camera(
        focal_px=1.8 * height, width=height, height=height, center_px=(height / 2, height / 2)
    )
    caster = Raycaster(vertices, faces)
    return rasterize(camera, vertices, faces, caster), caster
