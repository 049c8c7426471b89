"""What goes between a lidar odometry and its process: requests, answers, and shared memory for the bytes of scans."""

import mmap
import os
from typing import NamedTuple

import numpy as np

from holdfast.lidar_odometry.inertial_guide import ImuSamples
from holdfast.lidar_odometry.registration import Registered
from holdfast.point_cloud import Bytes, Layout, PointCloud
from holdfast.realtime.memory import nameless_file

PAGE = 1 << 20
READY = -1  # number of the answer that says that the process has come up


class Request(NamedTuple):
    """A scan that waits in a slot, and what the IMU has measured since the one before.

    Attributes:
        slot: in which its bytes lie.
        size: of the bytes.
        times_ns: its stamp and its arrival.
    """

    number: int
    slot: int
    size: int
    times_ns: tuple[int, int]
    frame_id: str
    layout: Layout
    samples: ImuSamples

    def cloud(self, data: Bytes) -> PointCloud:
        """Return the scan, given its bytes."""
        return PointCloud(*self.times_ns, "", self.frame_id, self.layout, data)


class Placement(NamedTuple):
    """Where the process runs: on which cores, None where it may choose, and how nice it is to others."""

    cores: frozenset[int] | None
    nice: int


class Answer(NamedTuple):
    """What became of a scan.

    Attributes:
        number: of the request; READY when the process has come up.
        registered: the pose; None if the scan could not be used.
        refusal: why it could not.
        took_ns: from request to answer in the process.
        cpu_s: that the process has used since its start.
        fault: the error that has ended the process.
    """

    number: int
    registered: Registered | None = None
    refusal: str = ""
    took_ns: int = 0
    cpu_s: float = 0.0
    fault: str = ""


class Slot:
    """Room for the bytes of one scan, in both processes.

    Args:
        descriptor: of the file that the other process has made; None makes one.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        self.descriptor = nameless_file(PAGE) if descriptor is None else descriptor
        self._map: mmap.mmap | None = None

    def write(self, data: Bytes) -> None:
        """Put the bytes of a scan in: the only copy that is made of them."""
        size = max(data.size, 1)
        if os.fstat(self.descriptor).st_size < size:
            os.ftruncate(self.descriptor, -(-size // PAGE) * PAGE)
        self._mapped(size)[: data.size] = data

    def read(self, size: int) -> Bytes:
        """Return the bytes of a scan, which stay valid until the next one is written."""
        return self._mapped(max(size, 1))[:size]

    def _mapped(self, size: int) -> Bytes:
        if self._map is None or len(self._map) < size:
            self._map = mmap.mmap(self.descriptor, os.fstat(self.descriptor).st_size)
        return np.frombuffer(self._map, np.uint8)

    def close(self) -> None:
        """Give the file back; the mapping goes with the last array that uses it."""
        self._map = None
        os.close(self.descriptor)
