"""Ctrl-C between two messages, never within one: what was computed is written, and written once."""

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Self

Handler = Callable[[int, FrameType | None], object]


class Uninterrupted:
    """What happens inside `with` is finished before the handler of Ctrl-C is called; outside it is called at once.

    `start` and `stop` enclose all of it. Where Ctrl-C is ignored, or in another thread, it changes nothing.
    """

    def __init__(self) -> None:
        self._is_busy = self._came = False
        self._before: Handler | None = None

    def start(self) -> None:
        """Handle Ctrl-C from here on."""
        before = signal.getsignal(signal.SIGINT)
        if threading.current_thread() is threading.main_thread() and callable(before):
            self._before = before
            signal.signal(signal.SIGINT, self._on_interrupt)

    def stop(self) -> None:
        """Give Ctrl-C its former handler back."""
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _on_interrupt(self, number: int, frame: FrameType | None) -> None:
        if self._is_busy or self._before is None:
            self._came = True
        else:
            self._before(number, frame)

    def __enter__(self) -> Self:
        self._is_busy = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_busy = False
        if self._came and self._before is not None:
            self._came = False
            self._before(signal.SIGINT, None)
