"""One progress bar for all long work: on a terminal, and quiet in a pipe."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

SPEED_WINDOW_S = 600.0  # over which the time left is estimated: of long parallel runs one is done every few minutes


@contextmanager
def progress_bar(title: str, begin_ns: int | None, end_ns: int | None) -> Iterator[Callable[[int], None] | None]:
    """Show how far a recording has been read, on a terminal; nothing in a pipe."""
    if not sys.stderr.isatty() or begin_ns is None or end_ns is None:
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, speed_estimate_period=SPEED_WINDOW_S) as bar:
        task = bar.add_task(title, total=max(end_ns - begin_ns, 1))
        yield lambda arrival_ns: bar.update(task, completed=arrival_ns - begin_ns)


@contextmanager
def count_bar(title: str) -> Iterator[Callable[[int, int], None] | None]:
    """Show how many of all are done, on a terminal; nothing in a pipe."""
    with progress_bar(title, 0, 1000) as show:
        yield None if show is None else lambda done, total: show(round(1000 * done / total))
