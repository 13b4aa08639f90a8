"""Weights of local deformation: the displacement of each vertex for each landmark."""

import igl
import numpy as np
import scipy.sparse as sp

from tools.head.assets import DECIMETRE
from tools.head.shape import Shape


def deformation_weights(shape: Shape, landmark: np.ndarray) -> sp.csr_matrix:
    """Bounded biharmonic weights of the 68 landmarks, (n, 68) sparse, each row summing to <= 1.

    Jacobson et al. 2011 on the skin as a surface (libigl's active set), not on the head's volume:
    lips and lids then move apart although they touch. Minimises each column's w' L M^-1 L w subject
    to 0 <= w <= 1, w = 1 at its landmark and 0 at the others. Skin more than 45 mm from every
    landmark is one fixed "rest" handle, whose weight, the missing part of a row's sum, holds still.
    Columns are normalised to a partition of unity afterwards, as is usual, and weights under 1e-3
    dropped. An eyeball takes the mean of its lids' displacements, the teeth the mean of the lips'.
    """
    skin = np.flatnonzero(shape.part == 0)
    number = np.full(len(shape.mean), -1)
    number[skin] = np.arange(len(skin))
    faces = number[shape.faces[(shape.part[shape.faces] == 0).all(axis=1)]]
    vertices = shape.mean[skin]
    mark = shape.mean[landmark]
    near = np.linalg.norm(vertices[:, None] - mark[None], axis=2).min(axis=1)
    rest = np.flatnonzero(near > 0.045)
    fixed = np.concatenate([number[landmark], rest])
    value = np.zeros((len(fixed), 69))
    value[np.arange(68), np.arange(68)] = 1
    value[68:, 68] = 1
    # Decimetres: the solver's thresholds are absolute.
    weights = igl.bbw(vertices / DECIMETRE, faces, fixed, value, max_iter=20).clip(0, 1)
    weights /= weights.sum(axis=1, keepdims=True)
    weights[weights < 1e-3] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    weights[fixed] = value

    dense = np.zeros((len(shape.mean), 68))
    dense[skin] = weights[:, :68]
    dense[np.ix_(shape.part == 1, np.arange(42, 48))] = 1 / 6
    dense[np.ix_(shape.part == 2, np.arange(36, 42))] = 1 / 6
    dense[np.ix_(shape.part == 3, np.arange(48, 68))] = 1 / 20
    return sp.csr_matrix(dense)
