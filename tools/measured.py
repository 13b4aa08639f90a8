"""The files of results that measuring tools write."""

import json
import platform
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import torch

from skylight.evaluation._main import commit
from skylight.io._bounded import json_content, write_json


def kept(path: Path, measure: Callable[[], Any]) -> Any:
    """What ``measure`` gives, from the JSON file of an earlier run where there is one."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, measure())
    return json_content(path)


def write_measured(
    path: Path, *, name: str, what: str, command: str, begun: float, facts: Mapping[str, object]
) -> None:
    """Write and print the facts of a run with seed 0 that began at ``time.time() == begun``."""
    write_json(
        path,
        {
            "name": name,
            "what": what,
            "command": command,
            "commit": commit(),
            "date": datetime.now(UTC).date().isoformat(),
            "machine": f"{platform.machine()}, torch {torch.__version__}",
            "seed": 0,
            "seconds": time.time() - begun,
            **facts,
        },
    )
    print(json.dumps(facts, indent=2))
