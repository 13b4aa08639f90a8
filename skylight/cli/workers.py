"""Processes or cluster workers of a command."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from skylight.errors import InputError

if TYPE_CHECKING:
    from skylight.work.resumable import Workers


def who_works(workers: int, cluster: str | None, out: Path) -> Workers:
    """So many processes here, 0 for one per core, or those of the cluster, which work on ``out``.

    Raises
    ------
    InputError
        A number below 0, or both.
    """
    if cluster is not None:
        if workers != 0:
            raise InputError(
                "--workers and --cluster contradict each other: a cluster has its own workers"
            )
        from skylight.work.cluster import Cluster

        return Cluster(address=cluster, folder=out)
    if workers < 0:
        raise InputError(f"--workers must be 0 or more, got {workers}")
    return workers or _cores()


def _cores() -> int:
    """Those that this process may use: a batch system or a container gives it some of them."""
    if hasattr(os, "sched_getaffinity"):  # Linux
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
