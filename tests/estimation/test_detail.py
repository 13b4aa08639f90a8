"""The photograph in the map of its light: its own pixels there, and no other light anywhere."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from skylight.estimation._detail import Sampling, View, detailed, trust_in
from skylight.faces._background import BackgroundPixels
from skylight.imaging._edits import UNEDITED, Edit
from skylight.sphere._envmap import EnvironmentMap, bilinear
from skylight.sphere._frame import DirectionGrid, pixel_from_direction
from skylight.transport._cameras import Camera
from tests.sunny_face import sunny_estimate

ROWS = 256
LOOKS = DirectionGrid.latlong(ROWS).directions.reshape(ROWS, -1, 3)


def smooth_light():
    """Brighter above and to the right, bluer above."""
    x, y, _ = DirectionGrid.latlong(ROWS).directions.float().unbind(1)
    tint = torch.stack([1 - 0.2 * y, torch.ones_like(y), 1 + 0.3 * y], 1)
    return (0.3 * (1 + 0.4 * y + 0.2 * x))[:, None] * tint


def stripes(rows=ROWS):
    """A pattern of two degrees and of three, round the sphere."""
    x, y, z = DirectionGrid.latlong(rows).directions.float().unbind(1)
    return 0.4 * torch.sin(180 * y) + 0.3 * torch.sign(torch.sin(120 * x)) * (z < 0)


CAMERA = Camera(focal_px=140.0, width=160, height=120, center_px=(80.0, 60.0))


@pytest.fixture
def person():
    """Where a head and what is below it stand."""
    y, x = np.indices((CAMERA.height, CAMERA.width))
    return ((x - 80) / 28) ** 2 + ((y - 70).clip(max=0) / 36) ** 2 < 1


def taken(light, person, *, clip=1e9, skin=0.2):
    """(estimate of the smooth light, ``light`` behind the person)."""
    result = sunny_estimate()
    estimate = replace(
        result.estimate,
        environment=EnvironmentMap(radiance=smooth_light().reshape(ROWS, -1, 3)),
        lamps=(),
        faces=(replace(result.estimate.faces[0], edit=UNEDITED),),
    )
    row, column = pixel_from_direction(CAMERA.rays(), ROWS, 2 * ROWS)
    behind = bilinear(light.reshape(ROWS, -1, 3), row, column).reshape(*person.shape, 3)
    behind = (behind * estimate.white_balance).numpy()
    picture = np.where(person[..., None], np.float32(skin), behind)
    clipped = (picture.max(-1) >= clip).astype(np.float32)
    pixels = BackgroundPixels(
        picture=picture.clip(max=clip), clipped=clipped, usable=~person, camera=CAMERA
    )
    return estimate, pixels


def in_view(estimate, behind):
    """Where the map is the photograph's."""
    view = View.of(behind, estimate.white_balance.numpy(), False)
    inside = Sampling.of_view(view, LOOKS)
    return torch.from_numpy((inside.feather > 0.98) & (inside(view.known) > 0.98))


def irradiances(environment, count=500):
    normals = torch.randn(count, 3, generator=torch.Generator().manual_seed(0))
    normals = torch.nn.functional.normalize(normals.double(), dim=1)
    grid = environment.grid
    facing = (grid.directions @ normals.T).clamp(min=0) * grid.solid_angles[:, None]
    return facing.T @ environment.flat.double()


def bright_spot():
    """A window six degrees wide, twenty times as bright as it was expected."""
    towards = torch.tensor([0.35, 0.1, -0.93], dtype=torch.float64)
    away = (DirectionGrid.latlong(ROWS).directions - towards).norm(dim=1)
    return np.log(20.0) * (away < 0.1).float()


@pytest.mark.parametrize("detail", ["photo", "mirrored"])
@pytest.mark.parametrize("pattern", [stripes, bright_spot])
def test_the_light_stays_the_same(person, detail, pattern):
    estimate, behind = taken(smooth_light() * pattern().float().exp()[:, None], person)
    found = detailed(estimate, behind, False, detail)
    assert float((found.radiance / estimate.environment.radiance).log().max()) > 0.3
    ratio = irradiances(found) / irradiances(estimate.environment)
    assert float((ratio - 1).abs().max()) < 0.01


def test_an_edit_of_the_photograph_is_not_in_the_map(person):
    estimate, behind = taken(smooth_light() * stripes().exp()[:, None], person)
    edit = Edit(saturation=1.2, pivot=float(behind.picture.mean()))
    faces = (replace(estimate.faces[0], edit=edit), *estimate.faces[1:])
    picture = edit.apply(torch.from_numpy(behind.picture)).numpy()
    shown = replace(behind, picture=picture)
    found = detailed(replace(estimate, faces=faces), shown, False, "photo").radiance
    expected = detailed(estimate, behind, False, "photo").radiance
    kept = in_view(estimate, behind)
    as_shown = detailed(estimate, shown, False, "photo").radiance
    assert not torch.allclose(as_shown[kept], expected[kept], rtol=0.01)
    assert found[kept] == pytest.approx(expected[kept], rel=0.01)


