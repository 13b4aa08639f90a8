"""How a fitted head's normals may be wrong, by what its landmarks leave open.

Landmarks tell little of depth: how far cheekbones and chin stand out, or whether a head nods or
has another brow. About the fit's minimum, pose and shape have the covariance C of
:attr:`~skylight.faces._fit.FaceFit.covariance`, and the normals seen have N C N^T, N being their
derivatives. The leading eigenvectors are the ways in which the normals of a whole face err.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.sparse import bsr_array, csr_array
from torch import Tensor

from skylight.faces._fit import FIRST_OF_SHAPE, FaceFit
from skylight.faces._model import HeadModel
from skylight.transport._render import GBuffer

# Of 5.8 degrees by which normals err (root mean square over a face), these leave 1.7.
MODES = 20


@dataclass(frozen=True, kw_only=True)
class NormalErrorModes:
    """``modes`` (u,3,k): of some points the normals n_p + sum_k modes_pk z_k, z standard normal.

    Pose and shape are then off by L x with L L^T their covariance C and x = ``axes`` z, ``axes``
    (d,k) orthonormal: the same errors at other points are :func:`normal_changes` of x.
    """

    modes: Float[Tensor, "u 3 k"]
    axes: Float[Tensor, "d k"]


def normal_error_modes(
    model: HeadModel, fit: FaceFit, surface: GBuffer, points: Int[Tensor, " u"]
) -> NormalErrorModes | None:
    """How normals may be wrong at some of the G-buffer's pixels.

    The :data:`MODES` of the most variance there; None where the fit has no covariance.
    """
    if fit.covariance is None:
        return None
    seen = _SeenNormals.of(model, fit, surface, points)
    # of vertices in the head's own frame
    every = np.arange(len(model.mean))[:, None]
    rotation = _blocks(np.tile(fit.rotation, (len(every), 1, 1, 1)), every, len(every))
    by_vertices = seen.by_corners @ (seen.corners_by_vertices @ rotation)
    bases = (model.identity_basis, model.expression_basis)
    by_shape = np.concatenate([by_vertices @ _columns(basis) for basis in bases], 1)
    root = np.linalg.cholesky(fit.covariance)
    flat = by_shape @ root[FIRST_OF_SHAPE:] + _columns(seen.turned(root[:3]))
    axes = np.linalg.eigh(flat.T @ flat)[1][:, : -MODES - 1 : -1].copy()
    return NormalErrorModes(
        modes=torch.from_numpy((flat @ axes).reshape(len(points), 3, -1)).float(),
        axes=torch.from_numpy(axes).float(),
    )


def normal_changes(
    model: HeadModel,
    fit: FaceFit,
    surface: GBuffer,
    points: Int[Tensor, " u"],
    error: Float[Tensor, " d"],
) -> Float[Tensor, "u 3"]:
    """What is added to normals where pose and shape are off by L ``error``, L L^T = C."""
    assert fit.covariance is not None
    step = np.linalg.cholesky(fit.covariance) @ error.double().numpy()
    seen = _SeenNormals.of(model, fit, surface, points)
    shape = np.split(step[FIRST_OF_SHAPE:], [model.identity_basis.shape[2]])
    moved = (model.vertices(*shape) - model.mean) @ fit.rotation.T
    by_shape = seen.by_corners @ (seen.corners_by_vertices @ moved.ravel())
    return torch.from_numpy(by_shape.reshape(-1, 3) + seen.turned(step[:3, None])[..., 0])


def _columns(basis: Float[ndarray, "n 3 k"]) -> Float[ndarray, "n3 k"]:
    return basis.reshape(-1, basis.shape[2])


@dataclass(frozen=True, kw_only=True)
class _SeenNormals:
    """The unit ``normals`` of points on a mesh, and what moves them, as matrices of 3 x 3 blocks.

    ``by_corners`` (u,n) are the derivatives by the unit normals of vertices, and
    ``corners_by_vertices`` (n,n) those of these by the vertices' places.
    """

    normals: Float[ndarray, "u 3"]
    by_corners: bsr_array
    corners_by_vertices: bsr_array

    @staticmethod
    def of(
        model: HeadModel, fit: FaceFit, surface: GBuffer, points: Int[Tensor, " u"]
    ) -> "_SeenNormals":
        """Of some of the G-buffer's pixels."""
        triangles = model.faces[surface.faces[points].numpy()]
        normals, by_vertices = vertex_normal_derivatives(
            fit.vertices, model.faces[np.isin(model.faces, triangles).any(1)]
        )
        weights = surface.barycentric[points].numpy()
        mixed = np.einsum("pc,pcd->pd", weights, normals[triangles])
        length = np.linalg.norm(mixed, axis=1, keepdims=True)
        blocks = (weights / length)[..., None, None] * _across(mixed / length)[:, None]
        return _SeenNormals(
            normals=mixed / length,
            by_corners=_blocks(blocks, triangles, len(normals)),
            corners_by_vertices=by_vertices,
        )

    def turned(self, turns: Float[ndarray, "3 k"]) -> Float[ndarray, "u 3 k"]:
        """By turns of the whole: a rotation from the left by w turns n by w x n."""
        return np.cross(turns.T, self.normals[:, None]).transpose(0, 2, 1)


