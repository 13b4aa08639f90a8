"""Kill long commands at random times and check that they end as an uninterrupted run does.

    python tools/kill_runs.py                             20 kills of each scenario
    python tools/kill_runs.py training capture --kills 10  10 of each

Writes ``benchmarks/results/kill-runs.json``. What each scenario gave is kept in ``--kept``, by
commit: run again, only those that are missing are run.
"""

import argparse
import sys
import tempfile
import time
from dataclasses import asdict
from functools import partial
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
from skylight.evaluation._main import commit  # noqa: E402
from tests.faults.kills import kill_runs  # noqa: E402
from tools.measured import kept, write_measured  # noqa: E402

SCENARIOS = (
    "training",
    "simulation",
    "capture",
    "batch",
    "bundle",
    "film",
    "viewer",
    "portrait",
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenarios", nargs="*", default=SCENARIOS, help=", ".join(SCENARIOS))
    parser.add_argument("--kills", type=int, default=20, help="of each scenario")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out", type=Path, default=ROOT / "benchmarks" / "results" / "kill-runs.json"
    )
    parser.add_argument("--kept", type=Path, default=ROOT / "out" / "kill-runs")
    options = parser.parse_args()
    place = options.kept / commit() / f"{options.kills} kills, seed {options.seed}"
    facts: dict[str, dict[str, object]] = {}
    for name in options.scenarios:
        measure = partial(killed, name, options.kills, options.seed)
        # of changed code nothing is kept: it may change again
        facts[name] = measure() if place.match("*+/*") else kept(place / f"{name}.json", measure)
        print(name, facts[name], flush=True)
    write_measured(
        options.out,
        name="kill-runs",
        what="Commands killed with SIGKILL at random moments, resumed, and compared with an "
        "undisturbed run; differences lists what was not equal",
        command=f"python tools/kill_runs.py {' '.join(options.scenarios)} --kills {options.kills}"
        f" --seed {options.seed}",
        begun=time.time() - sum(float(str(each["seconds"])) for each in facts.values()),
        facts={
            "kills": sum(int(str(each["kills"])) for each in facts.values()),
            "different": sum(len(list(each["differences"])) for each in facts.values()),  # type: ignore[call-overload]
            "scenarios": facts,
        },
    )


def killed(name: str, kills: int, seed: int) -> dict[str, object]:
    """What came of so many kills of a scenario, and how long that took."""
    begun = time.monotonic()
    scenario = import_module(f"tests.faults.scenarios.{name}")
    with tempfile.TemporaryDirectory(prefix=f"skylight-{name}-") as folder:
        outcome = kill_runs(scenario, Path(folder), kills=kills, seed=seed)
    differences = list(outcome.differences)
    seconds = round(time.monotonic() - begun)
    return asdict(outcome) | {"differences": differences, "seconds": seconds}


if __name__ == "__main__":
    main()
