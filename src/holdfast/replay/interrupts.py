"""Ctrl-C between two messages, never within one: what was computed is written, and written once."""

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Self

Handler = Callable[[int, FrameType | None], object]
STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Uninterrupted:
    """What happens inside `with` is finished before the handler of Ctrl-C is called; outside it is called at once.

    So it is with the end that a service manager asks for, and a closed terminal, where they have a handler. `start` and
    `stop` enclose all of it. Where a signal is ignored, or in another thread, it changes nothing.
    """

    def __init__(self) -> None:
        self._is_busy = False
        self._came: int | None = None
        self._before: dict[int, Handler] = {}

    def start(self) -> None:
        """Handle the signals from here on."""
        if threading.current_thread() is not threading.main_thread():
            return
        for number in STOPS:
            before = signal.getsignal(number)
            if callable(before):
                self._before[number] = before
                signal.signal(number, self._on_interrupt)

    def stop(self) -> None:
        """Give the signals their former handlers back."""
        for number, before in self._before.items():
            signal.signal(number, before)

    def _on_interrupt(self, number: int, frame: FrameType | None) -> None:
        if self._is_busy:
            self._came = number
        else:
            self._before[number](number, frame)

    def __enter__(self) -> Self:
        self._is_busy = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_busy = False
        if self._came is not None:
            number, self._came = self._came, None
            self._before[number](number, None)
