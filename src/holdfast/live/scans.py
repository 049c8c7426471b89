"""The odometry of one lidar while the machine works: a process of its own, in which at most one scan waits.

Nothing here waits for the process: scans that it has no time for are dropped whole, oldest first, and counted. If it
dies or hangs, the estimator goes on without it until a successor is up.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import monotonic

import numpy as np

from holdfast.config.model import Config
from holdfast.errors import EstimatorError
from holdfast.lidar_odometry.in_step import Due
from holdfast.lidar_odometry.inertial_guide import MEMORY_NS, ImuSamples
from holdfast.lidar_odometry.process import ScanProcess
from holdfast.lidar_odometry.registration import Registered
from holdfast.lidar_odometry.replayed import pose_message
from holdfast.lidar_odometry.scan_odometry import Settings, settings_of
from holdfast.lidar_odometry.shared_scan import Answer, Placement
from holdfast.messages import ImuSample, SensorPose
from holdfast.point_cloud import PointCloud
from holdfast.ros.messages import OK, WARN, Status

NICE = 10
"""The IMU path and the optimiser come first."""
HANG_S = 5.0
START_S = 60.0
STEADY_S = 10.0  # a process that lived for so long has not died of its start
MAX_PAUSE_S = 30.0
KEPT_TIMES = 300

Make = Callable[[Settings, Placement], ScanProcess]


@dataclass(slots=True)
class Counts:
    """What became of the scans: `poses` came of them; the others were dropped unseen, refused, or lost with a process.

    Attributes:
        restarts: processes that have ended and were replaced.
        cpu_s: processor time of the process that runs now.
    """

    received: int = 0
    poses: int = 0
    dropped: int = 0
    refused: int = 0
    lost: int = 0
    restarts: int = 0
    unguided: int = 0
    cpu_s: float = 0.0


class LiveScans:
    """Makes an odometry of the scans of one sensor.

    Args:
        config: names the sensor.
        name: of the sensor.
        cores: on which the process may run; its starter may be tied to one.
        make: starts the process.
        clock_s: a clock that is never set [s].
    """

    def __init__(
        self,
        config: Config,
        name: str,
        cores: frozenset[int] | None,
        make: Make = ScanProcess,
        clock_s: Callable[[], float] = monotonic,
    ) -> None:
        self.name, self.counts = name, Counts()
        self._settings, self._placement = settings_of(config, name), Placement(cores, NICE)
        self._make, self._clock_s = make, clock_s
        self._samples: deque[ImuSample] = deque()
        self._unsent = 0  # of the samples, at their end
        self._waiting: PointCloud | None = None
        self._on_its_way: PointCloud | None = None
        self._newest: Registered | None = None
        self._took_ms: deque[float] = deque(maxlen=KEPT_TIMES)
        self._cpu_ms: deque[float] = deque(maxlen=KEPT_TIMES)
        self._latency_ms: deque[float] = deque(maxlen=KEPT_TIMES)
        self._refusal = self._fault = ""
        self._pause_s = 0.0
        self._process: ScanProcess | None = None
        self._began_s = self._asked_s = self._clock_s()
        self._start()

    def add_sample(self, sample: ImuSample) -> None:
        """Take in a sample of the IMU that guides the odometry."""
        if self._settings.imu is None:
            return
        self._samples.append(sample)
        self._unsent += 1
        while self._samples[0].stamp_ns < sample.stamp_ns - MEMORY_NS:
            self._samples.popleft()

    def offer(self, scan: PointCloud) -> None:
        """Take in a scan; the one that still waits is dropped for it."""
        self.counts.received += 1
        if self._waiting is not None:
            self.counts.dropped += 1
        self._waiting = scan
        self._submit()

    def poses(self, now_ns: int) -> list[SensorPose]:
        """Return the poses that have come since the last call, and see that the process lives; never waits."""
        found = []
        try:
            if self._process is not None:
                while (answer := self._process.take(0.0)) is not None:
                    found += self._received(answer, now_ns)
                self._check_time()
        except EstimatorError as error:
            self._end(str(error))
        if self._process is None and self._clock_s() >= self._began_s + self._pause_s:
            self._start()
        self._submit()
        return found

    def fault(self) -> str | None:
        """Return why a process has ended since the last call, or None."""
        fault, self._fault = self._fault, ""
        return fault or None

    def status(self) -> Status:
        """Return counts and times for the diagnostics: percentiles of the last scans [ms]."""
        counts, text = self.counts, "ok"
        if self._process is None or not self._process.is_ready:
            text = "its process is being started"
        elif self._refusal:
            text = f"the last scan could not be used: {self._refusal}"
        numbers = [(name, getattr(counts, name)) for name in Counts.__slots__ if name != "cpu_s"]
        values = [(name, str(number)) for name, number in numbers]
        values += [("cpu_s", f"{counts.cpu_s:.2f}"), *_percentiles("registration_ms", self._took_ms)]
        values += _percentiles("cpu_ms", self._cpu_ms)
        values += _percentiles("scan_to_pose_ms", self._latency_ms)
        return Status(OK if text == "ok" else WARN, f"holdfast: odometry of {self.name}", text, values)

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close()
            self._process = None

    def _received(self, answer: Answer, now_ns: int) -> list[SensorPose]:
        scan, self._on_its_way = self._on_its_way, None
        if self.counts.cpu_s > 0.0:  # the first scan's is that of the start as well
            self._cpu_ms.append((answer.cpu_s - self.counts.cpu_s) * 1e3)
        self.counts.cpu_s, self._refusal = answer.cpu_s, answer.refusal
        self._took_ms.append(answer.took_ns * 1e-6)
        registered = answer.registered
        if registered is None or scan is None:
            self.counts.refused += 1
            return []
        self._newest = registered
        self._latency_ms.append((now_ns - scan.arrival_ns) * 1e-6)
        self.counts.poses += 1
        self.counts.unguided += not registered.is_guided
        return [pose_message(self.name, Due(registered, now_ns, scan.frame_id))]

    def _submit(self) -> None:
        process, scan = self._process, self._waiting
        if process is None or scan is None or not process.is_ready or process.in_flight:
            return
        self._waiting, self._on_its_way = None, scan
        unsent = min(self._unsent, len(self._samples))
        samples = [self._samples[k] for k in range(len(self._samples) - unsent, len(self._samples))]
        self._unsent, self._asked_s = 0, self._clock_s()
        process.submit(self.counts.received, scan, ImuSamples.of(samples))

    def _check_time(self) -> None:
        """End a process that does not come up, or does not answer."""
        assert self._process is not None
        now_s = self._clock_s()
        if not self._process.is_ready:
            if now_s > self._began_s + START_S:
                self._end(f"its process did not come up within {START_S:g} s")
        elif self._process.in_flight and now_s > self._asked_s + HANG_S:
            self._end(f"its process hung for {HANG_S:g} s")

    def _start(self) -> None:
        """Start a process that goes on where the last pose was."""
        settings = self._settings
        if self._newest is not None:
            settings = replace(settings, T_L0_L=self._newest.T_L0_L)
        self._began_s, self._unsent = self._clock_s(), len(self._samples)
        self._process = self._make(settings, self._placement)

    def _end(self, why: str) -> None:
        assert self._process is not None
        self.counts.lost += self._process.in_flight
        self.counts.restarts += 1
        self.counts.cpu_s = 0.0
        self._process.close()
        self._process, self._on_its_way, self._fault = None, None, why
        now_s = self._clock_s()
        is_steady = now_s - self._began_s > STEADY_S
        self._pause_s = 0.0 if is_steady else min(max(2.0 * self._pause_s, 1.0), MAX_PAUSE_S)
        self._began_s = now_s


def _percentiles(name: str, times: deque[float]) -> list[tuple[str, str]]:
    if not times:
        return []
    return [
        (f"{name}_{q}", f"{value:.1f}") for q, value in zip(("50", "99"), np.percentile(times, (50, 99)), strict=True)
    ]
