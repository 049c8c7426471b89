"""A lidar odometry beside a recording that is read: every pose comes when it is due, however busy the machine is.

A pose is due a fixed latency after its scan. Whoever reads the recording waits for it then, and no earlier, so that the
odometry works while the recording is read on, and the same recording gives the same messages in the same order.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from holdfast.errors import EstimatorError
from holdfast.lidar_odometry.inertial_guide import MEMORY_NS, NO_SAMPLES, ImuSamples
from holdfast.lidar_odometry.process import ScanProcess
from holdfast.lidar_odometry.registration import Registered
from holdfast.lidar_odometry.scan_odometry import Settings
from holdfast.lidar_odometry.shared_scan import Answer
from holdfast.messages import ImuSample
from holdfast.point_cloud import PointCloud

MAX_RESTARTS = 3  # in a row without a pose between them

Make = Callable[[Settings], ScanProcess]


class Due(NamedTuple):
    """A pose, the time at which it arrives, and the frame of its lidar."""

    registered: Registered
    arrival_ns: int
    frame_id: str


@dataclass(slots=True)
class Account:
    """What became of the scans of one lidar.

    Attributes:
        refused: scans that could not be used; `refusal` is why, of the last one.
        lost: scans whose process has ended over them; `fault` is how, of the last time.
        new_maps: poses that could not be joined to those before.
        unguided: poses of scans that the IMU did not measure whole.
        took_ms: time from scan to pose in the process.
    """

    scans: int = 0
    poses: int = 0
    refused: int = 0
    refusal: str = ""
    lost: int = 0
    fault: str = ""
    new_maps: int = 0
    unguided: int = 0
    took_ms: list[float] = field(default_factory=list)


class _Pending(NamedTuple):
    number: int
    due_ns: int
    frame_id: str


class InStep:
    """One lidar odometry in its process, which is started with the first scan; whoever made it closes it.

    Args:
        settings: of the odometry.
        latency_s: a pose arrives so long after its scan.
        restarts: whether a process that ends is replaced, and its scans are counted as lost.
        make: starts the process.
        on_refusal: takes the arrival [ns] of a scan that could not be used, and why.
    """

    def __init__(
        self,
        settings: Settings,
        latency_s: float,
        *,
        restarts: bool = True,
        make: Make = ScanProcess,
        on_refusal: Callable[[int, str], None] = lambda _arrival_ns, _reason: None,
    ) -> None:
        self._on_refusal = on_refusal
        self.account = Account()
        self._settings, self._make, self._restarts = settings, make, restarts
        self._latency_ns = round(latency_s * 1e9)
        self._process: ScanProcess | None = None
        self._pending: deque[_Pending] = deque()
        self._answers: deque[Answer] = deque()
        self._fresh: deque[ImuSample] = deque()
        self._recent, self._is_new = NO_SAMPLES, True
        self._newest: Registered | None = None
        self._failures = 0

    def add_sample(self, sample: ImuSample) -> None:
        """Take in a sample of the IMU that guides the odometry."""
        if self._settings.imu is None:
            return
        self._fresh.append(sample)
        while self._fresh[0].stamp_ns < sample.stamp_ns - MEMORY_NS:
            self._fresh.popleft()

    def add_scan(self, scan: PointCloud) -> None:
        """Hand over a scan; waits while too many are on their way.

        Raises:
            EstimatorError: the process has ended, and is not replaced or ends again and again.
        """
        if self._process is None:
            self._process = self._make(self._settings)
        while not self._process.has_room:
            self._receive(self._process)
        samples = self._samples()
        self._pending.append(_Pending(self.account.scans, scan.arrival_ns + self._latency_ns, scan.frame_id))
        self._process.submit(self.account.scans, scan, samples)
        self.account.scans += 1

    def due(self, until_ns: int | None = None) -> Iterator[Due]:
        """Yield the poses that arrive up to a time, or all there are to come; waits for them. Errors as `add_scan`."""
        while self._pending and (until_ns is None or self._pending[0].due_ns <= until_ns):
            while not self._answers:
                assert self._process is not None
                self._receive(self._process)
            pending, answer = self._pending.popleft(), self._answers.popleft()
            registered = answer.registered
            if registered is None:
                if answer.refusal:
                    self._on_refusal(pending.due_ns - self._latency_ns, answer.refusal)
                continue
            self.account.poses += 1
            self.account.new_maps += registered.restarted
            self.account.unguided += not registered.is_guided
            yield Due(registered, pending.due_ns, pending.frame_id)

    @property
    def is_guided(self) -> bool:
        """Whether an IMU is to guide it."""
        return self._settings.imu is not None

    @property
    def pid(self) -> int | None:
        """The number of its process; None before the first scan."""
        return None if self._process is None else self._process.pid

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close()

    def _samples(self) -> ImuSamples:
        """Return the samples that have come since the last call, and keep those that a successor would need."""
        samples = ImuSamples.of(self._fresh)
        self._fresh.clear()
        self._recent = self._recent.joined(samples).of_late()
        is_new, self._is_new = self._is_new, False
        return self._recent if is_new else samples

    def _receive(self, process: ScanProcess) -> None:
        try:
            answer = process.take()
        except EstimatorError as error:
            self._replace(process, error)
            return
        assert answer is not None
        self._answers.append(answer)
        self.account.took_ms.append(answer.took_ns * 1e-6)
        if answer.registered is not None:
            self._newest, self._failures = answer.registered, 0
        else:
            self.account.refused += 1
            self.account.refusal = answer.refusal

    def _replace(self, process: ScanProcess, error: EstimatorError) -> None:
        """Count what was on its way as lost, and start a successor that goes on where the last pose was."""
        lost = process.in_flight
        self.account.lost += lost
        self.account.fault = str(error)
        self._failures += 1
        process.close()
        if not self._restarts or self._failures > MAX_RESTARTS:
            raise error
        answered = len(self._pending) - lost
        self._answers += [Answer(pending.number) for pending in [*self._pending][answered:]]
        settings = self._settings
        if self._newest is not None:
            settings = replace(settings, T_L0_L=self._newest.T_L0_L)
        self._process = self._make(settings)
        self._is_new = True
