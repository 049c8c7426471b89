"""A lidar odometry in a process of its own: scans go in through shared memory, poses come back in order."""

import os
import signal
import socket
import subprocess
import sys
from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Self

from holdfast.errors import EstimatorError
from holdfast.lidar_odometry.inertial_guide import ImuSamples
from holdfast.lidar_odometry.scan_odometry import Settings
from holdfast.lidar_odometry.shared_scan import READY, Answer, Placement, Request, Slot
from holdfast.point_cloud import PointCloud

SLOTS = 2  # one scan is registered while the next one is written
PATIENCE_S = 5.0
ANYWHERE = Placement(None, 0)
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class ScanProcess:
    """The odometry of one lidar in its process; a context manager that ends it.

    Args:
        settings: of the odometry.
        placement: where the process runs.
    """

    def __init__(self, settings: Settings, placement: Placement = ANYWHERE) -> None:
        self._method = settings.method
        self._slots = [Slot() for _ in range(SLOTS)]
        self._free = deque(range(SLOTS))
        self._used: deque[int] = deque()
        self._fault = ""
        self._is_ready = self._is_closed = False
        ours, theirs = socket.socketpair()
        descriptors = [theirs.fileno(), *(slot.descriptor for slot in self._slots)]
        environment = os.environ | ONE_THREAD | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "holdfast.lidar_odometry.worker", *map(str, descriptors)],
                stdin=subprocess.DEVNULL,
                stdout=2,  # what a library prints there
                pass_fds=descriptors,
                env=environment,
                process_group=0,  # Ctrl-C is answered by this process
            )
        finally:
            theirs.close()
        self._connection = Connection(ours.detach())
        self._send((settings, placement))

    @property
    def pid(self) -> int:
        """The number of the process."""
        return self._process.pid

    @property
    def in_flight(self) -> int:
        """How many scans wait for their answer."""
        return len(self._used)

    @property
    def has_room(self) -> bool:
        """Whether another scan can be submitted now."""
        return bool(self._free)

    @property
    def is_ready(self) -> bool:
        """Whether the process has come up, as far as `take` has seen."""
        return self._is_ready

    def submit(self, number: int, scan: PointCloud, samples: ImuSamples) -> None:
        """Hand a scan over, for which there must be room; what is wrong with the process, `take` says."""
        slot = self._free.popleft()
        self._slots[slot].write(scan.data)
        self._used.append(slot)
        times_ns = scan.stamp_ns, scan.arrival_ns
        self._send(Request(number, slot, scan.data.size, times_ns, scan.frame_id, scan.layout, samples))

    def take(self, timeout_s: float | None = None) -> Answer | None:
        """Return the answer to the earliest scan that has none yet; None if there is none in time.

        Args:
            timeout_s: None waits for as long as it takes.

        Raises:
            EstimatorError: the process has ended; says how, in one line.
        """
        while self._used or not self._is_ready:
            try:
                if timeout_s is not None and not self._connection.poll(timeout_s):
                    return None
                answer: Answer = self._connection.recv()
            except (EOFError, OSError):
                raise self._ended() from None
            if answer.fault:
                self._fault = answer.fault
                raise self._ended()
            if answer.number == READY:
                self._is_ready = True
                continue
            self._free.append(self._used.popleft())
            return answer
        return None

    def close(self, patience_s: float = 0.0) -> None:
        """End the process, at once or when it is idle within a time. Closing twice does no harm."""
        if self._is_closed:
            return
        self._is_closed = True
        self._connection.close()
        try:
            self._process.wait(patience_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for slot in self._slots:
            slot.close()

    def _send(self, message: object) -> None:
        with suppress(OSError):  # it has ended, which `take` will say
            self._connection.send(message)

    def _ended(self) -> EstimatorError:
        try:
            code = self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with {code}"
        return EstimatorError(f"lidar odometry by {self._method}: {self._fault or 'its process ' + how}")

    def __enter__(self) -> Self:
        """Return the process itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the process."""
        self.close()
