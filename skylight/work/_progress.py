"""Progress callbacks, and progress on standard error: a bar for people, or lines for programs."""

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Literal, TypeVar

Progress = Callable[[float], None]  # the share that is done, 0 to 1
StageProgress = Callable[[str, float], None]  # a stage's name, and the share of it that is done
CountProgress = Callable[[int, int], None]  # items done, items in all
Tell = Callable[[str], None]  # a line for people
ProgressForm = Literal["bar", "json"]  # for people; for programs that start a command


LEAST_STEP = 0.01  # of a stage's share: less is no news
Item = TypeVar("Item")


def silent(stage: str, share: float) -> None:
    """A StageProgress that nobody sees."""


@contextmanager
def stage_bar(
    form: ProgressForm = "bar", *, log_every_s: float | None = None
) -> Iterator[StageProgress]:
    """Shows a stage's name and its share done.

    "bar": where standard error is a terminal; else nothing, or the stage's name in a line, at most
    one each ``log_every_s`` seconds. "json": an object on a line of its own for each new stage and
    each hundredth of it, ``{"stage": "tracing light", "share": 0.25}``.
    """
    if form == "json":
        yield _json_lines()
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress as Bar,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
    )

    console = Console(stderr=True, soft_wrap=True)  # lines that are printed meanwhile stay whole
    if log_every_s is not None and not console.is_terminal:
        yield _lines(log_every_s)
        return
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description:<22}"),
        BarColumn(bar_width=32),
        TimeElapsedColumn(),
    )
    with Bar(
        *columns,
        console=console,
        transient=True,
        disable=not console.is_terminal,
        redirect_stdout=sys.stdout.isatty(),  # else what is printed misses the file it is meant for
    ) as bar:
        task = bar.add_task("starting", total=1.0)

        def tell(stage: str, share: float) -> None:
            bar.update(task, description=stage, completed=share)

        yield tell


def _lines(every_s: float) -> StageProgress:
    told = time.monotonic()

    def tell(stage: str, share: float) -> None:
        nonlocal told
        if time.monotonic() - told >= every_s:
            told = time.monotonic()
            print(stage, file=sys.stderr, flush=True)

    return tell


def _json_lines() -> StageProgress:
    told = "", 0.0

    def tell(stage: str, share: float) -> None:
        nonlocal told
        if stage != told[0] or abs(share - told[1]) >= LEAST_STEP:
            told = stage, share
            line = json.dumps({"stage": stage, "share": round(share, 4)})
            print(line, file=sys.stderr, flush=True)

    return tell


def with_time_left(thing: str, tell: StageProgress) -> CountProgress:
    """StageProgress by counts; the time left goes by those done since the first report."""
    start: tuple[float, int] | None = None

    def progress(done: int, total: int) -> None:
        nonlocal start
        now = time.monotonic()
        start = start or (now, done)
        text = f"{thing} {done} of {total}"
        if done > start[1]:
            left = (now - start[0]) / (done - start[1]) * (total - done)
            if left > 2 * 3600:
                text += f", {left / 3600:.1f} h left"
            else:
                text += f", {left / 60:.0f} min left" if left > 90 else f", {left:.0f} s left"
        tell(text, done / total)

    return progress


def counted(items: Sequence[Item], thing: str, tell: StageProgress) -> Iterator[Item]:
    """The items, each told when it is taken, with the time left of :func:`with_time_left`."""
    progress = with_time_left(thing, tell)
    for done, item in enumerate(items):
        progress(done, len(items))
        yield item
