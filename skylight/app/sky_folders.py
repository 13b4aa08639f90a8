"""What the ``skylight skies`` commands ask and say."""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import get_args

from skylight.errors import InputError
from skylight.inverse.photo import Progress
from skylight.skies.captures import Refusal
from skylight.skies.index import SkyRecord, Split
from skylight.skies.simulator import REGIME_SHARES, Regime


def regime_shares(
    *, clear: float | None, broken: float | None, overcast: float | None
) -> dict[Regime, float]:
    """Shares of days that sum to 1: those not given are 0; the usual ones where none is given."""
    given: dict[Regime, float | None] = {"clear": clear, "broken": broken, "overcast": overcast}
    if all(share is None for share in given.values()):
        return REGIME_SHARES
    weights: dict[Regime, float] = {regime: given[regime] or 0.0 for regime in REGIME_SHARES}
    total = sum(weights.values())
    if not all(0 <= w < math.inf for w in weights.values()) or not 0 < total < math.inf:
        options = ", ".join(f"--{name} {share:g}" for name, share in weights.items())
        raise InputError(f"shares must be 0 or more, and one of them above 0, got {options}")
    return {regime: weight / total for regime, weight in weights.items()}


def with_time_left(thing: str, tell: Progress) -> Callable[[int, int], None]:
    """Progress by counts; the time left goes by those done since the first report."""
    start: tuple[float, int] | None = None

    def progress(done: int, total: int) -> None:
        nonlocal start
        now = time.monotonic()
        start = start or (now, done)
        text = f"{thing} {done} of {total}"
        if done > start[1]:
            left = (now - start[0]) / (done - start[1]) * (total - done)
            text += f", {left / 60:.0f} min left" if left > 90 else f", {left:.0f} s left"
        tell(text, done / total)

    return progress


def describe(records: Sequence[SkyRecord], refusals: Sequence[Refusal]) -> Iterator[str]:
    """A line for each map: its day, split and sun, or why it is refused."""
    for record in records:
        place = f"{90 - record.sun_zenith_deg:.0f} deg high at {record.map_azimuth_deg:+.0f} deg"
        sun = f"sun {place}" if record.sun_transmittance else f"no sun, brightest {place}"
        yield f"{record.file}: {record.layout}, day {record.day} ({record.split}), {sun}"
    for refusal in refusals:
        yield f"{refusal.file}: refused, {refusal.reason}"


def counts(records: Sequence[SkyRecord]) -> str:
    """How many skies, days, and skies of each split."""
    found = Counter(record.split for record in records)
    days = len({record.day for record in records})
    splits = ", ".join(f"{found[split]} {split}" for split in get_args(Split))
    return f"{len(records)} skies of {days} day(s) ({splits})"
