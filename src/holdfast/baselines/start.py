"""The first state, from a standstill: what the estimator's initialisation knows, no more and no less.

Roll and pitch from gravity, the gyroscope's bias from its mean, the accelerometer's along gravity, the heading from a
message or two antennas, the position through the lever arm (paper, IV-A.5). None of them can start in motion.
"""

from collections import deque
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.baselines.intake import Intake, PositionFix
from holdfast.config.model import Config
from holdfast.events import Outcome
from holdfast.graph.first_guess import level_attitude
from holdfast.messages import Array, Message
from holdfast.sensors.heading import AxisYaw
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.standstill import ENGINE, fixes_stand, quiet_window, standstill_covariance

KEPT_FIXES = 200
STANDING_S = 3.0  # fixes have to stand for so long
PAIRED_NS = 20_000_000


class Start(NamedTuple):
    """The first state; `covariance` (15, 15) in the order of `holdfast.state`."""

    stamp_ns: int
    nav: gtsam.NavState
    bias: gtsam.imuBias.ConstantBias
    covariance: Array


class StandstillStart:
    """Collects fixes and headings until the machine is seen standing; `reason` says what is missing."""

    def __init__(self, config: Config, intake: Intake, buffer: ImuBuffer) -> None:
        self._config = config
        self._intake = intake
        self._buffer = buffer
        self._fixes: deque[PositionFix] = deque(maxlen=KEPT_FIXES)
        self._heading: AxisYaw | None = None
        self.reason = "no usable position has come"

    def takes_heading(self, message: Message) -> bool:
        """Whether a message is from the heading by which the system may start."""
        return self._intake.heading is not None and message.sensor == self._intake.heading.name

    def add_heading(self, message: Message) -> None:
        """Take in a heading, which only the start uses."""
        heading = self._intake.axis_yaw(message)
        if heading is not None:
            self._intake.counts[message.sensor, Outcome.BEFORE_START] += 1
            self._heading = heading

    def add_fix(self, fix: PositionFix) -> Start | None:
        """Take in a position; return the first state, or None with `reason` set."""
        self._fixes.append(fix)
        now = self._buffer.latest_ns
        start = self._config.initialisation
        if self._buffer.window(now - round(start.standstill_s * 1e9), now) is None:
            self.reason = f"the IMU has not been received without a gap for {start.standstill_s:g} s"
            return None
        quiet = quiet_window(self._config.standstill, self._buffer, now, start.standstill_s, ENGINE)
        if quiet is None or not fixes_stand([one.position for one in self._recent(now, STANDING_S)]):
            self.reason = "the machine has not stood still: the baselines cannot start in motion"
            return None
        force, rate = quiet
        level, g = level_attitude(force), self._intake.gravity
        heading = self._yaw(now, level)
        if heading is None:
            self.reason = "standing still without a heading: give initialisation.heading_deg or a heading topic"
            return None
        self.reason = "standstill"
        up = force / np.linalg.norm(force)
        bias = gtsam.imuBias.ConstantBias((np.linalg.norm(force) - g) * up, rate)
        R_W_I = gtsam.Rot3.Yaw(heading[0]).compose(level)
        fixes = self._recent(now, start.standstill_s)
        mean: Array = np.mean([one.position.p_W_P for one in fixes], axis=0)
        nav = gtsam.NavState(R_W_I, mean - R_W_I.rotate(fixes[-1].p_I_P), np.zeros(3))
        R = R_W_I.matrix()
        in_imu, arm = R.T @ fixes[-1].position.covariance @ R, fixes[-1].p_I_P
        imu = self._config.imu
        covariance = standstill_covariance(imu, start.standstill_s, g, up, heading[1], in_imu, arm)
        return Start(now, nav, bias, covariance)

    def _recent(self, now_ns: int, window_s: float) -> list[PositionFix]:
        """Return the fixes of the first antenna within a window before now, or its newest one."""
        first = next(iter(self._intake.positions))
        of_first = [fix for fix in self._fixes if fix.position.sensor == first]
        recent = [fix for fix in of_first if fix.position.stamp_ns >= now_ns - round(window_s * 1e9)]
        return recent or of_first[-1:]

    def _yaw(self, now_ns: int, level: gtsam.Rot3) -> tuple[float, float] | None:
        """Return the heading of the IMU's x axis and its sigma [rad], from the first source that there is."""
        start, model = self._config.initialisation, self._intake.heading
        if self._heading is not None and model is not None:
            measured = model.of_imu(self._heading, level)
            if measured is not None:
                return measured
        if len(self._intake.positions) >= 2:
            between = self._yaw_of_antennas(now_ns, level)
            if between is not None:
                return between
        if start.heading_deg is not None:
            return float(np.radians(start.heading_deg)), float(np.radians(start.heading_sigma_deg))
        return None

    def _yaw_of_antennas(self, now_ns: int, level: gtsam.Rot3) -> tuple[float, float] | None:
        left, right = list(self._intake.positions)[:2]
        since = now_ns - 1_000_000_000
        recent = [fix.position for fix in self._fixes if fix.position.stamp_ns >= since]
        pairs = [
            (a, b)
            for a in recent
            for b in recent
            if a.sensor == left and b.sensor == right and abs(a.stamp_ns - b.stamp_ns) < PAIRED_NS
        ]
        arm = level.rotate(self._intake.positions[right].p_I_P - self._intake.positions[left].p_I_P)
        length = float(np.hypot(arm[0], arm[1]))
        if not pairs or length < 0.2:
            return None
        between = np.mean([b.p_W_P - a.p_W_P for a, b in pairs], axis=0)
        variance = np.trace(pairs[-1][0].covariance[:2, :2] + pairs[-1][1].covariance[:2, :2]) / 2.0
        yaw = float(np.arctan2(between[1], between[0]) - np.arctan2(arm[1], arm[0]))
        return yaw, max(float(np.sqrt(variance)) / length, 1e-3)
