"""Which pixels of a rendered person are used, and whether their transport explains them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from skylight.errors import InputError
from skylight.faces import _observe as observe
from skylight.faces._model import HeadModel, Region
from skylight.faces._observe import BARE_PARTS, BLOCK, GRAZING_COSINE, observe_face
from skylight.faces._synthetic import render_face
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.transport._cameras import Camera

SIZE = 128


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return HeadModel.load()


@pytest.fixture(scope="module")
def person():
    """Under a constant sky with one bright pixel, before and above the face."""
    sky = torch.ones(8, 32, 3)
    sky[3, 28] = 60.0
    return render_face(
        EnvironmentMap(radiance=sky),
        torch.tensor([0.2, 0.2, 0.2]),
        seed=5,
        size=SIZE,
        azimuth_rad=0.0,
        light_rows=32,
    )


def observed(head, person, *, picture=None, clipped=None, fit=None, **options):
    return observe_face(
        person.picture if picture is None else picture,
        person.clipped if clipped is None else clipped,
        head,
        person.truth if fit is None else fit,
        **{"grid_height": 16} | options,
    )


def at(person, view):
    """Where the whole picture has the points used, (x, y)."""
    return person.truth.camera.project(view.surface.positions[view.used])


@pytest.fixture(scope="module")
def view(head, person):
    return observed(head, person)


def test_only_skin_is_used(head, view):
    corners = head.regions[head.faces[view.surface.faces[view.used].numpy()]]
    region = corners[:, 0]
    assert (corners == region[:, None]).all()
    assert set(region.tolist()) <= {Region.FACE, *BARE_PARTS}
    assert (region == Region.FACE).mean() > 0.5
    # none at the border of its part
    for part in set(region.tolist()):
        inside = torch.from_numpy((head.regions == part)[head.faces].all(1))
        mask = view.surface.image(inside[view.surface.faces].float()[:, None])[..., 0]
        for row, column in view.places[torch.from_numpy(region == part)].tolist():
            assert mask[row - 1 : row + 2, column - 1 : column + 2].sum() == 9


def test_a_bare_scalp_is_used_and_hair_on_it_is_not(head, person, view):
    def share(seen):
        corners = head.regions[head.faces[seen.surface.faces[seen.used].numpy()]]
        return float((corners[:, 0] == Region.SCALP).mean())

    assert share(view) > 0.03  # the hair segmenter takes some of a rendered scalp for hair
    vertices = torch.from_numpy(person.truth.vertices)
    scalp = person.truth.camera.project(vertices[torch.from_numpy(head.regions == Region.SCALP)])
    columns, rows = scalp.floor().long().clamp(0, SIZE - 1).unbind(1)
    hairy = person.picture.clone()
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        hairy[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3] *= 0.12
    face = torch.from_numpy(head.regions == Region.FACE)
    columns, rows = person.truth.camera.project(vertices[face]).floor().long().unbind(1)
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        near = slice(row - 2, row + 3), slice(column - 2, column + 3)
        hairy[near] = person.picture[near]
    assert share(observed(head, person, picture=hairy)) == 0


def test_an_observation_is_the_cut_picture_at_the_used_points(view):
    observation = view.observation
    torch.testing.assert_close(view.places, view.surface.pixels[view.used])
    torch.testing.assert_close(view.places // BLOCK, observation.places[view.blocks])
    seen_from = -torch.nn.functional.normalize(view.surface.positions[view.used], dim=1)
    cosine = (view.surface.normals[view.used] * seen_from).sum(1)
    assert (cosine > GRAZING_COSINE).all()
    assert len(cosine) > 500
    members = torch.bincount(view.blocks)
    assert 1 < float(members.float().mean()) <= members.max() == BLOCK**2
    # what a block has is a mean over its pixels, weighted by cosines and how likely each is skin
    facing = torch.zeros_like(observation.weights).index_add_(0, view.blocks, cosine.float())
    skin = observation.weights / facing
    assert float(skin.max()) < 1 + 1e-5
    assert float(skin.min()) > 0.49
    assert float(skin.median()) > 0.99
    seen = view.image[view.places[:, 0], view.places[:, 1]]
    sure = skin > 0.9999
    sums = torch.zeros_like(observation.pixels)
    sums.index_add_(0, view.blocks, cosine.float()[:, None] * seen)
    means = sums / facing[:, None]
    torch.testing.assert_close(observation.pixels[sure], means[sure], rtol=1e-3, atol=0)


def test_no_point_reflects_more_than_it_gets(view):
    diffuse = view.observation.transport.matrix.sum(1)
    assert float(diffuse.max()) < 1.01
    assert float(diffuse.median()) > 0.6  # faces are mostly convex
    assert (view.observation.transport.matrix >= 0).all()
    specular = view.observation.specular.matrix
    assert (specular >= 0).all()
    assert specular.isfinite().all()
    assert 0.005 < float(specular.sum(1).median()) < 0.2  # a few per cent, more at a slant


def test_transport_under_the_true_light_gives_the_picture(person, view):
    light = person.environment.flat
    observation = view.observation
    shading = person.albedo * (observation.transport.matrix @ light)
    shading = shading + observation.specular.matrix @ light
    error = (luminance(shading) / luminance(observation.pixels)).log()
    assert abs(float(error.median())) < 0.05
    assert float(error.abs().median()) < 0.08  # blotches, a bright pixel's place, roughness


def test_the_cut_picture_keeps_its_geometry(person, view):
    # points seen through the cut camera project to where the whole picture has them
    points = view.surface.positions[view.used]
    here = view.camera.project(points)
    torch.testing.assert_close(here, view.places.flip(1).double() + 0.5, atol=1e-6, rtol=0)
    there = person.truth.camera.project(points)
    shift = there - here
    if view.camera.focal_px == person.truth.camera.focal_px:  # cut, not scaled
        assert float((shift - shift.round()).abs().max()) < 1e-6


def test_pictures_are_scaled_down_to_the_working_height(head, person):
    view = observed(head, person, face_height_px=40)
    skin = view.camera.project(torch.from_numpy(person.truth.vertices))[
        torch.from_numpy(head.regions == Region.FACE)
    ]
    assert float(skin[:, 1].max() - skin[:, 1].min()) == pytest.approx(40, abs=1.5)
    whole = person.truth.camera
    points = view.surface.positions
    there = whole.project(points) * (view.camera.focal_px / whole.focal_px)
    shift = there - view.camera.project(points)
    assert float((shift - shift.mean(0)).abs().max()) < 0.5
    assert tuple(view.image.shape[:2]) == view.surface.layout


def test_over_exposed_pixels_are_lower_bounds(head, person, view):
    points = at(person, view)
    middle = int(points[:, 0].mean())
    clipped = torch.zeros_like(person.clipped)
    clipped[:, :middle] = True
    half = observed(head, person, clipped=clipped)
    points = at(person, half)
    bound = half.observation.clipped[half.blocks]
    assert bool(bound[points[:, 0] < middle - 1].all())
    assert not bool(bound[points[:, 0] > middle + 1].any())
    assert len(bound) > 0.95 * len(view.blocks)  # hardly a pixel is left out for it
    # as a camera would have it: colours lost
    white = person.picture.clone()
    white[:, :middle] = 1.0
    lost = observed(head, person, picture=white, clipped=clipped).observation
    assert float(lost.clipped.float().mean()) > 0.25
    assert float((~lost.clipped).float().mean()) > 0.25
    with pytest.raises(InputError, match="0 usable pixels"):
        observed(head, person, clipped=torch.ones_like(clipped))


def test_sunglasses_are_left_out(head, person, view):
    head_at = person.truth.camera.project(torch.from_numpy(person.truth.vertices)).numpy()
    eyes = head_at[head.regions == Region.EYEBALL]
    (left, top), (right, bottom) = (eyes.min(0) - 3).astype(int), (eyes.max(0) + 4).astype(int)
    picture = person.picture.clone()
    picture[top:bottom, left:right] *= 0.1
    there = observed(head, person, picture=picture)

    def behind(seen):
        columns, rows = at(person, seen).unbind(1)
        inside = (rows > top + 1) & (rows < bottom - 1)
        return int((inside & (columns > left + 1) & (columns < right - 1)).sum())

    assert behind(there) < 0.1 * behind(view)
    others = len(there.blocks) - behind(there)
    assert others > 0.9 * (len(view.blocks) - behind(view)) - (right - left) * 4


def test_hair_is_left_out(head, person, view, monkeypatch):
    points = at(person, view)
    middle = int(points[:, 0].mean())

    def left_of_middle(picture, square):
        probability = np.zeros(picture.shape[:2], np.float32)
        probability[:, :middle] = 1
        return probability

    monkeypatch.setattr(observe, "hair_probability", left_of_middle)
    half = observed(head, person)
    left = at(person, half)
    assert float(left[:, 0].min()) > middle - 1
    assert 0.2 < len(left) / len(points) < 0.8


def test_hair_is_looked_for_around_the_upright_head(head, person):
    square = observe._around_head(head, person.truth)
    at = person.truth.camera.project(torch.from_numpy(person.truth.vertices)).numpy()
    inside = np.linalg.solve(square.axes, (at - square.centre).T)
    face = inside[:, head.regions == Region.FACE]
    assert np.abs(face).max() < 0.3  # the face's half of the square is its middle
    assert np.abs(face).max() > 0.2
    eyes = inside[:, head.regions == Region.EYEBALL]
    left, right = eyes[:, eyes[0] > 0].mean(1), eyes[:, eyes[0] < 0].mean(1)
    assert abs(left[1] - right[1]) < 0.02  # level


def test_dark_pixels_are_left_out(head, person, view):
    points = at(person, view)
    middle = int(points[:, 1].mean())
    picture = person.picture.clone()
    picture[middle:] *= 0.002
    half = observed(head, person, picture=picture)
    left = at(person, half)
    assert float(left[:, 1].max()) < middle + 1
    assert 0.2 < len(left) / len(points) < 0.8


def shrunk(fit, factor):
    """The same person in a picture ``factor`` times smaller."""
    size = SIZE // factor
    camera = Camera(
        focal_px=fit.camera.focal_px / factor,
        width=size,
        height=size,
        center_px=(size / 2, size / 2),
    )
    return replace(fit, camera=camera)


@pytest.mark.parametrize(("factor", "message"), [(16, "too small to use"), (8, "too small")])
def test_faces_that_are_too_small_are_refused(head, person, factor, message):
    size = SIZE // factor
    picture, clipped = torch.full((size, size, 3), 0.5), torch.zeros(size, size).bool()
    fit = shrunk(person.truth, factor)
    with pytest.raises(InputError, match=message):
        observed(head, person, picture=picture, clipped=clipped, fit=fit)


def test_a_head_seen_from_behind_is_refused(head, person):
    fit = person.truth
    middle = fit.vertices.mean(0)
    turned = (fit.vertices - middle) @ Rotation.from_euler("y", np.pi).as_matrix().T + middle
    with pytest.raises(InputError, match="turned away"):
        observed(head, person, fit=replace(fit, vertices=turned))


def test_several_processes_see_the_same(head, person, view):
    told = []
    again = observed(head, person, workers=2, progress=told.append)
    assert torch.equal(again.observation.transport.matrix, view.observation.transport.matrix)
    assert told[-1] == 1


def test_rays_by_pytorch_see_what_those_by_embree_see(head, person, device):
    small = {"face_height_px": 32, "grid_height": 8}
    expected = observed(head, person, **small).observation
    found = observed(head, person, rays_on=device, **small).observation
    # a GPU may see another side of an edge that a ray grazes
    off = (found.transport.matrix - expected.transport.matrix).abs()
    assert int((off > 1e-6).sum()) <= (0 if device.type == "cpu" else 10)
    assert torch.equal(found.places, expected.places)
