"""What stands behind a person as an observation: right directions, people cut out, or a reason."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.faces._background import BackgroundPixels, _in_blocks, _outdoors, drawn_parts
from skylight.imaging._colour import linear_to_srgb, srgb_to_linear
from skylight.sphere._frame import pixel_from_direction
from skylight.transport._cameras import Camera
from tests.sunny_face import sunny_face

ROWS, SIDE = 64, 320


def person():
    """(a rendered head, its fit in a larger picture)."""
    face = sunny_face(40.0, 50.0)
    large = face.truth.camera
    # the same head in a picture of more view
    camera = Camera(
        focal_px=large.focal_px, width=SIDE, height=SIDE, center_px=(SIDE / 2, SIDE / 2)
    )
    return face, replace(face.truth, camera=camera)


def lively(height=SIDE, width=SIDE, seed=0, level=0.25):
    """A linear picture with coarse and fine structure, and noise in every pixel."""
    rng = np.random.default_rng(seed)
    coarse = cv2.resize(rng.normal(0, 0.6, (7, 9, 3)).astype(np.float32), (width, height))
    return level * np.exp(coarse + rng.normal(0, 0.05, (height, width, 3))).astype(np.float32)


def photographed(scene, *, blend=None):
    """(linear picture of the person before the scene in 8 bits, clipped, fit, hair)."""
    face, fit = person()
    small = face.picture.numpy()
    edge = (SIDE - len(small)) // 2
    picture = scene.copy()
    inside = slice(edge, edge + len(small))
    body = np.abs(small - 0.18).max(2) > 0.03  # its own backdrop is of that grey
    picture[inside, inside][body] = small[body]
    if blend is not None:
        picture = blend(picture)
    codes = (255 * linear_to_srgb(torch.from_numpy(picture).clamp(0, 1))).round()
    linear = srgb_to_linear(codes / 255)
    hair = np.zeros((SIDE, SIDE), np.float32)
    return linear, (codes == 255).any(2), fit, hair


def observed(scene, *, level=0.2, **options):
    linear, clipped, fit, hair = photographed(scene, **options)
    return BackgroundPixels.of(linear, clipped, [fit], hair).observed(level, ROWS)


def test_rows_average_a_map_over_the_blocks_it_was_seen_in():
    """A view of a map of that grid: the mean of each block is its row of the matrix times it."""
    camera = Camera(focal_px=100.0, width=90, height=60, center_px=(45.0, 30.0))
    light = torch.rand(ROWS, 2 * ROWS, 3, generator=torch.Generator().manual_seed(0))
    row, column = pixel_from_direction(camera.rays(), ROWS, 2 * ROWS)
    seen = light[row.round().long(), column.round().long()].reshape(60, 90, 3).numpy()
    usable = np.ones((60, 90), bool)
    usable[20:, 30:60] = False
    pixels = BackgroundPixels(
        picture=seen, clipped=np.zeros((60, 90), np.float32), usable=usable, camera=camera
    )
    found = _in_blocks(pixels, 1.0, ROWS)
    matrix = found.averages.matrix
    assert torch.allclose(matrix.sum(1), torch.ones(len(matrix)), atol=1e-5)
    assert torch.allclose(matrix @ light.reshape(-1, 3), found.radiance, atol=1e-5)
    assert 10 < len(matrix) < 6 * 4
    # to the left of the picture is what lies to the left of -Z, above is above
    towards = matrix.double() @ found.averages.grid.directions
    left = torch.from_numpy(seen[:20, :10].reshape(-1, 3)).mean(0)
    first = int((found.radiance - left).abs().sum(1).argmin())
    assert towards[first, 0] < -0.3
    assert towards[first, 1] > 0.1
    assert towards[first, 2] < 0
    fewer = found.on_rows(ROWS // 2).averages.matrix
    assert torch.allclose(fewer.sum(1), torch.ones(len(matrix)), atol=1e-5)


def test_the_person_is_cut_out():
    """The head with what stands below it, and little else."""
    linear, clipped, fit, hair = photographed(lively())
    usable = BackgroundPixels.of(linear, clipped, [fit], hair).usable
    places = fit.camera.project(torch.from_numpy(fit.vertices)) * len(usable) / SIDE
    x, y = places.long().clamp(0, len(usable) - 1).T
    assert not usable[y, x].any()
    assert not usable[y.max() :, int(x.double().mean())].any()
    assert usable[0, 0]
    assert usable[0, -1]
    assert 0.3 < usable.mean() < 0.9


def test_the_person_is_not_the_background():
    """However bright it is: a scene without it has the same blocks."""
    scene = lively()
    found = observed(scene)
    glowing = scene.copy()
    glowing[SIDE // 2 :, 120:200] = 1.0  # below the head stands the body
    assert len(found.radiance) >= 8
    off = observed(glowing).radiance.log().mean() - found.radiance.log().mean()
    assert float(off.abs()) < 0.05


def test_blocks_with_white_in_them_are_bounds():
    scene = lively()
    scene[:100, :100] = 4.0 * lively(100, 100, seed=3)
    found = observed(scene)
    assert 0 < int(found.clipped.sum()) < len(found.clipped)
    towards = found.averages.matrix.double() @ found.averages.grid.directions
    assert bool((towards[found.clipped, 0] < 0).all())
    assert bool((towards[found.clipped, 1] > 0).all())


def test_brighter_pictures_have_brighter_backgrounds():
    one, two = observed(lively(level=0.1)), observed(lively(level=0.2))
    assert float((two.radiance / one.radiance).log().mean()) == pytest.approx(np.log(2), abs=0.05)


Y, X = np.indices((SIDE, SIDE)) - SIDE / 2
ABOUT = np.hypot(Y, X)


def round_crop(colour):
    def blend(picture):
        return np.where(ABOUT[..., None] > 150, np.float32(colour), picture)

    return blend


def cut_out(colour):
    """The person alone, with a soft edge."""
    inside = ((X / 75) ** 2 + ((Y - 60) / 160) ** 2 < 1).astype(np.float32)
    soft = cv2.GaussianBlur(inside, (0, 0), 1.5)[..., None]
    return lambda picture: soft * picture + (1 - soft) * np.float32(colour)


@pytest.mark.parametrize("colour", [(1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.1, 0.6, 0.2)])
def test_a_cut_out_has_no_background(colour):
    with pytest.raises(InputError, match="even colour"):
        observed(lively(), blend=cut_out(colour))


@pytest.mark.parametrize("colour", [(1.0, 1.0, 1.0), (0.0, 0.0, 0.0)])
def test_what_is_about_a_round_crop_is_left_out(colour):
    whole = observed(lively())
    found = observed(lively(), blend=round_crop(colour))
    assert len(found.radiance) >= 4
    assert not found.clipped.any()
    off = (found.radiance.log().mean() - whole.radiance.log().mean()).abs()
    assert float(off) < 0.3


@pytest.mark.parametrize("colour", [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.3, 0.1, 0.1)])
@pytest.mark.parametrize("sides", ["all", "top and bottom", "right"])
def test_a_border_is_left_out(colour, sides):
    if sides == "right" and colour[0] == 1:
        pytest.skip("a white side may be a window")

    def framed(picture):
        kept = {
            "all": (np.abs(X) < 130) & (np.abs(Y) < 130),
            "top and bottom": np.abs(Y) < 110,
            "right": X < 120,
        }[sides]
        return np.where(kept[..., None], picture, np.float32(colour))

    found = observed(lively(), blend=framed)
    light = found.radiance / torch.from_numpy(lively().mean((0, 1)))
    assert float(light.log().abs().max()) < 1.5
    assert not found.clipped.any()


def test_another_picture_beside_is_left_out():
    def collage(picture):
        return np.where(X[..., None] < 100, picture, lively(seed=5, level=0.9).clip(0.6, 0.95))

    found = observed(lively(level=0.1), blend=collage)
    assert float(found.radiance.max()) < 0.5


def test_a_white_sky_is_light():
    """Blown out above, with a skyline below: no cut-out."""
    scene = lively()
    roofs = 100 + 20 * np.sin(np.arange(SIDE) / 15)
    scene[np.arange(SIDE)[:, None] < roofs] = 2.0
    found = observed(scene)
    assert 0 < int(found.clipped.sum()) < len(found.clipped)


def test_white_light_all_round_is_light():
    """Windows on all sides, whose glow fades towards the middle."""
    glow = np.exp(-(((ABOUT - 190) / 60) ** 2))[..., None].astype(np.float32)
    found = observed(lively() + 3 * glow)
    assert int(found.clipped.sum()) > 0


@pytest.mark.parametrize("colour", [(0.18, 0.18, 0.18), (0.05, 0.5, 0.1)])
def test_a_screen_of_one_colour_is_refused(colour):
    """Noise of a sensor and all."""
    noise = np.random.default_rng(1).normal(1, 0.02, (SIDE, SIDE, 3)).astype(np.float32)
    with pytest.raises(InputError, match="one colour"):
        observed(np.float32(colour) * noise)


def test_a_background_that_is_over_exposed_all_over_is_refused():
    with pytest.raises(InputError, match="over-exposed"):
        observed(lively(level=1.6))


def test_a_black_studio_is_refused():
    with pytest.raises(InputError, match="black"):
        observed(lively(level=0.001))


def test_a_face_that_fills_the_picture_has_none():
    _, fit = person()
    hair = np.ones((SIDE, SIDE), np.float32)
    linear, clipped, *_ = photographed(lively())
    with pytest.raises(InputError, match="too little"):
        BackgroundPixels.of(linear, clipped, [fit], hair)


@pytest.mark.parametrize(
    ("colour", "contrast", "relative", "expected"),
    [
        ((0.1, 0.2, 0.05), 0.8, 1.0, True),  # leaves
        ((0.1, 0.2, 0.05), 0.1, 1.0, False),  # a green wall
        ((0.1, 0.2, 0.05), 0.8, 0.01, False),  # what is nearly black is of any colour
        ((0.2, 0.2, 0.2), 0.8, 1.0, False),
        ((0.4, 0.2, 0.1), 0.8, 1.0, False),  # wood
        ((0.3, 0.45, 0.8), 0.3, 2.0, True),  # a sky
        ((0.3, 0.45, 0.8), 0.3, 0.5, False),  # a blue wall in the shade
    ],
)
@pytest.mark.parametrize("exposure", [0.3, 1.0])
def test_plants_and_a_bright_blue_above_are_outdoors(
    colour, contrast, relative, expected, exposure
) -> None:
    picture = np.tile(exposure * np.array(colour), (100, 1))
    bright, upper = np.full(100, relative), np.arange(100) < 50
    assert _outdoors(picture, bright, upper, contrast) == expected
    # so they are where they fill a part of the picture only
    picture[:60:2], bright[:60:2] = 0.2 * exposure, 1.0
    assert _outdoors(picture, bright, upper, contrast) == expected
    assert not _outdoors(np.where(upper[:, None], 0.2, picture), bright, upper, 0.3)
    picture[20:] = 0.2 * exposure  # a fifth of what is above, as of a plant in a pot
    assert not _outdoors(picture, bright, upper, contrast)


def test_what_stands_behind_a_person_is_seen_to_be_outdoors() -> None:
    scene = lively()
    grey = np.broadcast_to(scene[..., :1], scene.shape)
    assert not observed(grey).outdoors
    garden = grey**1.5 * np.float32([1.0, 2.0, 0.6])
    assert observed(garden).outdoors
    blue = grey**0.5 * np.float32([0.3, 0.45, 0.8])
    for above, below, expected in ((blue, grey, True), (grey, blue, False)):
        halves = np.where(Y[..., None] < 0, above, below)
        assert observed(halves, level=0.05).outdoors == expected


def test_the_white_about_a_round_crop_is_drawn_and_the_person_is_not() -> None:
    rows, columns = np.mgrid[:200, :200] - 99.5
    inside = rows**2 + columns**2 < 95**2
    noise = np.random.default_rng(0).integers(60, 200, (200, 200, 3))
    codes = np.where(inside[..., None], noise, 255).astype(np.uint8)
    person = ((np.abs(columns) < 40) & (rows > -60)).astype(np.float32)
    drawn = drawn_parts(codes, person)
    assert drawn[~inside & (np.hypot(rows, columns) > 105)].min() == 1
    assert drawn[rows**2 + columns**2 < 80**2].max() == 0
    assert drawn_parts(np.full_like(codes, 255), person).shape == (200, 200)
    assert drawn_parts(noise.astype(np.uint8), person).max() == 0
