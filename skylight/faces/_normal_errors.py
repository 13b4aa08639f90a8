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
from scipy.sparse import csr_matrix
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
    each = _derivatives(model, fit, surface, points, np.linalg.cholesky(fit.covariance))
    flat = each.reshape(-1, each.shape[2])
    axes = np.linalg.eigh(flat.T @ flat)[1][:, : -MODES - 1 : -1].copy()
    return NormalErrorModes(
        modes=torch.from_numpy(each @ axes).float(), axes=torch.from_numpy(axes).float()
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
    along = np.linalg.cholesky(fit.covariance) @ error.double().numpy()[:, None]
    return torch.from_numpy(_derivatives(model, fit, surface, points, along)[:, :, 0])


def _derivatives(
    model: HeadModel,
    fit: FaceFit,
    surface: GBuffer,
    points: Int[Tensor, " u"],
    along: Float[ndarray, "d k"],
) -> Float[ndarray, "u 3 k"]:
    """Of unit normals at points, by steps along the columns of ``along`` in pose and shape."""
    triangles = model.faces[surface.faces[points].numpy()]
    shape = np.concatenate([model.identity_basis, model.expression_basis], 2)
    normals, turned = vertex_normal_derivatives(
        fit.vertices,
        model.faces[np.isin(model.faces, triangles).any(1)],
        np.einsum("nck,dc->ndk", shape @ along[FIRST_OF_SHAPE:], fit.rotation),
    )
    # a rotation from the left by w turns n by w x n
    turned += np.cross(along[:3].T, normals[:, None]).transpose(0, 2, 1)
    weights, seen = surface.barycentric[points].numpy(), surface.normals[points].numpy()
    length = np.linalg.norm(np.einsum("pc,pcd->pd", weights, normals[triangles]), axis=1)
    mixed = np.einsum("pc,pcdk->pdk", weights / length[:, None], turned[triangles])
    return _across(seen, mixed)


def vertex_normal_derivatives(
    vertices: Float[ndarray, "n 3"],
    faces: Int[ndarray, "f 3"],
    moved: Float[ndarray, "n 3 k"],
) -> tuple[Float[ndarray, "n 3"], Float[ndarray, "n 3 k"]]:
    """The unit normals of vertices, and their derivatives by displacements ``moved``.

    Normals are those of :func:`skylight.transport._render.vertex_normals`. The angles that weight a
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
