from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given, settings, strategies as st

from skylight.errors import InputError
from skylight.skies import _index as splits
from skylight.skies._index import SkyRecord, assign_splits, divide

SHARES = {"train": 0.8, "validation": 0.1, "test": 0.1}


def sky(day: str, sunny: bool) -> SkyRecord:
    return SkyRecord(
        file=f"{day}.exr",
        day=day,
        time="",
        regime="",
        sun_zenith_deg=40.0,
        map_azimuth_deg=0.0,
        sun_transmittance=float(sunny),
    )


def skies(days: list[tuple[int, int]]) -> list[SkyRecord]:
    """Days of so many sunny and so many overcast skies."""
    return [
        sky(f"d{i}", sunny) for i, (a, b) in enumerate(days) for sunny in [True] * a + [False] * b
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
    with pytest.raises(InputError, match="sum to 1"):
        assign_splits(giant, seed=0, shares=(0.5, 0.2, 0.2))


def test_a_set_without_a_share_stays_empty() -> None:
    found = assign_splits(skies([(1, 1)] * 20), seed=1, shares=(0.5, 0.5, 0.0))
    assert Counter(found.values()) == {"train": 10, "validation": 10}
    assert set(assign_splits(skies([(1, 0)]), seed=1, shares=(0.0, 0.0, 1.0)).values()) == {"test"}


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
