"""How far a recording has been read, for whoever asks."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def shown(start_ns: int | None, end_ns: int | None, wanted: bool) -> Iterator[Callable[[int], None] | None]:
    """Show a bar on a terminal or in a notebook, if it is wanted and the length is known."""
    if not wanted or start_ns is None or end_ns is None:
        yield None
        return
    from rich.progress import Progress

    with Progress() as bar:
        task = bar.add_task("estimating", total=max(end_ns - start_ns, 1))
        yield lambda arrival_ns: bar.update(task, completed=arrival_ns - start_ns)
