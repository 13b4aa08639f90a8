import math
from dataclasses import replace
from pathlib import Path

import pytest

from skylight.errors import InputError
from skylight.skies._index import (
    COLUMNS,
    SkyRecord,
    folder_hash,
    map_path,
    read_index,
    read_rows,
    write_rows,
)


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
def test_unusable_indices(tmp_path: Path, text: str | None, message: str) -> None:
    if text is not None:
        (tmp_path / "index.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_index(tmp_path)


def test_the_row_that_the_unusable_ones_change_is_usable(tmp_path: Path) -> None:
    (tmp_path / "index.csv").write_text(",".join(COLUMNS) + "\n" + ROW)
    assert read_index(tmp_path)[0].layout == "latlong"


def test_an_index_that_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "index.csv").write_bytes(b"\xff\xfe\x00\x80" * 10)
    with pytest.raises(InputError, match=r"index\.csv"):
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
