"""Indices of skies, their division into splits, and the skies loaded."""

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings, strategies as st

from skylight.errors import InputError
from skylight.io._files import write_environment_map
from skylight.skies import _index as splits
from skylight.skies._index import (
    COLUMNS,
    SkyRecord,
    assign_splits,
    centre_column_azimuth,
    divide,
    folder_hash,
    load_skies,
    map_path,
    read_index,
    read_rows,
    write_rows,
)
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid, angle_between, direction_from_angles


def record(**changes: object) -> SkyRecord:
    values: dict[str, object] = dict.fromkeys(("file", "day", "time", "regime"), "x")
    values |= dict.fromkeys(("sun_zenith_deg", "map_azimuth_deg", "sun_transmittance"), 0.0)
    return SkyRecord(**(values | {"split": "train"} | changes))  # type: ignore[arg-type]


def test_there_and_back(tmp_path: Path) -> None:
    """What is not known stays empty in the file, and comes back as NaN or None."""
    simulated = record(
        sun_azimuth_deg=1.25, latitude_deg=-12.5, longitude_deg=0.1, seed=7, regime="clear"
    )
    captured = record(file="a, b.exr", day="b", split="test", layout="angular", field_deg=200.0)
    write_rows(tmp_path / "index.csv", [simulated, captured])
    read = read_index(tmp_path)
    # NaN is unlike itself, but is written alike
    assert [repr(r) for r in read] == [repr(simulated), repr(captured)]
    assert math.isnan(read[1].latitude_deg)
    assert read[1].seed is None
    assert (tmp_path / "index.csv").read_text().splitlines()[2].endswith(",,,angular,200.0")


ROW = "a.exr,d,t,train,clear,1,,2,0,,,,latlong,"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "no index of skies there"),
        (b"\xff\xfe\x00\x80" * 10, r"index\.csv"),
        ("", "has no rows"),
        (",".join(COLUMNS) + "\n", "has no rows"),
        ("file,day\na.exr,b\n", "its columns are file, day, time"),
        (",".join(COLUMNS) + "\na.exr,d\n", "a row is too short"),
        (",".join(COLUMNS) + "\n" + ROW.replace(",1,", ",high,"), "not an index of skies"),
        (",".join(COLUMNS) + "\n" + ROW.replace(",1,", ",nan,"), "sun_zenith_deg is nan"),
        (",".join(COLUMNS) + "\n" + ROW.replace(",1,", ",,"), "not an index of skies"),
        (",".join(COLUMNS) + "\n" + ROW.replace("train", "rest"), "unknown split 'rest'"),
        (",".join(COLUMNS) + "\n" + ROW.replace("latlong", "cube"), "unknown layout 'cube'"),
        (",".join(COLUMNS) + "\n" + ROW.replace("train", ""), "day d has no split"),
        (
            ",".join(COLUMNS) + f"\n{ROW}\n" + ROW.replace("train", "test"),
            "day d is in two splits",
        ),
    ],
)
def test_unusable_indices(tmp_path: Path, text: str | bytes | None, message: str) -> None:
    """All but one are of the row below, which is usable as it is."""
    index = tmp_path / "index.csv"
    index.write_text(",".join(COLUMNS) + "\n" + ROW)
    assert read_index(tmp_path)[0].layout == "latlong"
    index.unlink()
    if text is not None:
        index.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=message):
        read_index(tmp_path)


def test_an_index_of_another_name_or_elsewhere(tmp_path: Path) -> None:
    """Maps are found from the index's folder or its file, or from anywhere by absolute paths."""
    maps = tmp_path / "maps"
    maps.mkdir()
    (maps / "a.exr").write_bytes(b"light")
    here, away = maps / "mine.csv", tmp_path / "away.csv"
    write_rows(here, [record(file="a.exr")])
    write_rows(away, [record(file=(maps / "a.exr").as_posix())])
    for index in (here, away):
        (found,) = read_index(index)
        assert map_path(index, found).read_bytes() == b"light"
        assert map_path(index.parent, found).read_bytes() == b"light"
    with pytest.raises(InputError, match=r"index\.csv: no index of skies there"):
        read_index(maps)


def test_a_part_of_an_index_needs_no_splits(tmp_path: Path) -> None:
    write_rows(tmp_path / "0.csv", [record(split=None)])
    assert read_rows(tmp_path / "0.csv")[0].split is None


def test_hash_names_the_data_exactly(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).write_bytes(name.encode())
    records = [record(file="a"), record(file="b")]
    first = folder_hash(tmp_path, records)
    assert first == folder_hash(tmp_path, list(records))
    assert first != folder_hash(tmp_path, records[:-1])
    assert first != folder_hash(tmp_path, records[::-1])
    assert first != folder_hash(tmp_path, [records[0], replace(records[1], split="test")])
    (tmp_path / "b").write_bytes(b"c")
    assert first != folder_hash(tmp_path, records)
    with pytest.raises(InputError, match=r"gone\.exr"):
        folder_hash(tmp_path, [record(file="gone.exr")])


SHARES = {"train": 0.8, "validation": 0.1, "test": 0.1}


def skies(days: list[tuple[int, int]]) -> list[SkyRecord]:
    """Days of so many sunny and so many overcast skies."""
    return [
        record(file=f"d{i}.exr", day=f"d{i}", split=None, sun_transmittance=float(sunny))
        for i, (a, b) in enumerate(days)
        for sunny in [True] * a + [False] * b
    ]


