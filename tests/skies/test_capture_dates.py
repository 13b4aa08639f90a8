from pathlib import Path

import pytest

from skylight.errors import InputError
from skylight.skies._captures import Capture, parse_date, read_days


@pytest.mark.parametrize(
    ("text", "day", "time"),
    [
        ("IMG_20160515_1.exr", "20160515", ""),
        ("20160515_093015.exr", "20160515", "2016-05-15T09:30:15"),
        ("sky-2016-05-15 09.30.15.hdr", "20160515", "2016-05-15T09:30:15"),
        ("20160515T0930.exr", "20160515", "2016-05-15T09:30:00"),
        ("20160515093015.exr", "20160515", "2016-05-15T09:30:15"),
        ("20160515/093015/envmap.exr", "20160515", "2016-05-15T09:30:15"),
        ("20160515/20160516_093015.exr", "20160516", "2016-05-16T09:30:15"),
        ("2016:05:15 09:30:15", "20160515", "2016-05-15T09:30:15"),
        ("20160515_997799.exr", "20160515", ""),
        ("20240229.exr", "20240229", ""),
    ],
)
def test_dates(text: str, day: str, time: str) -> None:
    assert parse_date(text) == Capture(day=day, time=time)


@pytest.mark.parametrize(
    "text", ["", "20161301.exr", "20230229.exr", "kloofendal_43d", "120160515.exr", "2016051.exr"]
)
def test_what_is_no_date(text: str) -> None:
    assert parse_date(text) is None


def test_a_list_of_days(tmp_path: Path) -> None:
    path = tmp_path / "days.csv"
    path.write_text("\ufefffile,day,time\na.exr, one ,12:00\nb/c.exr,two,\n", encoding="utf-8")
    assert read_days(path) == {
        "a.exr": Capture(day="one", time="12:00"),
        "b/c.exr": Capture(day="two"),
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "cannot be read"),
        ("name,day\na.exr,1\n", "row 2 has no file or no day"),
        ("file,day\na.exr,1\nb.exr\n", "row 3 has no file or no day"),
        ("file,day\na.exr,1\na.exr,2\n", "row 3 lists a.exr a second time"),
    ],
)
def test_unusable_lists(tmp_path: Path, text: str | None, message: str) -> None:
    path = tmp_path / "days.csv"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_days(path)
