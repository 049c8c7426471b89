"""A process of its own for what must not hold up the IMU path: it is fed without ever waiting for it."""

import os
import pickle
import queue
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Thread
from typing import NamedTuple

MAX_WAITING_BATCHES = 4096
"""For a slow consumer: 20 s at 200 wake-ups a second."""
FINISH_S = 30.0
NICE = 10
"""Whoever feeds comes first."""


class Record(NamedTuple):
    """One message with the time at which it was received or published."""

    topic: str
    type_name: str
    data: bytes
    time_ns: int


class Consumer:
    """The receiving end, in the other process."""

    def __init__(self, incoming: Connection, complaints: Connection) -> None:
        self._incoming = incoming
        self._complaints = complaints

    def batches(self, timeout_s: float | None = None) -> "Batches":
        """Iterate over what is fed, until the feed is closed or its process is gone; see `Batches`."""
        return Batches(self._incoming, timeout_s)

    def complain(self, text: str) -> None:
        """Report to the feeding process, in one line, that something is wrong."""
        with suppress(OSError):  # it is gone
            self._complaints.send(text)


class Batches:
    """Iterates over lists of records; after `timeout_s` without one it gives an empty list."""

    def __init__(self, incoming: Connection, timeout_s: float | None) -> None:
        self._incoming = incoming
        self._timeout_s = timeout_s

    def __iter__(self) -> "Batches":
        """Return itself."""
        return self

    def __next__(self) -> list[Record]:
        """Return the next list."""
        try:
            if self._timeout_s is not None and not self._incoming.poll(self._timeout_s):
                return []
            batch: list[Record] = pickle.loads(self._incoming.recv_bytes())
        except (EOFError, OSError):
            raise StopIteration from None
        return batch


class Feed:
    """Feeds a consumer in another process; a context manager that lets it finish.

    Args:
        name: what the process is for, in one word.
        consume: function of a module, called there with a `Consumer` and `arguments`.
    """

    def __init__(self, name: str, consume: Callable[..., None], *arguments: object) -> None:
        context = get_context("spawn")
        incoming, self._outgoing = context.Pipe(duplex=False)
        self._complaints, complaints = context.Pipe(duplex=False)
        self.name = name
        self.dropped = 0
        self._waiting: queue.Queue[Sequence[Record] | None] = queue.Queue(MAX_WAITING_BATCHES)
        self._process = context.Process(target=_run, args=(consume, incoming, complaints, *arguments), name=name)
        self._process.start()
        incoming.close()
        complaints.close()
        self._sender = Thread(target=self._send, name=f"feed {name}", daemon=True)
        self._sender.start()

    def offer(self, batch: Sequence[Record]) -> None:
        """Pass records on; if the consumer is too slow for too long, they are dropped and counted."""
        try:
            self._waiting.put_nowait(batch)
        except queue.Full:
            self.dropped += len(batch)

    def complaint(self) -> str | None:
        """Return the complaint of the consumer since the last call, or None."""
        try:
            return str(self._complaints.recv()) if self._complaints.poll() else None
        except (EOFError, OSError):
            return None

    @property
    def alive(self) -> bool:
        """Whether the process still takes records."""
        return self._process.is_alive()

    def close(self) -> None:
        """Let the consumer take what is left and end; one that hangs is ended by force. Closing twice does no harm."""
        if self._sender.is_alive():
            with suppress(queue.Full):
                self._waiting.put(None, timeout=FINISH_S)
            self._sender.join(FINISH_S)
        self._process.join(FINISH_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _send(self) -> None:
        while True:
            batch = self._waiting.get()
            try:
                if batch is not None:
                    self._outgoing.send_bytes(pickle.dumps(batch, protocol=5))
                    continue
            except OSError:  # the consumer is gone; go on emptying the queue, what it holds is lost
                self.dropped += len(batch or ())
                continue
            self._outgoing.close()
            return


def _run(
    consume: Callable[..., None], incoming: Connection, complaints: Connection, *arguments: object
) -> None:  # pragma: no cover (in the other process)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the feeding process decides
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    os.nice(NICE)
    consumer = Consumer(incoming, complaints)
    try:
        consume(consumer, *arguments)
    except Exception as error:
        consumer.complain(f"{type(error).__name__}: {error}")
        sys.exit(1)
