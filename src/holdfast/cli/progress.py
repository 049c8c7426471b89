"""One progress bar for all long work: on a terminal, and quiet in a pipe."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress_bar(title: str, begin_ns: int | None, end_ns: int | None) -> Iterator[Callable[[int], None] | None]:
    """Show how far a recording has been read, on a terminal; nothing in a pipe."""
    if not sys.stderr.isatty() or begin_ns is None or end_ns is None:
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=max(end_ns - begin_ns, 1))
        yield lambda arrival_ns: bar.update(task, completed=arrival_ns - begin_ns)
