"""Colours of random people."""

import numpy as np
import pytest

from skylight.faces._model import HeadModel, Region
from skylight.faces._synthetic import paint

SKIN = np.array([0.38, 0.22, 0.15])


def variation(seed):
    """Log albedo on the face against the person's own."""
    painted = paint(SKIN, np.random.default_rng(seed))
    return np.log(painted[HeadModel.load().regions == Region.FACE] / SKIN)


@pytest.mark.parametrize("seed", range(6))
def test_skin_varies_by_two_pigments_about_the_person_s_albedo(seed):
    logs = variation(seed)
    np.testing.assert_allclose(logs.mean(0), 0, atol=1e-12)
    values = np.linalg.svd(logs, compute_uv=False)
    assert values[2] < 1e-9 * values[0]
    assert values[1] > 0.02 * values[0]
    assert 0.04 < logs[:, 1].std() < 0.2
    assert logs[:, 0].std() < logs[:, 1].std()  # both absorb green more than red


def test_people_differ_and_a_seed_does_not():
    np.testing.assert_array_equal(variation(3), variation(3))
    one, other = variation(3)[:, 1], variation(4)[:, 1]
    assert abs(np.corrcoef(one, other)[0, 1]) < 0.8


def test_lips_are_redder_and_brows_darker_than_the_face():
    painted, regions = paint(SKIN, np.random.default_rng(0)), HeadModel.load().regions
    face, lips, brows = (
        painted[regions == region].mean(0) for region in (Region.FACE, Region.LIPS, Region.BROW)
    )
    assert lips[0] / lips[1] > 1.2 * face[0] / face[1]
    assert (brows < 0.4 * face).all()
