# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands run one after another in processes of their own, watched without waiting."""

import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import IO

PATIENCE_S = 5.0  # for a process that was asked to end
_ERROR, _DOUBT = "skylight: ", "skylight: take care: "
_POSIX = os.name == "posix"


class Failure(Exception):
    """``str(error)`` is a line for people: what is wrong and what to do about it."""

    def __str__(self) -> str:
        return "".join(each if each.isprintable() else " " for each in super().__str__())


@dataclass(frozen=True)
class Step:
    """A command; ``check`` is given what it printed, and raises :class:`Failure`."""

    stage: str
    command: list[str]
    check: Callable[[str], None] | None = None


class Run:
    """Steps that go on while :meth:`poll` is called now and then.

    ``state`` is "running", "done", "failed" (``error`` says why) or "cancelled"; ``stage`` and
    ``share`` (0 to 1) are those of the step, or what its process tells of itself; ``doubts`` are
    the lines about what to take care of.
    """

    def __init__(self, steps: list[Step]) -> None:
        self.state = "running"
        self.stage, self.share, self.error = "", 0.0, ""
        self.doubts: list[str] = []
        self._left = list(steps)
        self._cancelled = False
        self._kill_at = float("inf")
        self._begin()

    def poll(self) -> str:
        """Take note of what has happened, start the next step where one ended; the state."""
        if self.state != "running":
            return self.state
        for line in _waiting(self._told):
            self._hear(line)
        code = self._process.poll()
        if code is None:
            if time.monotonic() > self._kill_at:
                self._signal(kill=True)
            return self.state
        for reader in self._readers:
            reader.join(1.0)  # a process left over may hold the pipes open
        for line in _waiting(self._told):
            self._hear(line)
        if self._cancelled:
            self.state = "cancelled"
        elif code != 0:
            self._fail(self._last_error or _unexplained(code))
        else:
            self._go_on()
        return self.state

    def cancel(self) -> None:
        """Ask the process to end, as Ctrl-C does, so that it leaves nothing half made."""
        if self.state == "running" and not self._cancelled:
            self._cancelled, self.stage = True, "cancelling"
            self._kill_at = time.monotonic() + PATIENCE_S
            self._signal(kill=False)

    def kill(self) -> None:
        """End at once, for when Blender ends or opens another file."""
        if self.state == "running":
            self.state = "cancelled"
            self._signal(kill=True)
            self._process.wait()

    def _begin(self) -> None:
        self._step = self._left.pop(0)
        self.stage, self.share = self._step.stage, 0.0
        self._last_error = ""
        self._told: SimpleQueue[str] = SimpleQueue()
        self._printed: SimpleQueue[str] = SimpleQueue()
        try:
            self._process = subprocess.Popen(
                self._step.command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                encoding="utf-8",
                errors="replace",
                # a group of its own: its workers get the signals too, and Blender does not
                start_new_session=_POSIX,
                creationflags=0 if _POSIX else subprocess.CREATE_NO_WINDOW,
            )
        except (OSError, ValueError) as error:  # ValueError: a zero byte in a path
            name = self._step.command[0]
            self._fail(f"{name} cannot be started ({error}): set the path in the preferences")
            return
        self._readers = [
            threading.Thread(target=_read, args=(stream, lines), daemon=True)
            for stream, lines in (
                (self._process.stdout, self._printed),
                (self._process.stderr, self._told),
            )
        ]
        for reader in self._readers:
            reader.start()

    def _go_on(self) -> None:
        try:
            if self._step.check is not None:
                self._step.check("".join(_waiting(self._printed)))
        except Failure as failure:
            self._fail(str(failure))
            return
        if self._left:
            self._begin()
        else:
            self.state = "done"

    def _fail(self, error: str) -> None:
        self.state, self.error = "failed", error

    def _hear(self, line: str) -> None:
        progress = parse_progress(line)
        if progress is not None:
            if not self._cancelled:
                self.stage, self.share = progress
        elif line.startswith(_DOUBT):
            self.doubts.append(line.removeprefix(_DOUBT).strip())
        elif line.startswith(_ERROR):
            self._last_error = line.removeprefix(_ERROR).strip()

    def _signal(self, *, kill: bool) -> None:
        if not _POSIX:
            # it has no Ctrl-C for a process without a console; its workers end with it
            command = ["taskkill", "/F", "/T", "/PID", str(self._process.pid)]
            subprocess.run(command, capture_output=True, check=False)
            return
        with suppress(ProcessLookupError):  # it has ended by itself
            os.killpg(self._process.pid, signal.SIGKILL if kill else signal.SIGINT)


def parse_progress(line: str) -> tuple[str, float] | None:
    """(stage, share) of a line such as {"stage": "tracing light", "share": 0.25}, else None."""
    if not line.startswith("{"):
        return None
    try:
        told = json.loads(line)
        stage, share = told["stage"], float(told["share"])
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None
    return (stage, share) if isinstance(stage, str) and 0 <= share <= 1 else None


def _unexplained(code: int) -> str:
    if code < 0:
        return f"skylight was ended by signal {-code}: perhaps memory ran out"
    if code == 2:
        return "skylight does not know this command: install the version that this extension needs"
    return f"skylight ended with code {code}: run it in a terminal to see why"


def _read(stream: IO[str], lines: "SimpleQueue[str]") -> None:
    with stream:
        for line in stream:
            lines.put(line)


def _waiting(lines: "SimpleQueue[str]") -> Iterator[str]:
    while True:
        try:
            yield lines.get_nowait()
        except Empty:
            return
