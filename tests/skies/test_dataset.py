import math
from collections import Counter
from pathlib import Path

import pytest
import torch

from skylight.errors import InputError
from skylight.imaging.files import write_environment_map
from skylight.skies import dataset
from skylight.skies.dataset import (
    COLUMNS,
    SkyRecord,
    centre_column_azimuth,
    folder_hash,
    index_folder,
    load_skies,
    read_index,
    simulate_folder,
    simulated_skies,
    split_of_day,
)
from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.sphere.frame import angle_between, direction_from_angles
from skylight.sphere.grid import DirectionGrid


def simulate(out: Path, days: int = 2, workers: int = 1) -> Path:
    return simulate_folder(out, days=days, interval_min=300.0, height=8, workers=workers)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate(tmp_path_factory.mktemp("skies")).parent


def contents(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_splits_are_disjoint_by_day_and_eight_to_one_to_one() -> None:
    names = [f"2019{i:04d}-{i}" for i in range(4000)]
    shares = Counter(split_of_day(name) for name in names)
    assert shares["train"] / 4000 == pytest.approx(0.8, abs=0.03)
    assert shares["validation"] / 4000 == pytest.approx(0.1, abs=0.02)
    assert shares["test"] / 4000 == pytest.approx(0.1, abs=0.02)
    # the first 8 digits of sha256 modulo 10 are 7, 8 and 9: published numbers rest on the split,
    # so it must not change
    assert split_of_day("2019-e") == "train"
    assert split_of_day("2019-g") == "validation"
    assert split_of_day("2019-an") == "test"


def test_index_of_simulated_days(simulated: Path) -> None:
    records = read_index(simulated)
    assert {r.file for r in records} == {p.name for p in simulated.glob("*.exr")}
    assert len({r.day for r in records}) == 2
    for r in records:
        assert 0 <= r.sun_zenith_deg < 88
        assert 0 <= r.sun_transmittance <= 1 + 1e-6
        assert r.map_azimuth_deg == pytest.approx(math.degrees(centre_column_azimuth(8)))
        assert r.split == split_of_day(r.day)


def test_days_already_there_are_kept(simulated: Path, tmp_path: Path) -> None:
    """A run that stopped after the first day, or within the second, ends like one that did not."""
    simulate(tmp_path, days=1)
    before = (tmp_path / "days" / "0.csv").stat().st_mtime_ns
    seen: list[tuple[int, int]] = []
    simulate_folder(
        tmp_path,
        days=2,
        interval_min=300.0,
        height=8,
        progress=lambda done, of: seen.append((done, of)),
    )
    assert (tmp_path / "days" / "0.csv").stat().st_mtime_ns == before
    assert seen == [(2, 2)]
    assert contents(tmp_path) == contents(simulated)


def test_a_day_cut_short_is_done_again(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, written = dataset.write_environment_map, []

    def fails_at_the_second(path: Path, sky: EnvironmentMap) -> None:
        if len(written) == 1:
            raise KeyboardInterrupt
        written.append(path)
        write(path, sky)

    monkeypatch.setattr(dataset, "write_environment_map", fails_at_the_second)
    with pytest.raises(KeyboardInterrupt):
        simulate(tmp_path)
    monkeypatch.undo()
    assert not (tmp_path / "index.csv").exists()
    assert not list((tmp_path / "days").iterdir())
    simulate(tmp_path)
    assert contents(tmp_path) == contents(simulated)


def test_workers_write_the_same_bytes(simulated: Path, tmp_path: Path) -> None:
    simulate(tmp_path, workers=2)
    assert contents(tmp_path) == contents(simulated)


def test_simulating_leaves_the_callers_threads_alone(tmp_path: Path) -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        simulate(tmp_path, days=1)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "no index of skies there"),
        ("", "has no rows"),
        (",".join(COLUMNS) + "\n", "has no rows"),
        ("file,day\na.exr,b\n", "its columns are file, day, time"),
        (",".join(COLUMNS) + "\na.exr,d\n", "not an index of skies"),
        (",".join(COLUMNS) + "\na.exr,d,t,clear,high,0,0,1\n", "not an index of skies"),
    ],
)
def test_unusable_indices(tmp_path: Path, text: str | None, message: str) -> None:
    if text is not None:
        (tmp_path / "index.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_index(tmp_path)


def test_an_index_that_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "index.csv").write_bytes(b"\xff\xfe\x00\x80" * 10)
    with pytest.raises(InputError, match=r"index\.csv"):
        read_index(tmp_path)


def record(**changes: object) -> SkyRecord:
    values = dict.fromkeys(COLUMNS, 0.0) | dict.fromkeys(("file", "day", "time", "regime"), "x")
    return SkyRecord(**(values | changes))  # type: ignore[arg-type]


