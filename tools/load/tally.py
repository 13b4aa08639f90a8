"""What happened under load, counted."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any


@dataclass
class Tally:
    """``counts`` by name; the lists hold a line for each thing that must not be."""

    counts: Counter[str] = field(default_factory=Counter)
    lost: list[str] = field(default_factory=list)
    console_errors: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    waits_s: list[float] = field(default_factory=list)
    jobs_s: list[float] = field(default_factory=list)
    gaps_s: list[float] = field(default_factory=list)
    until_cancelled_s: list[float] = field(default_factory=list)
    most_before: int = 0

    def stream(self, seen: dict[str, Any]) -> None:
        """What a page saw of a job's events, milliseconds (see ``visitor.WATCH``)."""
        self.waits_s.append((seen["began"] - seen["asked"]) / 1000)
        self.jobs_s.append((seen["last"] - seen["asked"]) / 1000)
        self.gaps_s.append(seen["gap"] / 1000)
        self.most_before = max(self.most_before, seen["before"])

    def facts(self) -> dict[str, object]:
        return {
            "counts": dict(sorted(self.counts.items())),
            "jobs_lost": len(self.lost),
            "console_errors": len(self.console_errors),
            "failures": len(self.failures),
            "longest_wait_s": max(self.waits_s, default=0.0),
            "longest_job_s": max(self.jobs_s, default=0.0),
            "longest_event_gap_s": max(self.gaps_s, default=0.0),
            "longest_until_cancelled_s": max(self.until_cancelled_s, default=0.0),
            "most_jobs_before": self.most_before,
            "lines": [*self.lost, *self.console_errors, *self.failures],
        }
