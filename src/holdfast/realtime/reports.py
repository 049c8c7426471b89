"""What the optimiser reports besides its state: events, counts, smoothed nodes. Through a pipe that never blocks it."""

import os
import pickle
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from struct import Struct
from typing import NamedTuple

from holdfast.events import Event, Outcome
from holdfast.integrity.learnt_snapshot import LearntSnapshot

_LENGTH = Struct("<I")
CHUNK = 1 << 16


class Report(NamedTuple):
    """What happened since the report before; the counts are those since the process began.

    Attributes:
        smoothed: stamps and packed nodes that will not change any more.
        took_ns: how long each update took.
        waiting_for: what keeps it from starting.
        cpu_s: processor time of the process.
        fault: why it ends, if it ends by an error.
        learnt: of the sensors; None where it is what the report before said.
    """

    events: Sequence[Event]
    counts: Mapping[tuple[str, Outcome], int]
    smoothed: Sequence[tuple[int, bytes]]
    took_ns: Sequence[int]
    waiting_for: str
    cpu_s: float
    fault: str = ""
    learnt: LearntSnapshot | None = None


class Outbox:
    """The writing end; what does not fit into the pipe waits here."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._waiting = bytearray()
        os.set_blocking(descriptor, False)

    def send(self, report: Report) -> None:
        """Send a report, as much of it as the pipe takes."""
        body = pickle.dumps(report)
        self._waiting += _LENGTH.pack(len(body)) + body
        self.flush()

    def flush(self) -> None:
        """Send what waits, as much as the pipe takes."""
        while self._waiting:
            try:
                del self._waiting[: os.write(self._descriptor, self._waiting[:CHUNK])]
            except BlockingIOError:
                return

    def finish(self) -> None:
        """Send all that waits, if there is someone who reads it."""
        os.set_blocking(self._descriptor, True)
        with suppress(BrokenPipeError):
            self.flush()


class Inbox:
    """The reading end."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._part = bytearray()
        self.is_open = True
        os.set_blocking(descriptor, False)

    def fetch(self) -> int:
        """Take what is in the pipe, unread; return how many bytes wait to be read."""
        while self.is_open:
            try:
                chunk = os.read(self._descriptor, CHUNK)
            except BlockingIOError:
                break
            self.is_open = bool(chunk)
            self._part += chunk
        return len(self._part)

    def receive(self) -> Iterator[Report]:
        """Yield the reports that are there."""
        self.fetch()
        while len(self._part) >= _LENGTH.size:
            end = _LENGTH.size + _LENGTH.unpack_from(self._part)[0]
            if len(self._part) < end:
                return
            report: Report = pickle.loads(self._part[_LENGTH.size : end])
            del self._part[:end]
            yield report

    def close(self) -> None:
        """Receive no more."""
        self.is_open = False
        os.close(self._descriptor)
