"""Where everything lies in the shared memory, equal in both processes."""

from holdfast.realtime.memory import ROW, WORD, WORDS, Memory, Ring, Slot
from holdfast.realtime.records import Records

SAMPLES = 1 << 14  # 41 s at 400 Hz
REQUESTS = 1 << 13  # 8 s of a flood of 1 kHz


class Board:
    """The shared memory of one engine.

    Args:
        records: how long the rows are.
        descriptor: of the file in which it lies; a new one is made without it.
    """

    def __init__(self, records: Records, descriptor: int | None = None) -> None:
        size = 8 * WORDS + SAMPLES * (records.sample_size + ROW) + REQUESTS * (records.request_size + ROW)
        size += 2 * (WORD + 2 * (records.published_size + ROW))
        self.memory = Memory(size, descriptor)
        self.words = self.memory.words
        self.samples = Ring(self.memory, 8 * WORDS, SAMPLES, records.sample_size)
        self.requests = Ring(self.memory, self.samples.end, REQUESTS, records.request_size)
        self.published = Slot(self.memory, self.requests.end, records.published_size)
        self.rescue = Slot(self.memory, self.published.end, records.published_size)  # written by the IMU path
        assert self.rescue.end == size

    def close(self) -> None:
        """Give the memory back."""
        for part in (self.samples, self.requests, self.published, self.rescue):
            part.release()
        self.memory.close()
