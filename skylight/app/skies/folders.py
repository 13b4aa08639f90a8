"""Options and output of the ``skylight skies`` commands."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import get_args

from skylight.errors import InputError
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


def describe(records: Sequence[SkyRecord], refusals: Sequence[Refusal]) -> Iterator[str]:
    """A line for each map: its day, split and sun, or why it is refused or left out."""
    for record in records:
        place = f"{90 - record.sun_zenith_deg:.0f} deg high at {record.map_azimuth_deg:+.0f} deg"
        sun = f"sun {place}" if record.sun_transmittance else f"no sun, brightest {place}"
        yield f"{record.file}: {record.layout}, day {record.day} ({record.split}), {sun}"
    for refusal in refusals:
        verb = "refused" if refusal.is_sky else "left out"
        yield f"{refusal.file}: {verb}, {refusal.reason}"
    left_out = Counter(refusal.reason for refusal in refusals if not refusal.is_sky)
    for reason, count in left_out.most_common():
        yield f"{count} left out, {reason}"


def counts(records: Sequence[SkyRecord]) -> str:
    """How many skies, days, and skies of each split."""
    found = Counter(record.split for record in records)
    days = len({record.day for record in records})
    splits = ", ".join(f"{found[split]} {split}" for split in get_args(Split))
    return f"{len(records)} skies of {days} day(s) ({splits})"
