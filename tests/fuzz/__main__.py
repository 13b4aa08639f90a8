"""One target, in this process.

    python -m tests.fuzz TARGET... --inputs N      mutations of the seeds, the same every time
    python -m tests.fuzz TARGET --seconds S        coverage-guided (atheris), findings kept
    python -m tests.fuzz TARGET --again FILE       one finding

Prints a line of JSON for each target. A finding, a hang beyond ``TIMEOUT_S`` or more memory than
``MEMORY_MB`` ends the process.
"""

import argparse
import faulthandler
import json
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from skylight.errors import SkylightError
from tests.fuzz.files import clear
from tests.fuzz.mutate import changed, mutated
from tests.fuzz.targets import NAMES
from tests.peak_memory import peak_mb

TIMEOUT_S = 20.0  # an input, on a busy machine
MEMORY_MB = 3072  # the process, its libraries included


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="+", choices=NAMES)
    parser.add_argument("--inputs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=int)
    parser.add_argument("--findings", type=Path, default=Path("fuzz-findings"))
    parser.add_argument("--again", type=Path)
    options = parser.parse_args()
    for name in options.targets:
        if options.again is not None:
            _again(name, options.again)
        elif options.seconds is None:
            print(json.dumps(_mutate(name, options.inputs, options.seed)), flush=True)
        else:
            _guided(name, options.seconds, options.seed, options.findings)


def _again(name: str, finding: Path) -> None:
    """Its errors, or that it took too long, end the process with a code."""
    read = import_module(f"tests.fuzz.targets.{name}").read
    started = time.process_time()
    told = "read" if one(read, finding.read_bytes()) else "refused"
    spent = time.process_time() - started
    print(f"{told} in {spent:.1f} s of the processor")
    if spent > TIMEOUT_S:
        sys.exit(1)


def one(read: Callable[[bytes], None], content: bytes) -> bool:
    """Whether it was read; False where it was refused in one clear line."""
    try:
        read(content)
    except SkylightError as error:
        clear(error)
        return False
    return True


def _mutate(name: str, count: int, seed: int) -> dict[str, object]:
    target = import_module(f"tests.fuzz.targets.{name}")
    done, slowest = [], 0.0
    for number, content in enumerate(mutated(target.seeds(), count, seed)):
        faulthandler.dump_traceback_later(TIMEOUT_S, exit=True)
        started = time.monotonic()
        try:
            done.append(one(target.read, content))
        except BaseException:
            print(f"finding: {name}, input {number}: {content[:2000]!r}", file=sys.stderr)
            raise
        slowest = max(slowest, time.monotonic() - started)
        faulthandler.cancel_dump_traceback_later()
    peak = peak_mb()
    assert peak < MEMORY_MB, f"{name}: {peak:.0f} MB"
    return {
        "target": name,
        "inputs": len(done),
        "read": sum(done),
        "slowest_s": round(slowest, 3),
        "peak_mb": round(peak),
    }


def _guided(name: str, seconds: int, seed: int, findings: Path) -> None:
    """libFuzzer ends the process, whatever comes of it."""
    import atheris

    with atheris.instrument_imports(include=["skylight", "blender", "trimesh", "OpenEXR"]):
        target = import_module(f"tests.fuzz.targets.{name}")
    corpus = findings / "corpus" / name
    corpus.mkdir(parents=True, exist_ok=True)
    seeds = target.seeds()
    for number, content in enumerate(seeds):
        (corpus / f"seed{number:02d}").write_bytes(content)
    arguments = [
        sys.argv[0],
        str(corpus),
        f"-max_total_time={seconds}",
        f"-timeout={TIMEOUT_S:.0f}",
        f"-rss_limit_mb={MEMORY_MB}",
        f"-seed={seed + 1}",
        "-max_len=65536",
        "-print_final_stats=1",
        f"-artifact_prefix={findings}/{name}-",
    ]

    def mutate(content: bytes, most: int, seed: int) -> bytes:
        """By turns libFuzzer's changes and ours, which know numbers of files and JSON."""
        mutation = atheris.Mutate(content, most) if seed % 2 else changed(content, seeds, seed)
        return mutation[:most]

    atheris.Setup(
        arguments, lambda content: one(target.read, content) and None, custom_mutator=mutate
    )
    atheris.Fuzz()


if __name__ == "__main__":
    main()
