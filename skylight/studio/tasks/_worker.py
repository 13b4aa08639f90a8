"""The worker process: a line of JSON for each task in, lines of JSON out.

    {"task": "photo", "arguments": {...}}          in
    {"stage": "finding the face", "share": 0.5}    out, some
    {"result": {...}}                              out, once; or
    {"error": "one line", "fault": "input"}        out, once: "input" or "program"

It ends with its input, so it never outlives the server by more than the task in hand, which stops
at its next word of progress.
"""

import json
import os
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from importlib import import_module
from typing import Any, TextIO

from skylight.errors import InputError, SkylightError, explain
from skylight.work._progress import StageProgress

Task = Callable[..., dict[str, Any]]

# Imported on use: what reads photographs does not wait for what makes probes.
_TASKS = {
    "warm": ("skylight.studio.tasks._worker", "warm"),
    "photo": ("skylight.studio.tasks._uploads", "see_photo"),
    "map": ("skylight.studio.tasks._uploads", "see_map"),
    "estimate": ("skylight.studio.tasks._light", "estimate_light"),
    "portrait": ("skylight.studio.tasks._portrait", "take_apart"),
    "lamps": ("skylight.studio.tasks._light", "light_edited"),
    "code": ("skylight.studio.tasks._code", "code_light"),
    "voxel": ("skylight.studio.tasks._probes", "make_voxel_probe"),
    "partitions": ("skylight.studio.tasks._probes", "make_partition_probe"),
    "sky": ("skylight.studio.tasks._sky", "describe_sky"),
    "designs": ("skylight.studio.tasks._probes", "describe_designs"),
}
_PAUSE_S = 0.05  # between words of progress in one stage


def main() -> None:
    """Work until the input ends."""
    # what libraries print must not end up between the lines
    out = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    os.dup2(2, 1)
    warnings.simplefilter("ignore")  # what libraries tell programmers
    for line in sys.stdin:
        answer = _done(json.loads(line), out)
        out.write(json.dumps(answer, allow_nan=False) + "\n")


def _done(message: dict[str, Any], out: TextIO) -> dict[str, Any]:
    module, name = _TASKS[message["task"]]
    try:
        task: Task = getattr(import_module(module), name)
        result = task(**message["arguments"], tell=_teller(out))
        json.dumps(result, allow_nan=False)
    except BrokenPipeError:
        raise SystemExit(0) from None  # the server is gone
    except Exception as error:
        if not isinstance(error, SkylightError):
            traceback.print_exc()
        line, _ = explain(error, more="the server's terminal tells more")
        return {"error": line, "fault": "input" if isinstance(error, InputError) else "program"}
    return {"result": result}


def _teller(out: TextIO) -> StageProgress:
    """Writes progress, at most 20 words a second but every new stage."""
    last: tuple[str, float] = ("", 0.0)

    def tell(stage: str, share: float) -> None:
        nonlocal last
        now = time.monotonic()
        if stage != last[0] or share >= 1 or now - last[1] >= _PAUSE_S:
            last = (stage, now)
            out.write(json.dumps({"stage": stage, "share": min(1.0, max(0.0, share))}) + "\n")

    return tell


def warm(modules: list[str], *, tell: StageProgress) -> dict[str, Any]:
    """Import what the first task will need."""
    for done, module in enumerate(modules):
        tell("loading", done / len(modules))
        import_module(module)
    return {}


if __name__ == "__main__":
    main()
