"""The shell of hair over a head."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from skylight.faces._fit import FaceFit
from skylight.faces._model import HeadModel, Region
from skylight.faces._observe import SKIN_SPECULAR
from skylight.portrait._surface import (
    HAIR,
    THICKNESS_M,
    PersonSurface,
    hair_shell,
    region_image,
)
from skylight.sphere._envmap import EnvironmentMap
from tests.sunny_face import direction, sunny_face

SIZE = 256, 256


@pytest.fixture(scope="module")
def fit() -> FaceFit:
    fit = sunny_face(40.0, 50.0).truth
    assert (fit.camera.height, fit.camera.width) == SIZE
    return fit


def drawn(rows: slice = slice(None), columns: slice = slice(None)) -> np.ndarray:
    """Hair in that part of the photograph."""
    hair = np.zeros(SIZE, np.float32)
    hair[rows, columns] = 1
    return hair


def test_it_stands_off_scalp_and_forehead_and_nowhere_else(fit: FaceFit) -> None:
    model = HeadModel.load()
    vertices, faces = hair_shell(fit, drawn())
    assert faces.max() == len(vertices) - 1
    distances = np.linalg.norm(vertices[:, None] - fit.vertices[None], axis=2).min(1)
    assert distances.max() < 1.001 * THICKNESS_M  # and less over hollows
    assert np.median(distances) == pytest.approx(THICKNESS_M, rel=1e-3)
    scalp = fit.vertices[model.regions == Region.SCALP]
    over = np.linalg.norm(vertices[:, None] - scalp[None], axis=2).min(0)
    assert (over < 1.01 * THICKNESS_M).mean() > 0.9
    brows = fit.camera.project(torch.from_numpy(fit.vertices[model.regions == Region.BROW]))
    in_front = (vertices - fit.vertices.mean(0)) @ fit.rotation[:, 2] > 0
    fringe = fit.camera.project(torch.from_numpy(vertices[in_front]))
    assert float(fringe[:, 1].max()) < float(brows[:, 1].max())


def test_it_is_where_the_photograph_shows_it(fit: FaceFit) -> None:
    middle = SIZE[1] // 2
    vertices, _ = hair_shell(fit, drawn(columns=slice(0, middle)))
    assert len(vertices)
    ahead = vertices[(vertices - fit.vertices.mean(0)) @ fit.rotation[:, 2] > 0.02]
    shown = fit.camera.project(torch.from_numpy(ahead))[:, 0]
    assert float((shown < middle + 0.02 * SIZE[1]).float().mean()) > 0.95


def behind(fit: FaceFit, hair: np.ndarray) -> int:
    """How many of the shell's vertices lie at the back of the head."""
    vertices, _ = hair_shell(fit, hair)
    return int(((vertices - fit.vertices.mean(0)) @ fit.rotation[:, 2] < -0.06).sum())


def test_the_back_is_as_hairy_as_the_scalp_that_is_seen(fit: FaceFit) -> None:
    scalp = fit.vertices[HeadModel.load().regions == Region.SCALP]
    columns = fit.camera.project(torch.from_numpy(scalp))[:, 0]
    few, many = (round(float(columns.quantile(share))) for share in (0.1, 0.7))
    assert behind(fit, drawn(columns=slice(0, many))) == behind(fit, drawn()) > 200
    assert behind(fit, drawn(columns=slice(0, few))) < 50  # seen beside the ear


def test_what_lies_beside_the_picture_is_not_seen(fit: FaceFit) -> None:
    """The picture ends below the fringe; hair at its border says nothing of what lies above."""
    brow = fit.vertices[HeadModel.load().regions == Region.BROW]
    cut = round(float(fit.camera.project(torch.from_numpy(brow))[:, 1].min())) - 4
    x, y = fit.camera.center_px
    camera = replace(fit.camera, height=fit.camera.height - cut, center_px=(x, y - cut))
    hair = np.zeros((camera.height, camera.width), np.float32)
    hair[0] = 1
    vertices, _ = hair_shell(replace(fit, camera=camera), hair)
    assert len(vertices) == 0


@pytest.mark.parametrize("hair", [drawn(slice(0, 0)), drawn() * 0.4])
def test_a_bald_head_has_none(fit: FaceFit, hair: np.ndarray) -> None:
    vertices, faces = hair_shell(fit, hair)
    assert len(vertices) == len(faces) == 0


def test_it_shades_the_forehead_below_a_fringe(fit: FaceFit) -> None:
    """From above, and not the chin; each by the same points of the bald head."""
    model = HeadModel.load()
    forehead = fit.camera.project(torch.from_numpy(fit.vertices[model.regions == Region.FACE]))
    brow = fit.camera.project(torch.from_numpy(fit.vertices[model.regions == Region.BROW]))
    fringe = float(0.4 * forehead[:, 1].min() + 0.6 * brow[:, 1].min())
    light = EnvironmentMap(radiance=torch.zeros(64, 128, 3)).with_light(
        direction(0.0, 20.0), torch.ones(3)
    )
    bald, hairy = (
        PersonSurface.of(fit, hair=hair, face_px=60)
        for hair in (None, drawn(slice(0, round(fringe))))
    )
    images = [
        one.surface.image(one.shade(light, SKIN_SPECULAR).diffuse).numpy()[..., 0]
        for one in (bald, hairy)
    ]
    regions = region_image(hairy)
    assert (regions == HAIR).any()
    scale = hairy.camera.height / SIZE[0]
    rows = np.arange(len(regions))[:, None]
    near = (regions == Region.FACE) & (rows < (fringe + 8) * scale)
    chin = (regions == Region.FACE) & (rows > float(brow[:, 1].max()) * scale + 20)
    assert near.sum() > 5
    assert images[1][near].mean() < 0.8 * images[0][near].mean()
    np.testing.assert_allclose(images[1][chin].mean(), images[0][chin].mean(), rtol=0.02)
