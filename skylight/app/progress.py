"""Progress on standard error for people who watch, and silence for pipes and files."""

from collections.abc import Iterator
from contextlib import contextmanager

from skylight.inverse.photo import Progress


@contextmanager
def stage_bar() -> Iterator[Progress]:
    """A bar that shows a stage's name and its share done; nothing where nobody watches."""
    from rich.console import Console
    from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description:<22}"),
        BarColumn(bar_width=32),
        TimeElapsedColumn(),
    )
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("starting", total=1.0)

        def tell(stage: str, share: float) -> None:
            bar.update(task, description=stage, completed=share)

        yield tell
