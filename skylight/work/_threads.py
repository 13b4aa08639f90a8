"""Cores and threads: one thread for each process, more only where they gain.

An estimate is thousands of small operations. A second thread made one 5 % faster on an idle machine
of two cores, and six times slower beside other work: torch's threads spin while they wait for each
other (``docs/speed.md``). What is large enough is shared among processes of one thread each.

Nothing here imports torch: the environment counts when a library is loaded.
"""

import math
import os
from pathlib import Path

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
_LIMIT = Path("/sys/fs/cgroup/cpu.max")  # microseconds of cores' time in a period, or "max"
_chosen_here = False


def cores() -> int:
    """Those that this process may use: a batch system or a container gives it some of them."""
    if hasattr(os, "sched_getaffinity"):  # Linux
        count = len(os.sched_getaffinity(0))
    else:
        count = os.cpu_count() or 1
    try:
        time, period = map(int, _LIMIT.read_text().split())
    except (OSError, ValueError):  # no container, or one without a limit
        return count
    return max(1, min(count, math.ceil(time / period)))


def prefer_one_thread() -> None:
    """For libraries that are loaded from now on, unless OMP_NUM_THREADS says otherwise."""
    global _chosen_here
    if "OMP_NUM_THREADS" not in os.environ:  # MKL and OpenBLAS go by it where it is alone
        for name, value in ONE_THREAD.items():
            os.environ.setdefault(name, value)
        _chosen_here = True


def use_all_cores() -> None:
    """For work of large operations, which gains: as many of torch's threads as cores."""
    if _chosen_here:
        import torch

        torch.set_num_threads(cores())
