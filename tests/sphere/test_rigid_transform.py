"""Rigid transforms: the laws of a group, the exponential map, and gradients."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from skylight.errors import InputError
from skylight.sphere._rotation import RigidTransform

F64 = torch.float64
numbers = st.floats(-3, 3, allow_subnormal=False)
vectors = st.lists(numbers, min_size=6, max_size=6).map(lambda row: torch.tensor(row, dtype=F64))
transforms = vectors.map(RigidTransform.from_vector)


def close(a: RigidTransform, b: RigidTransform) -> None:
    torch.testing.assert_close(a.matrix(), b.matrix(), atol=1e-10, rtol=1e-10)


@settings(max_examples=30)
@given(transforms, transforms, transforms)
def test_group_laws(a: RigidTransform, b: RigidTransform, c: RigidTransform) -> None:
    one = RigidTransform.identity()
    close((a @ b) @ c, a @ (b @ c))
    close(a @ one, a)
    close(one @ a, a)
    close(a @ a.inverse(), one)
    close((a @ b).inverse(), b.inverse() @ a.inverse())


@settings(max_examples=30)
@given(transforms, transforms, st.lists(numbers, min_size=3, max_size=3))
def test_actions(a: RigidTransform, b: RigidTransform, row: list[float]) -> None:
    x = torch.tensor([row, [1.0, -2.0, 0.5]], dtype=F64)
    torch.testing.assert_close((a @ b).points(x), a.points(b.points(x)))
    homogeneous = torch.cat([x, torch.ones(2, 1, dtype=F64)], 1) @ a.matrix().T
    torch.testing.assert_close(a.points(x), homogeneous[:, :3])
    torch.testing.assert_close(a.directions(x[0] - x[1]), a.points(x[0]) - a.points(x[1]))
    np.testing.assert_allclose(a.points(x.numpy()), a.points(x).numpy(), rtol=0, atol=0)
    np.testing.assert_allclose(a.directions(x.numpy()), a.directions(x).numpy(), rtol=0, atol=0)


@settings(max_examples=30)
@given(transforms, st.lists(numbers, min_size=3, max_size=3))
def test_about_a_centre(a: RigidTransform, row: list[float]) -> None:
    centre = torch.tensor(row, dtype=F64)
    turned = a.about(centre)
    torch.testing.assert_close(turned.rotation, a.rotation)
    torch.testing.assert_close(turned.points(centre), centre + a.translation)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.01, 1.0, 3.0, np.pi - 1e-5])
def test_the_exponential_map_and_its_logarithm(angle: float) -> None:
    axes = np.random.default_rng(1).standard_normal((20, 3))
    turns = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    vector = torch.cat([torch.tensor(turns), torch.ones(20, 3, dtype=F64)], 1)
    found = RigidTransform.from_vector(vector)
    crosses = np.cross(np.eye(3), turns[:, None])
    np.testing.assert_allclose(found.rotation, expm(crosses), atol=1e-12)
    np.testing.assert_allclose(found.rotation, Rotation.from_rotvec(turns).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(found.vector(), vector, atol=1e-9)
    np.testing.assert_allclose(found.angle_deg, np.full(20, np.degrees(angle)), atol=1e-7)


@pytest.mark.parametrize("scale", [0.0, 1.0])
def test_gradients(scale: float) -> None:
    """At the identity too, where the angle has none."""
    generator = torch.Generator().manual_seed(2)
    vector = scale * torch.randn(2, 6, generator=generator, dtype=F64)
    x = torch.randn(2, 3, generator=generator, dtype=F64).requires_grad_()
    torch.autograd.gradcheck(
        lambda v, x: RigidTransform.from_vector(v).inverse().points(x), (vector.requires_grad_(), x)
    )
    torch.autograd.gradcheck(lambda v: RigidTransform.from_vector(v).vector(), vector)


def test_batches_broadcast_and_keep_single_precision() -> None:
    a = RigidTransform.from_vector(torch.randn(4, 6, generator=torch.Generator().manual_seed(3)))
    x = torch.randn(5, 1, 3, generator=torch.Generator().manual_seed(4))
    assert a.matrix().shape == (4, 4, 4)
    moved = a.points(x)
    assert moved.shape == (5, 4, 3)
    assert moved.dtype == torch.float32
    one = RigidTransform(rotation=a.rotation[2], translation=a.translation[2])
    torch.testing.assert_close(moved[:, 2], one.points(x[:, 0]))


@pytest.mark.parametrize(
    ("rotation", "shift", "told"),
    [
        (np.diag([1.0, 1.0, -1.0]), 0.0, "no mirror"),
        (2 * np.eye(3), 0.0, "orthonormal"),
        (np.full((3, 3), np.nan), 0.0, "orthonormal"),
        (np.eye(3), np.inf, "finite"),
    ],
)
def test_what_is_no_rigid_transform_is_refused(
    rotation: np.ndarray, shift: float, told: str
) -> None:
    with pytest.raises(InputError, match=told):
        RigidTransform.from_numpy(rotation, np.full(3, shift))
