"""Capture from pictures drawn by ray casting, through a lens with distortion."""

from functools import cache

import numpy as np
import pytest
import torch

from skylight.probes.cameras._drawing import lens_rays, looking_at
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.cameras._pose import camera_centre
from skylight.probes.cameras._response import Response
from skylight.probes.voxel._assembly import PlacedProbe, VoxelAssembly
from skylight.probes.voxel._captured import LightmapCapture, read_faces, visible_faces
from skylight.probes.voxel._lightmap import Lightmap
from skylight.probes.voxel._model import exposed_faces, star_probe
from skylight.probes.voxel._relight import VoxelRenderer
from skylight.sphere._rotation import RigidTransform

F64 = torch.float64
VOXEL_MM = 20.0
LENS = Intrinsics(
    width=480,
    height=360,
    fx=900.0,
    fy=905.0,
    cx=236.0,
    cy=181.0,
    k1=-0.12,
    k2=0.05,
    p1=1e-3,
    p2=-1e-3,
)  # fmt: skip


def assembly(**options: object) -> VoxelAssembly:
    """Turned about the vertical, centre 100 mm over the board."""
    angle = 0.4
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    shift = np.array([10.0, 100.0, -5.0]) - VOXEL_MM * turn @ np.full(3, 1.5)
    return VoxelAssembly(
        model=star_probe(3),
        voxel_mm=VOXEL_MM,
        board_from_probe=RigidTransform.from_numpy(turn, shift),
        **options,
    )  # type: ignore[arg-type]


@cache
def probe() -> PlacedProbe:
    return PlacedProbe(assembly())


def smooth_light() -> Lightmap:
    """Different in every slot and linear within, so that interpolation is exact."""
    generator = torch.Generator().manual_seed(3)
    level = 0.2 + 0.5 * torch.rand(6, 32, 1, 1, 3, generator=generator)
    slope = 0.2 * (torch.rand(2, 6, 32, 1, 1, 3, generator=generator) - 0.5)
    along = (torch.arange(16.0) + 0.5) / 16 - 0.5
    light = level + slope[0] * along[:, None, None] + slope[1] * along[:, None]
    return Lightmap(radiance=light, coverage=torch.ones(6, 32), confidence=torch.ones(6, 32))


@cache
def renderer() -> VoxelRenderer:
    cells = torch.diag(torch.tensor([VOXEL_MM] * 3 + [1.0], dtype=F64))
    return VoxelRenderer(star_probe(3), assembly().board_from_probe.matrix() @ cells)


def pose(azimuth: float, elevation: float, distance: float = 300.0) -> RigidTransform:
    centre = torch.tensor([10.0, 100.0, -5.0], dtype=F64)
    offset = [
        np.cos(elevation) * np.sin(azimuth),
        np.sin(elevation),
        np.cos(elevation) * np.cos(azimuth),
    ]
    return looking_at(centre + distance * torch.tensor(offset, dtype=F64), centre)


def photograph(light: Lightmap, from_: RigidTransform) -> np.ndarray:
    window = renderer().window(from_, LENS)
    drawing = renderer().draw(light, lens_rays(LENS, 2, window), from_)
    picture = np.full((LENS.height, LENS.width, 3), 0.9, np.float32)
    picture[window] = (drawing.radiance + 0.9 * (1 - drawing.alpha[..., None])).numpy()
    return picture


NOTHING = np.zeros((360, 480), bool)
RING = [(a, e) for e in (0.6, -0.6) for a in np.arange(6) * np.pi / 3]


def test_a_ring_of_pictures_captures_all_thirty_slots() -> None:
    light, capture = smooth_light(), LightmapCapture(probe())
    for azimuth, elevation in RING:
        here = pose(azimuth, elevation)
        capture.add(photograph(light, here), NOTHING, here, LENS)
    found = capture.lightmap()
    faces = exposed_faces(star_probe(3))
    assert int(found.known.sum()) == 30
    assert found.known[faces.orientation, faces.configuration].all()
    error = (found.radiance - light.radiance)[found.known].abs() / light.radiance[found.known]
    # texels at the edge are read 4 % from it; the background is five times as bright
    assert float(error.median()) < 0.004
    assert float(error[:, 2:-2, 2:-2].max()) < 0.04
    assert float(found.coverage[found.known].min()) == 1
    # a face of 20 mm at 300 mm is 60 px wide, seen straight
    assert float(found.confidence[found.known].min()) > 1
    assert float(found.confidence.max()) < (60 / 16) ** 2 * 1.3
    assert np.median(capture.disagreements) < 0.003
    assert max(capture.disagreements) < 0.04


def test_faces_behind_others_are_not_read() -> None:
    """Against the picture: every face read shows nothing but its own slot."""
    light = torch.zeros(6, 32, 16, 16, 3)
    light[..., 0] = torch.arange(1.0, 193.0).reshape(6, 32, 1, 1)
    names = Lightmap(radiance=light, coverage=torch.ones(6, 32), confidence=torch.ones(6, 32))
    seen = set()
    for azimuth, elevation in RING[::2]:
        here = pose(azimuth + 0.2, elevation)
        views = read_faces(photograph(names, here), NOTHING, probe(), here, LENS)
        assert len(views) >= 6
        for view in views:
            inner = view.radiance[3:-3, 3:-3, 0]
            np.testing.assert_allclose(
                inner, 32 * view.orientation + view.configuration + 1, atol=0.05
            )
            seen.add((view.orientation, view.configuration))
    assert len(seen) >= 15


