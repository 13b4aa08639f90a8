"""A subdivided head mesh for rendering; the head model's vertices stay the ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray

from skylight.faces.model import HeadModel, Region
from skylight.transport.gbuffer import vertex_normals


@dataclass(frozen=True, kw_only=True)
class SmoothHead:
    """Every triangle in four: the n vertices of the model, then one per edge.

    ``belongs`` (r, m) is how far each of the m vertices belongs to each :class:`Region`;
    ``neutral`` the mean head, on which people are painted.
    """

    edges: Int[ndarray, "e 2"]
    faces: Int[ndarray, "f 3"]
    belongs: Float[ndarray, "r m"]
    neutral: Float[ndarray, "m 3"]

    @staticmethod
    @cache
    def load() -> SmoothHead:
        """Of the shipped head model; made once."""
        model = HeadModel.load()
        a, b, c = model.faces.T
        sides = np.sort(np.stack([model.faces, np.roll(model.faces, -1, 1)], -1), -1)
        edges, of_side = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
        ab, bc, ca = of_side.reshape(-1, 3).T + len(model.mean)
        faces = np.stack([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], 1).reshape(-1, 3)
        one_hot = (model.regions[None] == np.array(list(Region))[:, None]).astype(float)
        return SmoothHead(
            edges=edges,
            faces=faces,
            belongs=np.concatenate([one_hot, one_hot[:, edges].mean(-1)], 1),
            neutral=rounded(model.mean, model.faces, edges),
        )

    def points(self, vertices: Float[ndarray, "n 3"]) -> Float[ndarray, "m 3"]:
        """The finer head that goes through the model's ``vertices``."""
        return rounded(vertices, HeadModel.load().faces, self.edges)


def rounded(
    vertices: Float[ndarray, "n 3"], faces: Int[ndarray, "f 3"], edges: Int[ndarray, "e 2"]
) -> Float[ndarray, "m 3"]:
    """The vertices, then a point over the middle p of each edge, on the smooth surface.

    p - 1/4 sum_i <p - v_i, n_i> n_i over both ends: half way to the ends' tangent planes (Boubekeur
    & Alexa 2008, "Phong Tessellation"), which on a sphere is right to second order.
    """
    normals = normals_of(vertices, faces)
    ends, upright = vertices[edges], normals[edges]
    middle = ends.mean(1)
    above = ((middle[:, None] - ends) * upright).sum(-1, keepdims=True)
    return np.concatenate([vertices, middle - 0.25 * (above * upright).sum(1)])


def normals_of(
    vertices: Float[ndarray, "n 3"], faces: Int[ndarray, "f 3"]
) -> Float[ndarray, "n 3"]:
    """Unit vertex normals."""
    return vertex_normals(
        torch.from_numpy(np.array(vertices)), torch.from_numpy(np.array(faces))
    ).numpy()
