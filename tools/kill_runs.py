"""Kill long commands at random times and check that they end as an uninterrupted run does.

    python tools/kill_runs.py                             20 kills of each scenario
    python tools/kill_runs.py training capture --kills 10  10 of each

Writes ``benchmarks/results/kill-runs.json``.
"""

import argparse
import sys
import tempfile
import time
from dataclasses import asdict
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
from tests.faults.kills import kill_runs  # noqa: E402
from tools.measured import write_measured  # noqa: E402

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
    options = parser.parse_args()
    begun = time.time()
    facts: dict[str, dict[str, object]] = {}
    for name in options.scenarios:
        scenario = import_module(f"tests.faults.scenarios.{name}")
        with tempfile.TemporaryDirectory(prefix=f"skylight-{name}-") as folder:
            outcome = kill_runs(scenario, Path(folder), kills=options.kills, seed=options.seed)
        facts[name] = asdict(outcome) | {"differences": list(outcome.differences)}
        print(name, facts[name], flush=True)
    write_measured(
        options.out,
        name="kill-runs",
        what="Commands killed with SIGKILL at random moments, resumed, and compared with an "
        "undisturbed run; differences lists what was not equal",
        command=f"python tools/kill_runs.py {' '.join(options.scenarios)} --kills {options.kills}",
        begun=begun,
        facts={
            "kills": sum(int(str(each["kills"])) for each in facts.values()),
            "different": sum(len(list(each["differences"])) for each in facts.values()),  # type: ignore[call-overload]
            "scenarios": facts,
        },
    )


if __name__ == "__main__":
    main()
