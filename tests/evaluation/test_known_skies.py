"""Collections of real maps, read as they come."""

import pytest
import torch

from skylight.errors import InputError
from skylight.evaluation._sky_models import KnownSkies
from skylight.io._files import write_environment_map
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import angles_from_direction

MAPS = {
    "c.exr": "outdoor-nosun",
    "a.exr": "outdoor-sun",
    "room.exr": "indoor",
    "b.exr": "outdoor-lowsun",
    "street.exr": "night",
}


def a_map(column: int) -> EnvironmentMap:
    """A full map of 1 with a bright pixel 20 rows down."""
    radiance = torch.ones(128, 256, 3)
    radiance[20, column] = 500.0
    return EnvironmentMap(radiance=radiance)


@pytest.fixture
def collection(tmp_path):
    for number, file in enumerate(MAPS):
        write_environment_map(tmp_path / file, a_map(50 * number))
    lines = ["file,category,notes", *(f"{f},{c},some" for f, c in MAPS.items())]
    (tmp_path / "index.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


def test_outdoor_maps_by_day_in_the_order_of_their_names(collection):
    skies = KnownSkies(count=9, seed=0, data=collection)
    assert skies.collected
    assert skies.names() == ["a", "b", "c"]
    assert KnownSkies(count=2, seed=0, data=collection).names() == ["a", "b"]
    read = [skies.sky(i) for i in range(3)]
    assert [s.sun_visible for s in read] == [True, False, False]
    categories = ["outdoor-sun", "outdoor-lowsun", "outdoor-nosun"]
    assert [s.facts["category"] for s in read] == categories
    assert [s.facts["half"] for s in read] == ["development", "held-out", "development"]


def test_the_upper_half_its_sun_ahead_and_its_mean_one(collection):
    skies = KnownSkies(count=9, seed=0, data=collection)
    for number in range(3):
        sky = EnvironmentMap(radiance=skies.sky(number).radiance)
        assert sky.layout == (32, 128)
        azimuth, zenith = angles_from_direction(sky.brightest_direction())
        assert float(azimuth) == pytest.approx(torch.pi / 128, abs=1e-3)
        assert float(zenith) == pytest.approx(20.5 / 128 * torch.pi, abs=0.03)
        mean = luminance(sky.flat).double() @ sky.grid.solid_angles / (2 * torch.pi)
        assert float(mean) == pytest.approx(1, rel=1e-5)


def test_the_share_of_the_sun_survives_the_resizing(collection):
    known = KnownSkies(count=9, seed=0, data=collection).sky(0)
    before, after = a_map(50).upper(), EnvironmentMap(radiance=known.radiance)
    shares = []
    for sky in (before, after):
        value = luminance(sky.flat).double()
        excess = (value - value.median()) @ sky.grid.solid_angles
        shares.append(float(excess / (value @ sky.grid.solid_angles)))
    assert shares[1] == pytest.approx(shares[0], rel=1e-4)


def test_a_collection_without_skies_is_refused(collection):
    (collection / "index.csv").write_text("file,category\nroom.exr,indoor\n")
    with pytest.raises(InputError, match=r"outdoor-sun.*outdoor-nosun"):
        KnownSkies(count=9, seed=0, data=collection / ".." / collection.name)


def test_real_maps_are_the_ones_that_their_index_promises(shared_data):
    skies = KnownSkies(count=999, seed=0, data=shared_data / "hdr")
    visible = [skies.sky(i).facts for i in (0, 1)]
    assert [f["half"] for f in visible] == ["development", "held-out"]
    assert len(skies.names()) > 30
