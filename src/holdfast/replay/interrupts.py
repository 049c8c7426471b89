"""Ctrl-C between two messages, never within one: what was computed is written, and written once."""

import signal
import threading
from types import FrameType, TracebackType
from typing import Self


class Uninterrupted:
    """What happens inside `with` is finished before Ctrl-C interrupts; outside it interrupts at once.

    `start` and `stop` enclose all of it. Where Ctrl-C has another handler, or in another thread, it changes nothing.
    """

    def __init__(self) -> None:
        self._is_busy = self._came = self._is_on = False

    def start(self) -> None:
        """Handle Ctrl-C from here on."""
        is_main = threading.current_thread() is threading.main_thread()
        self._is_on = is_main and signal.getsignal(signal.SIGINT) is signal.default_int_handler
        if self._is_on:
            signal.signal(signal.SIGINT, self._on_interrupt)

    def stop(self) -> None:
        """Give Ctrl-C its former handler back."""
        if self._is_on:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def _on_interrupt(self, _number: int, _frame: FrameType | None) -> None:
        if not self._is_busy:
            raise KeyboardInterrupt
        self._came = True

    def __enter__(self) -> Self:
        self._is_busy = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_busy = False
        if self._came:
            self._came = False
            raise KeyboardInterrupt
