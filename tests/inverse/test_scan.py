"""Finding the sun by linear least squares: the small solver, and a bumpy ball under known suns."""

import math
from dataclasses import replace

import pytest
import torch

from skylight.inverse._scan import SunScan, scan_faces
from skylight.sphere._frame import DirectionGrid
from skylight.transport._cameras import Camera
from skylight.transport._matrix import TransportMatrix, diffuse_transport
from skylight.transport._observation import Observation
from skylight.transport._rays import Raycaster
from skylight.transport._reflection import specular_transport
from skylight.transport._render import Specular, rasterize
from tests.transport.shapes import icosphere

GRID = DirectionGrid.latlong(64)
CELL_DEG = 180 / 32
# over the camera's shoulder, from the side, and from behind the ball
SUNS = [(0.5, 0.6, 0.62), (-0.75, 0.35, 0.5), (0.2, 0.95, 0.1), (0.85, 0.4, -0.3)]


@pytest.fixture(scope="module")
def ball():
    """(diffuse, specular transport, places) of a ball with a nose towards the camera."""
    vertices, faces = icosphere(4)
    vertices = torch.nn.functional.normalize(vertices, dim=1)
    nose = torch.exp(-(torch.acos(vertices[:, 2].clamp(-1, 1)) ** 2) / (2 * 0.2**2))
    vertices = vertices * (1 + 0.5 * nose[:, None]) + torch.tensor([0.0, 0.0, -4.0]).double()
    caster = Raycaster(vertices, faces)
    camera = Camera(focal_px=38.0, width=22, height=22, center_px=(11.0, 11.0))
    seen = rasterize(camera, vertices, faces, caster)
    diffuse = diffuse_transport(seen.origins, seen.normals, seen.geometric_normals, caster, GRID)
    views = -torch.nn.functional.normalize(seen.positions, dim=1)
    return diffuse, specular_transport(diffuse, seen.normals, views, Specular()), seen.pixels


def under(sun, share):
    """Radiance of a sun of 3 degrees, ``share`` of the light, in a graded sky over a ground."""
    direction = torch.nn.functional.normalize(torch.tensor(sun).double(), dim=0)
    disc = torch.exp(300 * (GRID.directions @ direction - 1))
    up = GRID.directions[:, 1]
    rest = torch.where(up > 0, 0.6 + 0.4 * up, 0.25)
    parts = [share * disc / (disc @ GRID.solid_angles), rest / (rest @ GRID.solid_angles)]
    colours = torch.tensor([[1.0, 0.9, 0.7], [0.8, 1.0, 1.3]]).double()
    light = parts[0][:, None] * colours[0] + (1 - share) * parts[1][:, None] * colours[1]
    return light.float(), direction


def seen(ball, light, albedo, *, shine, with_specular):
    diffuse, specular, places = ball
    pixels = albedo * diffuse.matrix @ light + shine * specular.matrix @ light
    return Observation(
        pixels=pixels,
        weights=torch.linspace(0.5, 1, len(pixels)),
        places=places,
        transport=diffuse,
        specular=specular if with_specular else None,
    )


def scanned(observation, **options):
    return SunScan.of(scan_faces([observation]), **options)


def degrees_between(a, b):
    return math.degrees(math.acos(min(1.0, float(a @ b))))


@pytest.mark.parametrize("sun", SUNS)
def test_the_sun_is_found_within_a_cell(ball, sun):
    light, direction = under(sun, share=0.6)
    scan = scanned(seen(ball, light, 0.5, shine=0.0, with_specular=False))
    assert degrees_between(scan.candidates[0], direction) < CELL_DEG
    assert 0.2 < float(scan.strengths[0]) <= 1.0


@pytest.mark.parametrize("sun", SUNS)
def test_highlights_do_not_pull_the_sun_aside(ball, sun):
    # as bright as they are on dark skin
    light, direction = under(sun, share=0.6)
    scan = scanned(seen(ball, light, 0.06, shine=1.5, with_specular=True))
    assert degrees_between(scan.candidates[0], direction) < CELL_DEG
    blind = scanned(seen(ball, light, 0.06, shine=1.5, with_specular=False))
    assert scan.residuals.min() < 0.8 * blind.residuals.min()


def test_lower_bounds_tell_of_a_sun_behind(ball):
    # a picture exposed for the shade: the rim that the sun lights is as white as can be
    light, direction = under(SUNS[3], share=0.8)
    whole = seen(ball, light, 0.5, shine=0.0, with_specular=False)
    white = 2 * float(whole.pixels.median())
    over = (whole.pixels >= white).any(1)
    assert 0.05 < float(over.float().mean()) < 0.4
    cut = replace(whole, pixels=whole.pixels.clamp(max=white))
    told = scanned(replace(cut, clipped=over))
    plain = scanned(cut)
    off, plain_off = (degrees_between(scan.candidates[0], direction) for scan in (told, plain))
    assert off < 0.7 * plain_off
    assert float(told.residuals.min()) < 0.8 * float(plain.residuals.min())
    # nothing is clipped: the same scan
    none = replace(whole, clipped=torch.zeros_like(over))
    torch.testing.assert_close(scanned(none).residuals, scanned(whole).residuals)


def test_one_direction_alone_is_explained_entirely(ball):
    # all light from one cell of the scan: nothing remains, and no ambient light is needed
    cell = 9 * 64 + 27
    light = torch.zeros(32, 2, 64, 2, 3)
    light[9, :, 27] = 100.0
    scan = scanned(seen(ball, light.reshape(-1, 3), 0.4, shine=0.0, with_specular=False))
    assert int(scan.residuals.argmin()) == cell
    assert float(scan.residuals[cell]) < 1e-3
    assert float(scan.strengths[0]) == pytest.approx(1, abs=0.01)


def test_candidates_are_apart_and_in_order(ball):
    light, _ = under(SUNS[0], share=0.3)
    scan = scanned(
        seen(ball, light, 0.5, shine=0.0, with_specular=False), candidates=6, separation_deg=20.0
    )
    assert len(scan.candidates) == len(scan.strengths) == 6
    cosines = scan.candidates @ scan.candidates.T - 2 * torch.eye(6)
    assert float(cosines.max()) <= math.cos(math.radians(20)) + 1e-12
    places = [int((scan.directions @ c).argmax()) for c in scan.candidates]
    assert (scan.residuals[places].diff() >= 0).all()
    assert int(scan.residuals.argmin()) == places[0]
    assert (scan.directions[:, 1] > 0).all()


def test_the_unit_of_radiance_does_not_matter(ball):
    light, _ = under(SUNS[1], share=0.5)
    observation = seen(ball, light, 0.3, shine=1.0, with_specular=True)
    ours, theirs = scanned(observation), scanned(observation.scaled(1000.0))
    torch.testing.assert_close(ours.residuals, theirs.residuals, atol=1e-5, rtol=1e-3)
    torch.testing.assert_close(ours.candidates[0], theirs.candidates[0])


def test_a_grid_that_does_not_divide_is_refused():
    observation = Observation(
        pixels=torch.ones(1, 3),
        weights=torch.ones(1),
        places=torch.zeros(1, 2, dtype=torch.long),
        transport=TransportMatrix(matrix=torch.ones(1, 800), grid=DirectionGrid.latlong(20)),
    )
    with pytest.raises(ValueError, match="multiple of 32"):
        scanned(observation)