def distance(records: list[SkyRecord], found: dict[str, str]) -> float:
    """The largest difference of a set's share of skies, or of sunny ones, from what is wanted."""
    sunny = [r.sun_transmittance > 0.5 for r in records]
    differences = []
    for split, share in SHARES.items():
        inside = [s for r, s in zip(records, sunny, strict=True) if found[r.day] == split]
        differences.append(abs(len(inside) / len(records) - share))
        differences.append(abs(sum(inside) / len(inside) - sum(sunny) / len(sunny)))
    return max(differences)


DAYS = st.one_of(
    st.lists(st.tuples(st.integers(0, 12), st.integers(0, 12)), max_size=40),
    st.lists(st.tuples(st.just(0), st.integers(1, 5)), max_size=40),  # all overcast
    st.lists(st.sampled_from([(1, 0), (0, 1)]), max_size=80),  # a sky a day
    st.builds(  # one giant day
        lambda rest, giant: [*rest, giant],
        st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=20),
        st.tuples(st.integers(50, 300), st.integers(0, 300)),
    ),
    st.lists(st.just((3, 4)), max_size=30),  # duplicates
)


@given(DAYS, st.integers(0, 2**32 - 1), st.sampled_from([0.02, 0.1, 0.4]))
@settings(max_examples=30)
def test_a_division_is_near_enough_or_refused(
    days: list[tuple[int, int]], seed: int, tolerance: float
) -> None:
    """Whole days, every set filled, shares and mixtures within the tolerance; else an error."""
    records = skies(days)
    names = {r.day for r in records}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(splits, "TRIES", 60)
        try:
            found = assign_splits(records, seed=seed, tolerance=tolerance)
        except InputError as error:
            if len(names) >= 3:
                best = float(str(error).partition("draws was within ")[2].partition(":")[0])
                assert best >= tolerance - 0.005  # as it is rounded
            return
        assert found == assign_splits(records[::-1], seed=seed, tolerance=tolerance)
    assert set(found) == names
    assert set(found.values()) == set(SHARES)
    assert distance(records, found) <= tolerance + 1e-9


@given(st.integers(10, 120), st.integers(1, 5), st.booleans(), st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_days_that_are_alike_divide_as_well_as_whole_days_can(
    count: int, each: int, sunny: bool, seed: int
) -> None:
    """With n like days the nearest cuts are half a day away at most, and nothing is refused."""
    records = skies([(each, 0) if sunny else (0, each)] * count)
    found = assign_splits(records, seed=seed, tolerance=1 / count)
    sizes = Counter(found.values())
    assert abs(sizes["test"] - 0.1 * count) <= 0.5 + 1e-9
    assert abs(sizes["validation"] - 0.1 * count) <= 0.5 + 1e-9


def test_a_mixture_is_kept_where_a_plain_draw_would_not_keep_it() -> None:
    """60 sunny and 40 overcast days: each small set has 6 and 4, which chance gives 1 in 4."""
    records = skies([(5, 0)] * 60 + [(0, 5)] * 40)
    for seed in range(5):
        found = assign_splits(records, seed=seed, tolerance=0.02)
        for split in ("validation", "test"):
            days = [int(day[1:]) for day in found if found[day] == split]
            assert (len(days), sum(day < 60 for day in days)) == (10, 6)
    assert found != assign_splits(records, seed=0, tolerance=0.02)


def test_what_cannot_be_divided() -> None:
    giant = skies([(900, 0), *[(1, 0)] * 100])
    with pytest.raises(InputError, match=r"0\.10"):
        assign_splits(giant, seed=0)
    with pytest.raises(InputError, match=r"2 day\(s\)"):
        assign_splits(skies([(1, 1), (1, 1)]), seed=0)


def test_dividing_a_folder() -> None:
    records = skies([(4, 0)] * 150 + [(0, 4)] * 100)
    divided = divide(records)
    assert [replace(r, split=None).file for r in divided] == [r.file for r in records]
    assert [(r.day, r.sun_transmittance) for r in divided] == [
        (r.day, r.sun_transmittance) for r in records
    ]
    assert {r.split for r in divided} == {"train", "validation", "test"}
    assert distance(records, {r.day: r.split or "" for r in divided}) <= 0.05
    few = divide(skies([(1, 1)] * 3))
    assert Counter(r.split for r in few) == {"train": 2, "validation": 2, "test": 2}
    assert {r.split for r in divide(skies([(1, 1)] * 2))} == {"train"}
    with pytest.raises(InputError, match=r"within 0\.001"):
        divide(records[:9], tolerance=0.001)


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
        turned = math.degrees(azimuth)
        records.append(record(file=f"{i}.exr", map_azimuth_deg=turned, layout="latlong"))
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


def test_black_and_missing_maps(tmp_path: Path) -> None:
    write_environment_map(tmp_path / "a.exr", EnvironmentMap(radiance=torch.ones(16, 64, 3)))
    write_environment_map(tmp_path / "b.exr", EnvironmentMap(radiance=torch.zeros(16, 64, 3)))
    records = [record(file="a.exr"), record(file="b.exr")]
    with pytest.raises(InputError, match=r"b\.exr: the map is all black"):
        load_skies(tmp_path, records, height=8)
    with pytest.raises(InputError, match=r"gone\.exr"):
        load_skies(tmp_path, [record(file="gone.exr")])
