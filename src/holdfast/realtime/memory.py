"""The memory that two processes share: control words, two rings and two slots, in one nameless file.

The file has no name, so that nothing is left behind however the processes end; the other process inherits its
descriptor. Every byte has one writer. What is longer than a word carries a checksum, so that a reader knows a whole
record from one that is just being written, whatever the order in which a processor makes stores visible.
"""

import mmap
import os
from enum import IntEnum
from tempfile import TemporaryFile

import numpy as np
from numpy.typing import NDArray

from holdfast.kernel.ring import find_checksum

WORDS = 8
WORD = 8  # bytes
ROW = 2 * WORD  # what a row has beside its body: number and checksum

Words = NDArray[np.int64]
NO_WORDS = np.zeros((0, 0), np.int64)


class Word(IntEnum):
    """The control words: 64-bit integers, written by the optimiser."""

    HEARTBEAT = 0  # grows while it lives
    SAMPLES = 1  # how many have been taken in, and what they led to is published
    REQUESTS = 2  # so for measurements
    BEGUN = 3  # requests that have been read, and are not read again by a successor
    WAITING = 4  # measurements that wait for the IMU


class Memory:
    """A nameless file of a fixed size, mapped into this process."""

    def __init__(self, size: int, descriptor: int | None = None) -> None:
        self.descriptor = nameless_file(size) if descriptor is None else descriptor
        self.map = mmap.mmap(self.descriptor, size)
        self.words = memoryview(self.map)[: 8 * WORDS].cast("q")

    def close(self) -> None:
        """Give the memory back."""
        self.words.release()
        self.map.close()
        os.close(self.descriptor)


def nameless_file(size: int) -> int:
    """Return the descriptor of a file of a size [bytes] that vanishes with whoever holds it."""
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("holdfast")
    else:
        with TemporaryFile() as file:
            descriptor = os.dup(file.fileno())
    os.ftruncate(descriptor, size)
    return descriptor


class Ring:
    """The last rows of one writer; the reader asks for them by number.

    Attributes:
        words: (rows, 2 + body / 8) number, body and checksum, as integers; so that `holdfast.kernel.ring` writes them.
        count: (1,) how many rows were written by this end, for the same.

    Args:
        memory: where it lies, from `offset` on.
        rows: how many are kept.
        body: length of a row [bytes], a multiple of 8.
    """

    def __init__(self, memory: Memory, offset: int, rows: int, body: int) -> None:
        self.rows = rows
        self.words = _words(memory, offset, rows * (2 + body // WORD)).reshape(rows, -1)
        self.end = offset + self.words.nbytes
        self.count: Words = np.zeros(1, np.int64)

    @property
    def written(self) -> int:
        """How many rows were written by this end."""
        return int(self.count[0])

    def push(self, body: bytes) -> None:
        """Append a row."""
        _write(self.words[self.written % self.rows], self.written, body)
        self.count += 1

    def read(self, number: int) -> bytes | None:
        """Return a row, or None if it has not been written whole, or has been overwritten."""
        return _read(self.words[number % self.rows], number)

    def oldest_after(self, number: int) -> int | None:
        """Return a row to go on with if the one of a number has been overwritten, else None."""
        newest = int(self.words[number % self.rows, 0])  # 0 where nothing was written yet
        if newest <= number:
            return None
        while self.read(newest + 1) is not None:
            newest += 1
        return newest + 1 - self.rows + self.rows // 8  # not the very oldest, which the writer overwrites next

    def release(self) -> None:
        """Let go of the memory, before it is closed."""
        self.words = NO_WORDS


class Slot:
    """The newest record of one writer, in two places in turn: the writer never touches the one that is being read.

    Attributes:
        address: where the version lies, and after it the places, for `holdfast.kernel.follower`.
        words: of each place.

    Args:
        memory: where it lies, from `offset` on.
        size: of a record [bytes], a multiple of 8.
    """

    def __init__(self, memory: Memory, offset: int, size: int) -> None:
        self._version = memoryview(memory.map)[offset : offset + WORD].cast("q")
        self._places = _words(memory, offset + WORD, 2 * (2 + size // WORD)).reshape(2, -1)
        self.address = self._places.ctypes.data - WORD
        self.words = self._places.shape[1]
        self.end = offset + WORD + self._places.nbytes

    @property
    def version(self) -> int:
        """How many records there have been: all that a reader looks at as a rule."""
        return self._version[0]

    def write(self, body: bytes) -> None:
        """Publish a record."""
        version = self._version[0] + 1
        _write(self._places[version % 2], version, body)
        self._version[0] = version

    def read(self) -> tuple[int, bytes] | None:
        """Return the newest whole record with its version, or None if there is none."""
        newest = self._version[0]
        return self._record(newest) or self._record(newest - 1)

    def _record(self, version: int) -> tuple[int, bytes] | None:
        body = _read(self._places[version % 2], version) if version > 0 else None
        return None if body is None else (version, body)

    def release(self) -> None:
        """Let go of the memory, before it is closed."""
        self._version.release()
        self._places = NO_WORDS


def _words(memory: Memory, offset: int, count: int) -> Words:
    return np.frombuffer(memory.map, np.int64, count, offset)


def _write(row: Words, number: int, body: bytes) -> None:
    row[0], row[1:-1] = number, np.frombuffer(body, np.int64)
    row[-1] = find_checksum(row)


def _read(row: Words, number: int) -> bytes | None:
    """Return the body of a row if it is whole and has a number."""
    copied = row.copy()
    is_whole = copied[0] == number and copied[-1] == find_checksum(copied)
    return copied[1:-1].tobytes() if is_whole else None
