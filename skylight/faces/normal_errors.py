"""How a fitted head's normals may be wrong, by what its landmarks leave open.

Landmarks tell little of depth: how far cheekbones and chin stand out, or whether a head nods or
has another brow. About the fit's minimum, pose and shape have the covariance C of
:attr:`~skylight.faces.fit.FaceFit.covariance`, and the normals seen have N C N^T, N being their
derivatives. The leading eigenvectors are the ways in which the normals of a whole face err.
"""

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.sparse import csr_matrix
from torch import Tensor

from skylight.faces.fit import FIRST_OF_SHAPE, FaceFit
from skylight.faces.model import HeadModel
from skylight.transport.gbuffer import GBuffer

# Of 5.8 degrees by which normals err (root mean square over a face), these leave 1.7.
MODES = 20


def normal_error_modes(
    model: HeadModel, fit: FaceFit, surface: GBuffer, points: Int[Tensor, " u"]
) -> Float[Tensor, "u 3 k"] | None:
    """M with n_p + sum_k M_pk z_k the normals at some of the G-buffer's pixels, z standard
    normal.

    The :data:`MODES` of the most variance; None where the fit has no covariance.
    """
    if fit.covariance is None:
        return None
    root = np.linalg.cholesky(fit.covariance)
    triangles = model.faces[surface.faces[points].numpy()]
    shape = np.concatenate([model.identity_basis, model.expression_basis], 2)
    normals, turned = vertex_normal_derivatives(
        fit.vertices,
        model.faces[np.isin(model.faces, triangles).any(1)],
        np.einsum("nck,dc->ndk", shape, fit.rotation),
    )
    # a rotation from the left by w turns n by w x n
    by_rotation = np.cross(np.eye(3), normals[:, None]).transpose(0, 2, 1)
    weights, seen = surface.barycentric[points].numpy(), surface.normals[points].numpy()
    length = np.linalg.norm(np.einsum("pc,pcd->pd", weights, normals[triangles]), axis=1)
    weights = weights / length[:, None]
    derivative = np.zeros((*seen.shape, len(root)))
    derivative[:, :, :3] = np.einsum("pc,pcdk->pdk", weights, by_rotation[triangles])
    derivative[:, :, FIRST_OF_SHAPE:] = np.einsum("pc,pcdk->pdk", weights, turned[triangles])
    each = _across(seen, derivative).reshape(-1, len(root)) @ root
    _, vectors = np.linalg.eigh(each.T @ each)
    modes = each @ vectors[:, : -MODES - 1 : -1]
    return torch.from_numpy(modes.reshape(*seen.shape, -1)).float()


def vertex_normal_derivatives(
    vertices: Float[ndarray, "n 3"],
    faces: Int[ndarray, "f 3"],
    moved: Float[ndarray, "n 3 k"],
) -> tuple[Float[ndarray, "n 3"], Float[ndarray, "n 3 k"]]:
    """The unit normals of vertices, and their derivatives by displacements ``moved``.

    Normals are those of :func:`skylight.transport.gbuffer.vertex_normals`. The angles that weight a
    vertex' faces are held, which on faces changes derivatives by 5 % (root mean square). A vertex
    without faces has zeros.
    """
    corners, shift = vertices[faces], moved[faces]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    flat = np.cross(one, other)
    area = np.linalg.norm(flat, axis=1)[:, None]
    flat = flat / area
    by_flat = np.cross(shift[:, 1] - shift[:, 0], other[..., None], axis=1)
    by_flat += np.cross(one[..., None], shift[:, 2] - shift[:, 0], axis=1)
    by_flat = _across(flat, by_flat) / area[..., None]
    angles = np.stack([_angles(np.roll(corners, -i, axis=1)) for i in range(3)], 1)
    count = np.repeat(np.arange(len(faces)), 3)
    weigh = csr_matrix((angles.ravel(), (faces.ravel(), count)), (len(vertices), len(faces)))
    total = weigh @ flat
    length = np.linalg.norm(total, axis=1, keepdims=True).clip(1e-12)
    normals = total / length
    by_total = (weigh @ by_flat.reshape(len(faces), -1)).reshape(len(vertices), 3, -1)
    return normals, _across(normals, by_total) / length[..., None]


def _across(unit: Float[ndarray, "n 3"], x: Float[ndarray, "n 3 k"]) -> Float[ndarray, "n 3 k"]:
    """What of x is perpendicular to unit vectors."""
    return x - unit[..., None] * np.einsum("nd,ndk->nk", unit, x)[:, None]


def _angles(corners: Float[ndarray, "f 3 3"]) -> Float[ndarray, " f"]:
    """Of triangles at their first corners."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    sine = np.linalg.norm(np.cross(one, other), axis=1)
    return np.arctan2(sine, np.einsum("fd,fd->f", one, other))
