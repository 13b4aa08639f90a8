"""The files of results that measuring tools write."""

import json
import platform
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import torch

from skylight.evaluation.main import commit
from skylight.io.json_files import write_json


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
