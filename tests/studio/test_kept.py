"""What a server keeps, and when it forgets."""

from pathlib import Path

import pytest

from skylight.errors import InputError
from skylight.studio.kept import Item, Kept
from skylight.studio.limits import Limits
from skylight.studio.refusals import Refused


def _kept(tmp_path: Path, sizes: list[int], *, most: int, most_bytes: int) -> Kept[Item]:
    kept: Kept[Item] = Kept(tmp_path / "things", "thing", most=most, most_bytes=most_bytes)
    for size in sizes:
        item = Item(folder=kept.new_folder())
        (item.folder / "file").write_bytes(bytes(size))
        kept.add(item)
    return kept


@pytest.mark.parametrize(
    ("most", "most_bytes", "left"),
    [(9, 10**6, [10, 20, 30]), (2, 10**6, [20, 30]), (9, 50, [20, 30]), (9, 49, [30]), (1, 1, [])],
)
def test_the_oldest_go_first(tmp_path: Path, most: int, most_bytes: int, left: list[int]) -> None:
    kept = _kept(tmp_path, [10, 20, 30], most=most, most_bytes=most_bytes)
    kept.make_room(lambda _: False)
    assert [item.bytes for item in kept] == left
    assert len(list((tmp_path / "things").iterdir())) == len(left)


def test_what_is_in_use_stays(tmp_path: Path) -> None:
    kept = _kept(tmp_path, [10, 20, 30], most=1, most_bytes=10**6)
    kept.make_room(lambda item: item.bytes == 10)
    assert [item.bytes for item in kept] == [10]


def test_ids_are_not_guessed_and_not_folders(tmp_path: Path) -> None:
    kept = _kept(tmp_path, [1, 1], most=9, most_bytes=9)
    first, second = kept
    assert len({first.id, second.id, first.folder.name, second.folder.name}) == 4
    assert kept.get(first.id) is first
    with pytest.raises(Refused, match="no such thing") as refused:
        kept.get(first.folder.name)
    assert refused.value.status_code == 404


@pytest.mark.parametrize(
    "wrong", [{"jobs": 0}, {"upload_s": 0.0}, {"upload_mb": 0.0}, {"megapixels": float("nan")}]
)
def test_limits_are_above_nothing(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        Limits(**wrong)  # pyright: ignore[reportArgumentType]