def test_a_map_that_is_gone(tmp_path: Path) -> None:
    gone = [record(file="gone.exr")]
    with pytest.raises(InputError, match=r"gone\.exr"):
        folder_hash(tmp_path, gone)
    with pytest.raises(InputError, match=r"gone\.exr"):
        load_skies(tmp_path, gone)


def test_hash_names_the_data_exactly(simulated: Path, tmp_path: Path) -> None:
    simulate(tmp_path)
    records = read_index(tmp_path)
    first = folder_hash(tmp_path, records)
    assert first == folder_hash(simulated, read_index(simulated))
    assert first != folder_hash(tmp_path, records[:-1])
    assert first != folder_hash(tmp_path, records[::-1])
    path = tmp_path / records[0].file
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    assert first != folder_hash(tmp_path, records)


def test_loaded_skies_face_the_sun_and_have_mean_one(tmp_path: Path) -> None:
    """A full map with a sun anywhere becomes a sky of the right size with it in column w/2."""
    grid = DirectionGrid.latlong(64)
    records = []
    for i, azimuth in enumerate((-2.5, -0.3, 1.234, 3.1)):
        sun = direction_from_angles(torch.tensor(azimuth), torch.tensor(0.9)).double()
        angle = angle_between(grid.directions, sun.expand_as(grid.directions))
        light = 0.3 + 500 * torch.exp(-((angle / 0.08) ** 2))
        light[grid.directions[:, 1] < 0] = 7.0  # the ground must not count
        radiance = light.float().reshape(64, 128, 1).expand(-1, -1, 3).contiguous()
        write_environment_map(tmp_path / f"{i}.exr", EnvironmentMap(radiance=radiance))
        records.append(record(file=f"{i}.exr", map_azimuth_deg=math.degrees(azimuth)))
    skies = load_skies(tmp_path, records)
    assert skies.shape == (4, 32, 128, 3)
    solid = DirectionGrid.sky(32).solid_angles.reshape(32, 128)
    mean = (luminance(skies).double() * solid).sum((1, 2)) / (2 * math.pi)
    torch.testing.assert_close(mean, torch.ones(4, dtype=torch.float64), rtol=1e-6, atol=0)
    for sky in skies:
        found = EnvironmentMap(radiance=sky).brightest_direction()
        wanted = direction_from_angles(
            torch.tensor(centre_column_azimuth(32)), torch.tensor(0.9)
        ).double()
        assert float(angle_between(found, wanted).rad2deg()) < 0.7
    torch.testing.assert_close(skies[0], skies[2], rtol=0.1, atol=0.3)


def test_simulated_skies_load_unturned(simulated: Path) -> None:
    records = read_index(simulated)
    loaded = load_skies(simulated, records, height=8)
    written = dataset.read_environment_map(simulated / records[0].file).radiance
    torch.testing.assert_close(
        loaded[0] / loaded[0].sum(), written / written.sum(), rtol=1e-4, atol=1e-7
    )


def test_indexing_captured_maps(shared_data: Path, tmp_path: Path) -> None:
    """Where the suns of published maps stand, as its collectors measured them."""
    suns = {  # elevation and column of the brightest place, degrees
        "kloofendal_43d_clear_puresky.exr": (43.1, 36.0, 1.0),
        "quarry_01.exr": (10.0, 36.0, 1.0),
        "pedestrian_overpass.exr": (2.6, 51.2, 1.0),
        "kloofendal_overcast.exr": (23.0, 29.4, 0.0),
    }
    for name in suns:
        source = shared_data / "hdr" / name
        if not source.is_file():
            pytest.skip(f"{name} is not among the collected data")
        (tmp_path / name).symlink_to(source)
    (tmp_path / "IMG_20160515_1.exr").symlink_to(shared_data / "hdr" / "quarry_01.exr")
    records = index_folder(tmp_path)
    read = read_index(tmp_path)
    assert [r.file for r in read] == [r.file for r in records]
    by_file = {r.file: r for r in read}
    for name, (elevation, column, transmittance) in suns.items():
        found = by_file[name]
        assert found.day == Path(name).stem
        assert found.sun_transmittance == transmittance
        if transmittance:
            assert 90 - found.sun_zenith_deg == pytest.approx(elevation, abs=1)
            assert found.map_azimuth_deg == pytest.approx(column, abs=1)
    assert by_file["IMG_20160515_1.exr"].day == "20160515"
    assert load_skies(tmp_path, read[:2]).isfinite().all()


def test_a_folder_without_maps(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no \.exr or \.hdr maps"):
        index_folder(tmp_path)


def test_skies_on_the_spot_keep_to_their_split() -> None:
    found = simulated_skies("train", 2, first_seed=2, lowest_transmittance=0.5)
    assert all(r.split == "train" and r.sun_transmittance >= 0.5 for r, _ in found)
    assert len({r.day for r, _ in found}) == 2
    again = simulated_skies("train", 1, first_seed=2, lowest_transmittance=0.5)
    assert torch.equal(found[0][1].radiance, again[0][1].radiance)
