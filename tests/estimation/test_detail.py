"""The photograph in the map of its light: its own pixels there, and no other light anywhere."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from skylight.estimation._detail import Sampling, View, believed, detailed, person_of
from skylight.imaging._edits import UNEDITED, Edit
from skylight.sphere._envmap import EnvironmentMap, bilinear
from skylight.sphere._frame import DirectionGrid, pixel_from_direction
from tests.sunny_face import sunny_estimate

ROWS = 256


def smooth_light():
    """Brighter above and to the right, bluer above."""
    x, y, _ = DirectionGrid.latlong(ROWS).directions.float().unbind(1)
    tint = torch.stack([1 - 0.2 * y, torch.ones_like(y), 1 + 0.3 * y], 1)
    return (0.3 * (1 + 0.4 * y + 0.2 * x))[:, None] * tint


def stripes(rows=ROWS):
    """A pattern of two degrees and of three, round the sphere."""
    x, y, z = DirectionGrid.latlong(rows).directions.float().unbind(1)
    return 0.4 * torch.sin(180 * y) + 0.3 * torch.sign(torch.sin(120 * x)) * (z < 0)


@pytest.fixture
def person(monkeypatch):
    """Who stands in the picture, known."""
    mask = cut_out()
    monkeypatch.setattr("skylight.estimation._detail.person_of", lambda *_: mask)
    return mask


@cache
def cut_out():
    result = sunny_estimate()
    return person_of(result.photos[0], result.fit)


def test_the_person_is_cut_out():
    result = sunny_estimate()
    mask = cut_out()
    x, y = result.fit.camera.project(torch.from_numpy(result.fit.vertices)).long().T
    inside = (x >= 0) & (y >= 0) & (x < mask.shape[1]) & (y < mask.shape[0])
    assert (mask[y[inside], x[inside]] > 0.9).all()
    assert mask[0, 0] == mask[0, -1] == 0
    assert 0.2 < mask.mean() < 0.6


def taken(light, person, *, clip=1e9, skin=None):
    """(estimate of the smooth light, a photograph of ``light`` behind the person, fits)."""
    result = sunny_estimate()
    estimate = replace(
        result.estimate,
        environment=EnvironmentMap(radiance=smooth_light().reshape(ROWS, -1, 3)),
        lamps=(),
        faces=(replace(result.estimate.faces[0], edit=UNEDITED),),
    )
    photo, camera = result.photos[0], result.fit.camera
    row, column = pixel_from_direction(camera.rays(), ROWS, 2 * ROWS)
    behind = bilinear(light.reshape(ROWS, -1, 3), row, column).reshape(photo.pixels.shape)
    behind = behind * estimate.white_balance
    in_front = photo.pixels if skin is None else torch.tensor(skin).expand_as(photo.pixels)
    pixels = torch.where(torch.from_numpy(person > 0.99)[..., None], in_front, behind)
    clipped = pixels.amax(-1) >= clip
    codes = (255 * (pixels / pixels.amax()).clamp(0, 1) ** 0.45).to(torch.uint8).numpy()
    shown = replace(photo, pixels=pixels.clamp(max=clip), encoded=codes, clipped=clipped)
    return estimate, shown, [result.fit]


def in_view(estimate, photo, fits):
    """Where the map is the photograph's."""
    view = View.of(photo, fits, estimate.white_balance.numpy())
    assert view is not None
    inside = Sampling.of_view(view, (ROWS, 2 * ROWS))
    return torch.from_numpy((inside.feather > 0.98) & (inside(view.known) > 0.98))


def irradiances(environment, count=500):
    normals = torch.randn(count, 3, generator=torch.Generator().manual_seed(0))
    normals = torch.nn.functional.normalize(normals.double(), dim=1)
    grid = environment.grid
    facing = (grid.directions @ normals.T).clamp(min=0) * grid.solid_angles[:, None]
    return facing.T @ environment.flat.double()


@pytest.mark.parametrize("detail", ["photo", "mirrored"])
def test_the_light_stays_the_same(person, detail):
    estimate, photo, fits = taken(smooth_light() * stripes().exp()[:, None], person)
    found = detailed(estimate, photo, fits, detail)
    assert not torch.equal(found.radiance, estimate.environment.radiance)
    ratio = irradiances(found) / irradiances(estimate.environment)
    assert float((ratio - 1).abs().max()) < 0.01


