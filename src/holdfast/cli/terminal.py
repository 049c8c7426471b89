"""The one place through which everything is printed: no control character of an input reaches the terminal."""

import os
import re
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from holdfast.printable import one_line

if TYPE_CHECKING:
    from rich.console import Console

# what rich writes between texts: colours, where the cursor is, whether it is seen
OF_RICH = re.compile(r"(\x1b\[[0-9;]*[mAK]|\x1b\[\?25[lh]|[\r\n\t])")

MAX_LINE = 2000
"""Of a message: no honest one is longer."""


class Guarded:
    """A stream that escapes control characters, except for the ends of lines and tabs."""

    kept = re.compile(r"([\n\t])")

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text."""
        parts = self.kept.split(text)  # every second one is kept
        self._stream.write("".join(part if k % 2 else one_line(part) for k, part in enumerate(parts)))
        return len(text)

    @property
    def rich_proxied_file(self) -> "OfRich":
        """Where rich writes instead, also from a console that was not made by `guarded_console`."""
        return OfRich(self._stream)

    def __getattr__(self, name: str) -> Any:
        """Return all else from the stream."""
        return getattr(self._stream, name)


class OfRich(Guarded):
    """A stream for rich, whose own control sequences pass."""

    kept = OF_RICH


def shortened(line: str) -> str:
    """Return a line of a message, cut where it is longer than anybody reads, its control characters escaped."""
    cut = line if len(line) <= MAX_LINE else f"{line[:MAX_LINE]} ... ({len(line) - MAX_LINE} characters more)"
    return one_line(cut)


@contextmanager
def guarded() -> Iterator[None]:
    """Guard what is printed meanwhile; what goes to a stream that is closed is dropped."""
    before = sys.stdout, sys.stderr
    with ExitStack() as stack:
        streams = (stream or stack.enter_context(Path(os.devnull).open("w", encoding="utf-8")) for stream in before)
        sys.stdout, sys.stderr = map(Guarded, streams)
        try:
            yield
        finally:
            sys.stdout, sys.stderr = before


def drop_output() -> None:
    """Have what is still to be printed go nowhere: the end of the program would fail on it once more."""
    with suppress(OSError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def guarded_console(*, stderr: bool = False, **options: Any) -> "Console":
    """Return a console of rich that escapes the control characters in what it is given to print."""
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment

    class GuardedConsole(Console):
        def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
            for segment in super().render(renderable, options):
                text = "\n".join(map(one_line, segment.text.split("\n")))
                yield segment if segment.control else segment._replace(text=text)

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError  # as where rich does not print: whoever has read enough is no failure

    stream = sys.stderr if stderr else sys.stdout
    return GuardedConsole(file=getattr(stream, "rich_proxied_file", stream), **options)