def vertex_normal_derivatives(
    vertices: Float[ndarray, "n 3"], faces: Int[ndarray, "f 3"]
) -> tuple[Float[ndarray, "n 3"], bsr_array]:
    """The unit normals of vertices, and their derivatives (3n,3n) by the vertices' places.

    Normals are those of :func:`skylight.transport._render.vertex_normals`. The angles that weight a
    vertex' faces are held, which on faces changes derivatives by 5 % (root mean square). A vertex
    without faces has zeros.
    """
    corners = vertices[faces]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    flat = np.cross(one, other)
    area = np.linalg.norm(flat, axis=1)[:, None]
    flat = flat / area
    # d (one x other), by the three corners
    by_corners = np.stack([_cross(other) - _cross(one), -_cross(other), _cross(one)], 1)
    by_corners = _across(flat)[:, None] @ by_corners / area[..., None, None]
    angles = np.stack([_angles(np.roll(corners, -i, axis=1)) for i in range(3)], 1)
    count = np.repeat(np.arange(len(faces)), 3)
    weigh = csr_array((angles.ravel(), (faces.ravel(), count)), (len(vertices), len(faces)))
    total = weigh @ flat
    length = np.linalg.norm(total, axis=1, keepdims=True).clip(1e-12)
    normals = total / length
    summed = bsr_array(
        (weigh.data[:, None, None] * np.eye(3), weigh.indices, weigh.indptr),
        shape=(3 * len(vertices), 3 * len(faces)),
    )
    every = np.arange(len(vertices))[:, None]
    unit = _blocks((_across(normals) / length[..., None])[:, None], every, len(vertices))
    return normals, unit @ (summed @ _blocks(by_corners, faces, len(vertices)))


def _blocks(
    blocks: Float[ndarray, "r c 3 3"], columns: Int[ndarray, "r c"], count: int
) -> bsr_array:
    """A matrix of as many 3 x 3 blocks in each row of blocks, ``count`` columns of blocks wide."""
    rows, each = columns.shape
    starts = np.arange(0, rows * each + 1, each)
    return bsr_array(
        (blocks.reshape(-1, 3, 3), columns.ravel(), starts), shape=(3 * rows, 3 * count)
    )


def _across(unit: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3 3"]:
    """What takes vectors to what of them is perpendicular to unit vectors."""
    return np.eye(3) - unit[:, :, None] * unit[:, None]


def _cross(vectors: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3 3"]:
    """What takes x to ``vectors`` x x."""
    return np.cross(vectors[:, None], np.eye(3)).transpose(0, 2, 1)


def _angles(corners: Float[ndarray, "f 3 3"]) -> Float[ndarray, " f"]:
    """Of triangles at their first corners."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    sine = np.linalg.norm(np.cross(one, other), axis=1)
    return np.arctan2(sine, np.einsum("fd,fd->f", one, other))
