"""Transfer vectors: analytic ones, the path tracer's, and the symmetries of the square."""

import math

import pytest
import torch

from skylight.errors import InputError
from skylight.probes.voxel._interreflection import slot_transfer, transfer_vectors
from skylight.probes.voxel._model import NORMALS
from skylight.sphere import _harmonics as harmonics
from skylight.transport._path_tracer import DiffuseScene, Sampling, radiosity_transfer
from tests.probes.voxel.shapes import face_among

LEFT, RIGHT, FORWARD, BACKWARD, TOP = 1, 2, 4, 8, 16


def test_a_free_face_has_the_coefficients_of_the_cosine_in_every_orientation() -> None:
    """t_lm = albedo A_l Y_lm(n) / pi (Ramamoorthi and Hanrahan 2001)."""
    vectors = transfer_vectors(0.6, size=3)
    normals = torch.from_numpy(NORMALS).double()
    lobe = harmonics.cosine_coefficients(4)[harmonics.bands(4)]
    expected = 0.6 / math.pi * lobe * harmonics.evaluate(normals, 4)
    for texel in vectors[:, 0].flatten(1, 2).unbind(1):
        torch.testing.assert_close(texel, expected, atol=2e-5, rtol=0)


def test_a_closed_cell_is_dark_and_an_open_white_one_loses_no_light() -> None:
    vectors = slot_transfer(1.0, size=4)
    assert not vectors[31].any()
    # albedo 1 in white light is white wherever light comes in: the furnace
    white = vectors[:31, ..., 0] * math.sqrt(4 * math.pi)
    torch.testing.assert_close(white, torch.ones_like(white), atol=2e-3, rtol=0)


def test_a_half_turn_of_the_square_turns_pictures_and_light() -> None:
    vectors = slot_transfer(0.8, size=6)
    m = harmonics.orders(4)
    sign = torch.where(m % 2 == 0, 1.0, -1.0)  # cos m (phi + pi)
    for here, there in ((LEFT, RIGHT), (FORWARD | LEFT, BACKWARD | RIGHT), (TOP, TOP)):
        turned = vectors[here].rot90(2) * sign
        torch.testing.assert_close(turned, vectors[there], atol=1e-10, rtol=0)


def test_row_0_lies_forward_and_column_0_left() -> None:
    constant = slot_transfer(0.5, size=4)[..., 0]
    assert (constant[FORWARD, 0] < constant[FORWARD, 3]).all()
    assert (constant[LEFT, :, 0] < constant[LEFT, :, 3]).all()


def test_bad_input_is_named() -> None:
    with pytest.raises(InputError, match="albedo"):
        slot_transfer(1.2)
    with pytest.raises(InputError, match="size"):
        slot_transfer(0.5, size=0)


@pytest.mark.parametrize(
    ("orientation", "configuration"),
    [*((o, LEFT | FORWARD | TOP) for o in range(6)), (2, LEFT), (2, FORWARD | TOP), (2, 15)],
)
def test_the_path_tracer_finds_the_same(orientation: int, configuration: int) -> None:
    """In geometry that is built in the world: no frame is trusted."""
    faces, number = face_among(orientation, configuration)
    size = 4
    points = faces.points(size)[number].reshape(-1, 3)
    normal = torch.from_numpy(NORMALS[orientation]).double()
    traced = radiosity_transfer(
        points,
        normal.expand(len(points), 3),
        DiffuseScene.uniform(*faces.triangles(), 0.8),
        degree=4,
        albedo=0.8,
        sampling=Sampling(samples=2048),
        generator=torch.Generator().manual_seed(orientation),
    )
    expected = transfer_vectors(0.8, size=size)[orientation, configuration].reshape(-1, 25)
    difference = (traced.mean - expected).square().mean().sqrt()
    noise = traced.standard_error.square().mean().sqrt()
    assert float(difference) < 1.6 * float(noise)
    assert float(noise) < 0.05 * float(expected.square().mean().sqrt())


def test_the_gradient_to_the_albedo_is_the_slope() -> None:
    albedo = torch.tensor(0.8, dtype=torch.float64, requires_grad=True)
    weights = torch.rand(32, 2, 2, 25, generator=torch.Generator().manual_seed(0)).double()
    (slope,) = torch.autograd.grad((slot_transfer(albedo, size=2) * weights).sum(), albedo)
    above, below = (slot_transfer(0.8 + step, size=2) for step in (1e-5, -1e-5))
    assert float(slope) == pytest.approx(float(((above - below) * weights).sum()) / 2e-5, rel=1e-6)