def test_the_view_shows_the_photograph(person):
    truth = smooth_light() * (1.3 * stripes().exp())[:, None]
    estimate, behind = taken(truth, person)
    found = detailed(estimate, behind, False, "photo").flat
    there = in_view(estimate, behind).reshape(-1)
    assert int(there.sum()) > 50
    before = (estimate.environment.flat[there] / truth[there]).log().abs().mean()
    after = (found[there] / truth[there]).log().abs().mean()
    assert float(after) < 0.35 * float(before)


def test_a_level_beyond_doubt_stays_the_estimates(person):
    estimate, behind = taken(12 * smooth_light(), person)
    found = detailed(estimate, behind, False, "photo").flat
    there = in_view(estimate, behind).reshape(-1)
    gain = (found[there] / estimate.environment.flat[there]).log()
    assert float(gain.abs().max()) < 0.2


def test_trust_falls_off():
    assert trust_in(np.full(3, 0.1)) == pytest.approx(1, abs=1e-3)
    assert trust_in(np.array([0.0, -0.7, 0.0])) == pytest.approx(0.5)
    assert trust_in(np.full(3, 2.5)) < 0.02


def test_what_is_not_believed_keeps_its_colours(person):
    """A pink wall with white joints is pink and white: no joint turns green."""
    joint = torch.sign(torch.sin(150 * DirectionGrid.latlong(ROWS).directions[:, :1])).float()
    pink = torch.where(joint > 0.0, torch.tensor([1.6, 0.7, 0.8]), torch.ones(3))
    truth = 12 * smooth_light() * pink
    estimate, behind = taken(truth, person)
    found = detailed(estimate, behind, False, "photo").flat
    there = in_view(estimate, behind).reshape(-1)
    colours = (found / truth)[there].log()
    assert float((colours - colours.mean(1, keepdim=True)).abs().max()) < 0.2
    assert float(colours.mean()) == pytest.approx(-np.log(12), abs=0.2)


@pytest.mark.parametrize("gain", [1.5, 0.6])
def test_no_block_stands_about_the_person(person, gain):
    """A view brighter or darker than the estimate: the map goes over smoothly, by no more than 4 %
    from pixel to pixel, and the person has not left a hole."""
    estimate, behind = taken(gain * smooth_light(), person)
    found = detailed(estimate, behind, False, "photo").radiance
    change = (found / estimate.environment.radiance).log()[..., 1]
    assert float(change.abs().max()) > 0.1
    assert max(float(change.diff(dim=side).abs().max()) for side in (0, 1)) < 0.04
    apart = change[ROWS // 2, ROWS] - change[in_view(estimate, behind)].mean()
    assert float(apart.abs()) < 0.3 * abs(np.log(gain))


def test_clipped_pixels_never_darken(person):
    estimate, behind = taken(0.6 * smooth_light(), person, clip=0.1)
    found = detailed(estimate, behind, False, "photo").flat
    view = View.of(behind, estimate.white_balance.numpy(), False)
    white = Sampling.of_view(view, LOOKS).clipped.reshape(-1) > 0.6
    assert white.sum() > 20
    assert (found[white] > 0.999 * estimate.environment.flat[white]).all()


def test_texture_has_no_seam_and_no_person(person):
    estimate, behind = taken(smooth_light(), person, skin=(0.9, 0.01, 0.01))
    plain = detailed(estimate, behind, False, "mirrored").radiance
    assert float((plain / estimate.environment.radiance).log().abs().max()) < 1e-3
    estimate, behind = taken(smooth_light() * stripes().exp()[:, None], person)
    texture = detailed(estimate, behind, False, "mirrored").radiance.log()
    steps = (texture - texture.roll(1, 1)).abs().mean((0, 2))
    assert float(steps.median()) > 0.003
    assert float(steps[0]) < 2 * float(steps.median())


def test_sky_stays_sky(person):
    ground = torch.where(DirectionGrid.latlong(ROWS).directions[:, 1] < -0.02, stripes(), 0.0)
    estimate, behind = taken(smooth_light() * ground.float().exp()[:, None], person)
    found = detailed(estimate, behind, False, "mirrored").radiance
    change = (found / estimate.environment.radiance).log()[..., 1]
    fine = change.diff(dim=1).abs()
    above, below = fine[: ROWS // 2 - 12].mean(), fine[ROWS // 2 + 12 :].mean()
    assert float(above) < 0.1 * float(below)


def test_a_photograph_without_background_shows_nothing():
    result = sunny_estimate()
    unseen = replace(result.seen[0], view=replace(result.view, behind=None))
    probe = replace(result, seen=(unseen,), detail="mirrored").probe
    assert torch.equal(probe.radiance, result.estimate.environment.radiance)