def test_an_edit_of_the_photograph_is_not_in_the_map(person):
    estimate, photo, fits = taken(smooth_light() * stripes().exp()[:, None], person)
    edit = Edit(saturation=1.2, pivot=float(photo.pixels.mean()))
    faces = (replace(estimate.faces[0], edit=edit), *estimate.faces[1:])
    shown = replace(photo, pixels=edit.apply(photo.pixels))
    found = detailed(replace(estimate, faces=faces), shown, fits, "photo").radiance
    expected = detailed(estimate, photo, fits, "photo").radiance
    kept = in_view(estimate, photo, fits)
    as_shown = detailed(estimate, shown, fits, "photo").radiance
    assert not torch.allclose(as_shown[kept], expected[kept], rtol=0.01)
    assert found[kept] == pytest.approx(expected[kept], rel=0.01)


def test_the_view_shows_the_photograph(person):
    truth = smooth_light() * (1.3 * stripes().exp())[:, None]
    estimate, photo, fits = taken(truth, person)
    found = detailed(estimate, photo, fits, "photo").flat
    there = in_view(estimate, photo, fits).reshape(-1)
    assert int(there.sum()) > 50
    before = (estimate.environment.flat[there] / truth[there]).log().abs().mean()
    after = (found[there] / truth[there]).log().abs().mean()
    assert float(after) < 0.35 * float(before)


def test_a_level_beyond_doubt_stays_the_estimates(person):
    estimate, photo, fits = taken(12 * smooth_light(), person)
    found = detailed(estimate, photo, fits, "photo").flat
    there = in_view(estimate, photo, fits).reshape(-1)
    gain = (found[there] / estimate.environment.flat[there]).log()
    assert float(gain.abs().max()) < 0.2


def test_what_is_believed_falls_off():
    low = np.array([[[0.1, 0.1, 0.1], [2.5, 2.5, 2.5]]])
    kept = believed(low)
    assert kept[0, 0] == pytest.approx(0.1, rel=1e-3)
    assert (kept[0, 1] < 0.02 * low[0, 1]).all()


def test_clipped_pixels_never_darken(person):
    estimate, photo, fits = taken(0.6 * smooth_light(), person, clip=0.1)
    open_sky = replace(photo, clipped=photo.clipped.clone())
    open_sky.clipped[:, : photo.pixels.shape[1] // 3] = False  # else nothing is known
    found = detailed(estimate, open_sky, fits, "photo").flat
    view = View.of(open_sky, fits, estimate.white_balance.numpy())
    assert view is not None
    white = Sampling.of_view(view, (ROWS, 2 * ROWS)).clipped.reshape(-1) > 0.6
    assert white.sum() > 20
    assert (found[white] > 0.999 * estimate.environment.flat[white]).all()


def test_texture_has_no_seam_and_no_person(person):
    estimate, photo, fits = taken(smooth_light(), person, skin=(0.9, 0.01, 0.01))
    plain = detailed(estimate, photo, fits, "mirrored").radiance
    assert float((plain / estimate.environment.radiance).log().abs().max()) < 0.05
    estimate, photo, fits = taken(smooth_light() * stripes().exp()[:, None], person)
    texture = detailed(estimate, photo, fits, "mirrored").radiance.log()
    steps = (texture - texture.roll(1, 1)).abs().mean((0, 2))
    assert float(steps.median()) > 0.003
    assert float(steps[0]) < 2 * float(steps.median())


def test_sky_stays_sky(person):
    ground = torch.where(DirectionGrid.latlong(ROWS).directions[:, 1] < -0.02, stripes(), 0.0)
    estimate, photo, fits = taken(smooth_light() * ground.float().exp()[:, None], person)
    found = detailed(estimate, photo, fits, "mirrored").radiance
    change = (found / estimate.environment.radiance).log()[..., 1]
    fine = change.diff(dim=1).abs()
    above, below = fine[: ROWS // 2 - 12].mean(), fine[ROWS // 2 + 12 :].mean()
    assert float(above) < 0.1 * float(below)


def test_a_cut_out_tells_nothing(person):
    estimate, photo, fits = taken(smooth_light(), person)
    white = photo.encoded.copy()
    white[person < 0.99] = 255
    cut = replace(photo, encoded=white)
    for detail in ("none", "photo", "mirrored"):
        found = detailed(estimate, cut, fits, detail)
        assert torch.equal(found.radiance, estimate.environment.radiance)
