import math
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.models._ground import (
    GROUND_ALBEDOS,
    GROUND_SPREAD,
    KnownGround,
    LambertianGround,
    check_has_ground,
    ground_prior,
)
from skylight.models._prior import GaussianMixture
from skylight.sphere._frame import DirectionGrid

F64 = torch.float64


def test_furnace_is_exact() -> None:
    """Constant sky 1: the ground shows its albedo, to rounding."""
    albedo = torch.tensor([[0.2, 0.17, 0.14], [1.0, 0.5, 0.0]], dtype=F64)
    ground = LambertianGround(32)(torch.ones(2, 4096, 3, dtype=F64), albedo)
    torch.testing.assert_close(ground, albedo, rtol=1e-12, atol=0)


def test_transfer_is_the_cosine_integral_of_every_pixel() -> None:
    """Against a 50 times finer midpoint rule, pixel row by pixel row."""
    fine = DirectionGrid.sky(8 * 50)
    assert fine.layout is not None
    cosine = (fine.directions[:, 1] * fine.solid_angles).reshape(*fine.layout)
    rows = cosine.reshape(8, -1).sum(1) / 32
    transfer = LambertianGround(8).transfer.reshape(8, 32)
    torch.testing.assert_close(transfer[:, 0], rows, rtol=1e-5, atol=0)
    torch.testing.assert_close(transfer.sum(), torch.tensor(math.pi, dtype=F64))


def test_append_fills_the_lower_half() -> None:
    sky = torch.rand(2, 4096, 3, generator=torch.Generator().manual_seed(0))
    albedo = torch.tensor([[0.2, 0.1, 0.05], [0.3, 0.3, 0.3]])
    model = LambertianGround(32)
    full = model.append(sky, albedo).reshape(2, 64, 128, 3)
    assert torch.equal(full[:, :32], sky.reshape(2, 32, 128, 3))
    expected = model(sky, albedo)[:, None, None].expand(2, 32, 128, 3)
    assert torch.equal(full[:, 32:], expected)


def test_differentiable_in_sky_and_albedo() -> None:
    sky = torch.rand(1, 16, 3, generator=torch.Generator().manual_seed(0), dtype=F64)
    albedo = torch.full((1, 3), 0.2, dtype=F64)
    assert torch.autograd.gradcheck(
        LambertianGround(2).append, (sky.requires_grad_(), albedo.requires_grad_())
    )


def test_prior_is_the_gaussian_of_the_nine_grounds() -> None:
    """Against numpy's moments and the closed form of the density."""
    log_albedo = np.log(np.array(GROUND_ALBEDOS))
    covariance = np.cov(log_albedo.T) * GROUND_SPREAD**2 + 0.01 * np.eye(3)
    away = np.log([[0.1, 0.1, 0.1], [0.6, 0.6, 0.6]]) - log_albedo.mean(0)
    quadratic = np.einsum("bi,ij,bj->b", away, np.linalg.inv(covariance), away)
    expected = -0.5 * (quadratic + np.linalg.slogdet(2 * np.pi * covariance)[1])
    found = ground_prior().log_prob(torch.tensor([[0.1] * 3, [0.6] * 3]).log())
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-4)


def test_nine_grounds_carry_no_second_component() -> None:
    log_albedo = torch.tensor(GROUND_ALBEDOS).log()
    bic = []
    for components in (1, 2):
        mixture = GaussianMixture.fit(log_albedo.double(), components, covariance_floor=0.01)
        parameters = components * (1 + 3 + 6) - 1
        likelihood = float(mixture.log_prob(log_albedo.double()).sum())
        bic.append(parameters * math.log(len(log_albedo)) - 2 * likelihood)
    assert bic[0] < bic[1]


def test_the_prior_is_log_normal() -> None:
    """The closed form of the density of three independent normals."""
    known = KnownGround(albedo=(0.3, 0.2, 0.1), spread=0.2)
    at = torch.tensor([[0.35, 0.2, 0.08]]).log()
    z = (at[0].numpy() - np.log([0.3, 0.2, 0.1])) / 0.2
    expected = -0.5 * (z**2).sum() - 3 * math.log(0.2 * math.sqrt(2 * math.pi))
    assert float(ground_prior(known).log_prob(at)) == pytest.approx(expected, rel=1e-5)


def test_options_and_files(tmp_path: Path) -> None:
    assert KnownGround.parse("0.2,0.17,0.14") == KnownGround(albedo=(0.2, 0.17, 0.14), spread=0.1)
    known = KnownGround(albedo=(0.2, 0.17, 0.14), spread=0.3)
    assert KnownGround.parse("0.200,0.170,0.140,0.300") == known
    (tmp_path / "ground.json").write_text(
        '{"kind": "ground albedo", "red": 0.2, "green": 0.17, "blue": 0.14, "spread": 0.3, '
        '"greys": 6}'
    )
    assert KnownGround.parse(str(tmp_path / "ground.json")) == known


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0.2", "give R,G,B"),
        ("a,b,c", "give R,G,B"),
        ("0.2,0.2,0.2,0.1,1", "give R,G,B"),
        ("0.2,0,0.1", "above 0 and below 1"),
        ("0.2,1.5,0.1", "above 0 and below 1"),
        ("0.2,nan,0.1", "above 0 and below 1"),
        ("0.2,0.2,0.2,0", "0.01 to 2"),
        ("0.2,0.2,0.2,inf", "0.01 to 2"),
        ("none.json", "none.json"),
    ],
)
def test_refusals(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        KnownGround.parse(text)


def test_a_file_of_something_else(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text('{"kind": "ground albedo", "red": 2, "green": 0.1, "blue": 0.1, "spread": 0.1}')
    with pytest.raises(InputError, match=r"a\.json: a ground's albedo is above 0"):
        KnownGround.parse(str(path))


def test_lights_without_a_ground_refuse_it() -> None:
    known = KnownGround(albedo=(0.2, 0.2, 0.2))
    check_has_ground("auto", known)
    check_has_ground("sh9", None)
    with pytest.raises(InputError, match="is for skies over a ground, and lamps has none"):
        check_has_ground("lamps", known)
