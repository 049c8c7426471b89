"""The heading before there is a state: from the first source that knows it, with its sigma."""

from collections.abc import Mapping, Sequence
from math import atan2, degrees, hypot, radians, remainder, sqrt, tau
from typing import Any, NamedTuple

import gtsam
import numpy as np

from holdfast.config.model import InitialisationConfig
from holdfast.estimator.collected import Collected
from holdfast.integrity.lever_arms import SAME_M
from holdfast.sensors.heading import MOUNT, yaw_of
from holdfast.sensors.sensor import Position, PositionSensor, part_of

MIN_BASELINE_M = 0.2  # horizontal; a shorter one tells no heading
PAIRED_NS = 20_000_000  # fixes of a machine that stands
MIN_SIGMA_RAD = 1e-3
ALIKE_RAD, ALIKE_SIGMA = radians(10.0), 5.0  # a compass beside iron is off by as much
MOUNT_RAD = radians(10.0)  # so far a mounting is doubted that is estimated: the graph shall learn it from motion
PAIRS_S, OLDEST_S = 1.0, 2.0  # of fixes of two antennas that are averaged, and the oldest: the next may be on its way
Antennas = tuple[PositionSensor, PositionSensor]


class Told(NamedTuple):
    """A heading of the IMU's x axis, its sigma, and how far the mounting of what tells it is doubted [rad]."""

    yaw_rad: float
    sigma_rad: float
    doubt_rad: float = 0.0

    @property
    def doubted(self) -> tuple[float, float]:
        """The heading, and its sigma in doubt."""
        return self.yaw_rad, hypot(self.sigma_rad, self.doubt_rad)


class FirstHeading:
    """Looks for the heading of a machine that stands: a heading message, two antennas, an absolute pose, the file.

    Args:
        config: of the start.
        collected: what was measured of late.
        antennas: two whose lever arms are not in doubt, if there are.
        headings: models of sensors of heading, by name.
        poses: models of sensors of absolute poses, by name.
    """

    def __init__(
        self,
        config: InitialisationConfig,
        collected: Collected,
        antennas: Antennas | None,
        headings: Mapping[str, Any],
        poses: Mapping[str, Any],
    ) -> None:
        self._config, self._collected = config, collected
        self._antennas, self._headings, self._poses = antennas, headings, poses

    def at_standstill(self, now_ns: int, level: gtsam.Rot3) -> tuple[float, float] | str | None:
        """Return the heading of the IMU's x axis and its sigma [rad], or why there is none if there should be.

        Args:
            now_ns: when.
            level: the IMU's attitude with zero heading.
        """
        told: dict[str, Told] = {}
        for heading in self._collected.newest_of(self._headings):
            model = self._headings[heading.sensor]
            if (of_imu := model.of_imu(heading, level)) is not None:
                mount = part_of(model.parameters, MOUNT)
                doubt_rad = 0.0 if mount is None else min(MOUNT_RAD, float(mount.sigmas[0]))
                told[heading.sensor] = Told(of_imu[0], of_imu[1], doubt_rad)
        baseline = None
        if self._antennas is not None:
            since_ns = now_ns - round(max(OLDEST_S, self._config.standstill_s) * 1e9)
            baseline = baseline_heading(self._antennas, self._collected.positions, since_ns, level)
            if isinstance(baseline, tuple):
                told[" to ".join(one.name for one in self._antennas)] = Told(*baseline)
        for pose in self._collected.newest_of(self._poses):
            sigma_rad = float(np.sqrt(pose.covariance[:3, :3].max()))
            if (of_pose := pose_heading(pose.T_F_I.rotation(), level, sigma_rad)) is not None:
                told[pose.sensor] = Told(*of_pose)
        if told:
            return believed(told)
        if self._config.heading_deg is not None:
            return radians(self._config.heading_deg), radians(self._config.heading_sigma_deg)
        return baseline


def believed(told: Mapping[str, Told]) -> tuple[float, float] | str:
    """Return the surest heading with its sigma [rad] of those that most agree with, by who tells it.

    One against one the motion has to tell, and this says so: a device may be mounted the other way round.
    """
    alike = [[other for other in told if _are_alike(told[name], told[other])] for name in told]
    most = max(alike, key=len)
    if len(most) > 1 or len(told) == 1:
        return min((told[name].doubted for name in most), key=lambda one: one[1])
    one, other, *_ = told
    apart_deg = abs(degrees(remainder(told[other].yaw_rad - told[one].yaw_rad, tau)))
    return f"the headings of {one} and of {other} are {apart_deg:.0f} deg apart: which is right, motion tells"


def _are_alike(one: Told, other: Told) -> bool:
    apart_rad = abs(remainder(one.yaw_rad - other.yaw_rad, tau))
    return apart_rad <= ALIKE_RAD + ALIKE_SIGMA * hypot(one.sigma_rad, other.sigma_rad)


def baseline_heading(
    antennas: Antennas, positions: Sequence[Position], since_ns: int, level: gtsam.Rot3
) -> tuple[float, float] | str | None:
    """Return the heading of the IMU's x axis and its sigma [rad] from the vector between two antennas at standstill.

    Args:
        antennas: from the first to the second.
        positions: of both.
        since_ns: older ones are left out.
        level: the IMU's attitude with zero heading.

    Returns:
        Why the vector cannot be right, in words; None where there is none.
    """
    first, second = antennas
    arm = level.rotate(second.p_I_P - first.p_I_P)
    length = hypot(arm[0], arm[1])
    pairs = [
        (a, b)
        for a in positions
        for b in positions
        if a.sensor == first.name and b.sensor == second.name and a.stamp_ns >= since_ns
        if abs(a.stamp_ns - b.stamp_ns) < PAIRED_NS
    ]
    if length < MIN_BASELINE_M or not pairs:
        return None
    newest_ns = max(a.stamp_ns for a, _ in pairs)
    pairs = [(a, b) for a, b in pairs if a.stamp_ns >= newest_ns - round(PAIRS_S * 1e9)]
    baseline = np.mean([b.p_W_P - a.p_W_P for a, b in pairs], axis=0)
    a, b = pairs[-1]
    sigma = sqrt(float(np.trace(a.covariance[:2, :2] + b.covariance[:2, :2])) / 2) / length
    if float(np.linalg.norm(baseline)) < SAME_M:
        return f"both receivers report the same position: do {first.name} and {second.name} come from one antenna?"
    measured, expected = float(np.linalg.norm(baseline)), float(np.linalg.norm(arm))
    if abs(measured - expected) > 5.0 * sigma * length + 0.02 * expected:
        return f"the antennas are {measured:.2f} m apart, the extrinsics say {expected:.2f} m"
    return atan2(baseline[1], baseline[0]) - atan2(arm[1], arm[0]), max(sigma, MIN_SIGMA_RAD)


def pose_heading(R_W_I: gtsam.Rot3, level: gtsam.Rot3, sigma_rad: float) -> tuple[float, float] | None:
    """Return the heading of the IMU's x axis and its sigma [rad] from an absolute attitude, roll and pitch left out."""
    turned = R_W_I.compose(level.inverse())
    yaw_rad = yaw_of(turned.rotate(np.array([1.0, 0.0, 0.0])))
    return None if yaw_rad is None else (yaw_rad, sigma_rad)
