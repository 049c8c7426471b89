"""One progress bar for all long work: on a terminal a bar, in a pipe a line per ten percent of what takes long."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from math import isfinite
from time import monotonic
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from holdfast.recording.source import Recording

from holdfast.cli.terminal import guarded_console

SPEED_WINDOW_S = 600.0  # over which the time left is estimated: of long parallel runs one is done every few minutes
QUIET_S = 10.0  # what takes no longer says nothing in a pipe


@contextmanager
def progress_bar(title: str, begin_ns: int | None, end_ns: int | None) -> Iterator[Callable[[int], None] | None]:
    """Show on stderr how far a recording has been read: a bar on a terminal, `PipeLines` in a pipe."""
    if begin_ns is None or end_ns is None:
        yield None
        return
    total = max(end_ns - begin_ns, 1)
    if not sys.stderr.isatty():
        lines = PipeLines(title)
        yield lambda arrival_ns: lines.update((arrival_ns - begin_ns) / total)
        return
    from rich.progress import Progress

    console = guarded_console(stderr=True)
    with Progress(console=console, transient=True, speed_estimate_period=SPEED_WINDOW_S) as bar:
        task = bar.add_task(title, total=total)
        yield lambda arrival_ns: bar.update(task, completed=arrival_ns - begin_ns)


def reading_bar(
    title: str, recording: "Recording", start_s: float = 0.0, duration_s: float | None = None
) -> AbstractContextManager[Callable[[int], None] | None]:
    """Show how far a window of a recording, as in `Recording.read`, has been read."""
    if recording.start_ns is None or not isfinite(start_s):  # `Recording.read` says what is wrong with that
        return progress_bar(title, None, None)
    begin_ns = recording.start_ns + round(start_s * 1e9)
    ends_ns = [recording.end_ns, None if duration_s is None else begin_ns + round(duration_s * 1e9)]
    return progress_bar(title, begin_ns, min((end_ns for end_ns in ends_ns if end_ns is not None), default=None))


@contextmanager
def count_bar(title: str) -> Iterator[Callable[[int, int], None] | None]:
    """Show how many of all are done, as `progress_bar` does."""
    with progress_bar(title, 0, 1000) as show:
        yield None if show is None else lambda done, total: show(round(1000 * done / total))


class PipeLines:
    """Writes a line at each tenth of some work, once it has taken `QUIET_S`.

    Args:
        title: what is being done.
        now_s: a clock.
    """

    def __init__(self, title: str, now_s: Callable[[], float] = monotonic) -> None:
        self._title, self._now_s = title, now_s
        self._began_s = now_s()
        self._tenths = 0

    def update(self, fraction: float) -> None:
        """Take in how much is done, 0 to 1; what was told is not told again."""
        tenths = min(int(10.0 * fraction + 1e-9), 10)
        if tenths <= self._tenths:
            return
        taken_s = self._now_s() - self._began_s
        self._tenths = tenths
        if taken_s >= QUIET_S:
            left_s = taken_s * (1.0 - fraction) / fraction
            left = f", about {duration(left_s)} left" if tenths < 10 else ""
            click.echo(f"{self._title}: {10 * tenths} % after {duration(taken_s)}{left}", err=True)


def duration(seconds: float) -> str:
    """Return a time as people say it: `48 s`, `7 min`, `2.5 h`."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