def test_the_largest_view_is_kept() -> None:
    light, capture = smooth_light(), LightmapCapture(probe())
    near, far = pose(0.3, 0.6, 300.0), pose(0.3, 0.6, 500.0)
    assert capture.add(photograph(light, far), NOTHING, far, LENS) > 0
    small = capture.lightmap().confidence
    assert capture.add(photograph(light, near), NOTHING, near, LENS) > 0
    large = capture.lightmap().confidence
    shown = small > 0
    ratio = large[shown] / small[shown]
    assert float(ratio.median()) == pytest.approx((500 / 300) ** 2, rel=0.15)
    assert capture.add(photograph(light, far), NOTHING, far, LENS) == 0


def test_a_capture_goes_on_where_it_stopped() -> None:
    light = smooth_light()
    first = LightmapCapture(probe())
    here, there = pose(0.3, 0.6), pose(2.5, 0.6)
    first.add(photograph(light, here), NOTHING, here, LENS)
    second = LightmapCapture(probe(), first.lightmap())
    assert second.add(photograph(light, here), NOTHING, here, LENS) == 0
    before = int(second.lightmap().known.sum())
    second.add(photograph(light, there), NOTHING, there, LENS)
    assert int(second.lightmap().known.sum()) > before


def test_overexposed_faces_are_refused_and_said() -> None:
    light, here = smooth_light(), pose(0.3, 0.6)
    capture = LightmapCapture(probe())
    assert capture.add(photograph(light, here), ~NOTHING, here, LENS) == 0
    assert not capture.lightmap().known.any()
    assert capture.rejected.sum() > 5
    # a later, shorter exposure mends it
    capture.add(photograph(light, here), NOTHING, here, LENS)
    assert capture.rejected.sum() == 0


def test_a_burnt_corner_is_filled_with_the_rest() -> None:
    light, here = smooth_light(), pose(0.3, 0.6)
    whole = LightmapCapture(probe())
    whole.add(photograph(light, here), NOTHING, here, LENS)
    shown, pixels, _ = visible_faces(probe(), here, LENS)
    corner = pixels[shown[0], 0].round().astype(int)
    burnt = NOTHING.copy()
    burnt[corner[1] - 4 : corner[1] + 4, corner[0] - 4 : corner[0] + 4] = True
    capture = LightmapCapture(probe())
    capture.add(photograph(light, here), burnt, here, LENS)
    coverage = capture.lightmap().coverage
    faces = probe().faces
    slot = int(faces.orientation[shown[0]]), int(faces.configuration[shown[0]])
    assert 0.75 <= float(coverage[slot]) < 1
    assert float(coverage[coverage > 0].max()) == 1


def test_light_that_moved_shows_in_the_faces_seen_twice() -> None:
    light, here, there = smooth_light(), pose(0.3, 0.6), pose(0.5, 0.6)
    moved = Lightmap(
        radiance=light.radiance * 1.3, coverage=light.coverage, confidence=light.confidence
    )
    capture = LightmapCapture(probe())
    capture.add(photograph(light, here), NOTHING, here, LENS)
    capture.add(photograph(moved, there), NOTHING, there, LENS)
    assert np.median(capture.disagreements) == pytest.approx(0.3, abs=0.1)


def test_faces_seen_smaller_need_not_be_looked_at() -> None:
    """The same is captured, without a word on light that moved."""
    light, here = smooth_light(), pose(0.3, 0.6)
    poses = [here, shifted(here, 0, 0, -60.0), pose(0.5, 0.6), shifted(here, 0, 0, 20.0)]
    drawn = [torch.from_numpy(photograph(light, each)) for each in poses]
    photos = [Response().encode(picture) for picture in drawn]
    all_compared, taken_alone = LightmapCapture(probe()), LightmapCapture(probe())
    for photo, each in zip(photos, poses, strict=True):
        taken = all_compared.add_photo(photo, Response(), each, LENS)
        assert taken_alone.add_photo(photo, Response(), each, LENS, compare=False) == taken
    assert len(taken_alone.disagreements) < len(all_compared.disagreements)
    torch.testing.assert_close(
        taken_alone.lightmap().radiance, all_compared.lightmap().radiance, rtol=0, atol=1e-5
    )
    assert taken_alone.slots == int(all_compared.lightmap().known.sum())


def shifted(here: RigidTransform, *by: float) -> RigidTransform:
    return RigidTransform.translating(torch.tensor(by, dtype=F64)) @ here


def test_what_leaves_the_frame_is_not_read() -> None:
    here = pose(0.3, 0.6)
    aside = shifted(here, 75.0, 0, 0)
    assert (
        0 < len(visible_faces(probe(), aside, LENS)[0]) < len(visible_faces(probe(), here, LENS)[0])
    )
    gone = shifted(here, 400.0, 0, 0)
    assert visible_faces(probe(), gone, LENS)[0] == []
    behind = shifted(here, 0, 0, 600.0)
    assert visible_faces(probe(), behind, LENS)[0] == []


def test_a_pole_in_the_way_hides_faces() -> None:
    """A wide one just before the probe, as seen from the camera."""
    here = pose(0.3, 0.6)
    x, _, z = (0.5 * (camera_centre(here) + np.array([10.0, 100.0, -5.0]))).tolist()
    hidden = PlacedProbe(assembly(pole_mm=(x, z, 60.0, 400.0)))
    assert len(visible_faces(probe(), here, LENS)[0]) > 5
    assert visible_faces(hidden, here, LENS)[0] == []
