"""Made-up skin against measured skin, and what paints a head."""

import importlib
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.faces._model import HeadModel, Region
from skylight.faces._skin import SkinPrior
from skylight.people._people import bare_skin
from skylight.people._skin import (
    CLUSTERS,
    SmoothHead,
    field,
    freckles,
    paint,
    skin_albedo,
    stubble,
)

SURFACE = 0.028  # what the surface reflects


def mean_albedo(cluster: int, seed: int) -> np.ndarray:
    return paint(cluster, np.random.default_rng(seed)).albedo[bare_skin()].mean(0)


def test_measured_people_are_among_the_colours(
    shared_data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The nearest colour of the table is within 6 % in every channel for half of 100 people."""
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[2] / "tools"))
    tool = importlib.import_module("build_skin_spectra")
    with np.load(shared_data / "reference" / "nist_skin_reflectance_100.npz") as people:
        nm = people["wavelength_nm"].astype(float)
        measured = people["reflectance"] @ tool.sensitivities(nm).T
    melanin, blood = np.meshgrid(np.geomspace(0.005, 0.3, 60), np.geomspace(0.003, 0.06, 40))
    ours = SURFACE + (1 - SURFACE) * skin_albedo(melanin.ravel(), blood.ravel())
    gap = np.abs(np.log(measured[:, None] / ours)).max(-1).min(1)
    assert np.median(gap) < 0.06


def test_melanin_darkens_blue_most_and_blood_darkens_green_most() -> None:
    plain, tanned, flushed = np.log(
        skin_albedo(np.array([0.03, 0.06, 0.03]), np.array([0.015, 0.015, 0.03]))
    )
    red, green, blue = plain - tanned
    assert blue > green > red > 0
    red, green, blue = plain - flushed
    assert green > blue > red > 0


def test_clusters_get_darker_and_the_prior_knows_their_skin() -> None:
    prior = SkinPrior.load()
    drawn = prior.sample(1000, torch.Generator().manual_seed(0))
    usual = float(torch.quantile(prior.log_albedo.log_prob(drawn.log()), 0.02))
    means = np.array([mean_albedo(c, seed=0) for c in range(CLUSTERS)])
    luminance = means @ [0.2126, 0.7152, 0.0722]
    assert (luminance[:-1] > 1.1 * luminance[1:]).all()
    assert 0.3 < luminance[0] < 0.5
    assert 0.04 < luminance[-1] < 0.09
    assert float(prior.log_albedo.log_prob(torch.from_numpy(means).log()).min()) > usual


def test_lips_are_redder_and_faces_are_not_even() -> None:
    head = SmoothHead.load()
    albedo = paint(1, np.random.default_rng(2)).albedo
    face, lips = albedo[bare_skin()], albedo[head.belongs[Region.LIPS] > 0.99]
    redness = [np.median(part[:, 0] / part[:, 1]) for part in (face, lips)]
    assert redness[1] > 1.15 * redness[0]
    assert 0.03 < np.log(face).std(0).max() < 0.3


def test_a_field_has_variance_one_and_its_patch_size() -> None:
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (4000, 3))
    apart = np.array([0.01, 0.0, 0.0])
    same, near, far = [], [], []
    for seed in range(12):
        here, beside, away = (
            field(points + k * apart, 0.01, np.random.default_rng(seed)) for k in (0, 0.2, 4)
        )
        same.append((here**2).mean())
        near.append((here * beside).mean())
        far.append((here * away).mean())
    assert abs(np.mean(same) - 1) < 0.05
    assert np.mean(near) > 0.8
    assert abs(np.mean(far)) < 0.1


def test_freckles_lie_on_the_face_and_stubble_below_the_nose() -> None:
    head, model = SmoothHead.load(), HeadModel.load()
    marks = model.landmarks(model.mean)
    spotted = freckles(head.neutral, marks, np.random.default_rng(0))
    assert spotted.max() > 0.9
    assert np.average(head.neutral[:, 2], weights=spotted) > 0.03
    cover = stubble(head.neutral, marks)
    assert cover[head.neutral[:, 1] > marks[30, 1]].max() == 0
    chin = np.linalg.norm(head.neutral - marks[8], axis=1).argmin()
    assert cover[chin] > 0.8
