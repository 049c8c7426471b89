"""The memory that two processes share: control words, two rings and two slots, in one nameless file.

The file has no name, so that nothing is left behind however the processes end; the other process inherits its
descriptor. Every byte has one writer. What is longer than a word carries a checksum, so that a reader knows a whole
record from one that is just being written, whatever the order in which a processor makes stores visible.
"""

import mmap
import os
from enum import IntEnum
from tempfile import TemporaryFile
from zlib import crc32

WORDS = 8
SEQUENCE = 8  # bytes
CHECK = 4


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
        self.descriptor = _nameless_file(size) if descriptor is None else descriptor
        self.map = mmap.mmap(self.descriptor, size)
        self.words = memoryview(self.map)[: 8 * WORDS].cast("q")

    def close(self) -> None:
        """Give the memory back."""
        self.words.release()
        self.map.close()
        os.close(self.descriptor)


def _nameless_file(size: int) -> int:
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("holdfast")
    else:
        with TemporaryFile() as file:
            descriptor = os.dup(file.fileno())
    os.ftruncate(descriptor, size)
    return descriptor


class Ring:
    """The last rows of one writer; the reader asks for them by number.

    Args:
        memory: where it lies, from `offset` on.
        rows: how many are kept.
        body: length of a row [bytes].
    """

    def __init__(self, memory: Memory, offset: int, rows: int, body: int) -> None:
        self._map = memory.map
        self._offset = offset
        self.rows = rows
        self._length = SEQUENCE + body
        self._stride = self._length + CHECK
        self.end = offset + rows * self._stride
        self.written = 0

    def push(self, body: bytes) -> None:
        """Append a row."""
        row = self.written.to_bytes(SEQUENCE, "little") + body
        at = self._offset + self.written % self.rows * self._stride
        self._map[at : at + self._stride] = row + crc32(row).to_bytes(CHECK, "little")
        self.written += 1

    def read(self, number: int) -> bytes | None:
        """Return a row, or None if it has not been written whole, or has been overwritten."""
        at = self._offset + number % self.rows * self._stride
        row = self._map[at : at + self._length]
        if row[:SEQUENCE] != number.to_bytes(SEQUENCE, "little"):
            return None
        check = self._map[at + self._length : at + self._stride]
        return row[SEQUENCE:] if check == crc32(row).to_bytes(CHECK, "little") else None

    def oldest_after(self, number: int) -> int | None:
        """Return a row to go on with if the one of a number has been overwritten, else None."""
        at = self._offset + number % self.rows * self._stride
        newest = int.from_bytes(self._map[at : at + SEQUENCE], "little")  # 0 where nothing was written yet
        if newest <= number:
            return None
        while self.read(newest + 1) is not None:
            newest += 1
        return newest + 1 - self.rows + self.rows // 8  # not the very oldest, which the writer overwrites next


class Slot:
    """The newest record of one writer, in two places in turn: the writer never touches the one that is being read.

    Args:
        memory: where it lies, from `offset` on.
        size: of a record [bytes].
    """

    def __init__(self, memory: Memory, offset: int, size: int) -> None:
        self._map = memory.map
        self._version = memoryview(memory.map)[offset : offset + 8].cast("q")
        self._places = [offset + 8, offset + 8 + SEQUENCE + size + CHECK]
        self._length = SEQUENCE + size
        self.end = self._places[1] + self._length + CHECK

    @property
    def version(self) -> int:
        """How many records there have been: all that a reader looks at as a rule."""
        return self._version[0]

    def write(self, body: bytes) -> None:
        """Publish a record."""
        version = self._version[0] + 1
        row = version.to_bytes(SEQUENCE, "little") + body
        at = self._places[version % 2]
        self._map[at : at + self._length + CHECK] = row + crc32(row).to_bytes(CHECK, "little")
        self._version[0] = version

    def read(self) -> tuple[int, bytes] | None:
        """Return the newest whole record with its version, or None if there is none."""
        newest = self._version[0]
        return self._record(newest) or self._record(newest - 1)

    def _record(self, version: int) -> tuple[int, bytes] | None:
        at = self._places[version % 2]
        row = self._map[at : at + self._length]
        if version <= 0 or row[:SEQUENCE] != version.to_bytes(SEQUENCE, "little"):
            return None
        check = self._map[at + self._length : at + self._length + CHECK]
        return (version, row[SEQUENCE:]) if check == crc32(row).to_bytes(CHECK, "little") else None

    def release(self) -> None:
        """Let go of the memory, before it is closed."""
        self._version.release()
