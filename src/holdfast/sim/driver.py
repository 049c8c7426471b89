"""What the driver does with the machine: activities become speed, yaw rate, slewing and arm work over time."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import atan2, cos, hypot, pi, radians, remainder, sin, sqrt

import numpy as np
from scipy.ndimage import gaussian_filter1d

from holdfast.messages import Array
from holdfast.sim.scenario import Activity, Dig, Drive, Point, Start

GRID_S = 0.02
MARGIN_S = 2.0  # the machine exists a little before and after the recording
SMOOTHING_S = 0.2  # hydraulics: commands reach the machine so slowly
ARRIVAL_M = 0.3
IDLE, DRIVING, SWINGING, DUMPING, DIGGING = 0.0, 0.5, 0.4, 0.6, 1.0
BRAKING_RATIO = 0.7  # of the acceleration that the driver uses to stop


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """The machine's generalised coordinates on a regular grid, before the ground lifts and tilts it.

    Attributes:
        times_s: (N,) since the start of the scenario, with a margin on both sides.
        x_m, y_m: (N,) chassis in W.
        yaw_rad: (N,) of the chassis, unwrapped.
        joint_rad: (N,) angle of the turn joint, unwrapped.
        work: (N,) how hard arm and engine work, 0 to 1.
    """

    times_s: Array
    x_m: Array
    y_m: Array
    yaw_rad: Array
    joint_rad: Array
    work: Array


def drive(activities: tuple[Activity, ...], start: Start, limits: Drive, duration_s: float) -> Plan:
    """Return the plan of a driver who does one activity after the other and then stands."""
    steps = np.arange(-round(MARGIN_S / GRID_S), round((duration_s + MARGIN_S) / GRID_S) + 1)
    times_s = np.asarray(steps * GRID_S, dtype=np.float64)
    driver = _Driver(start, limits)
    before = [driver.command()] * round(MARGIN_S / GRID_S)
    rows = [*before]
    for row in driver.rows(activities):
        rows.append(row)
        if len(rows) >= len(times_s):
            break
    while len(rows) < len(times_s):
        rows.append(driver.standing())
    commands = gaussian_filter1d(np.array(rows), SMOOTHING_S / GRID_S, axis=0, mode="nearest")
    speed, yaw_rate, joint, work = commands.T
    zero = len(before)
    yaw = _integral(yaw_rate, zero, radians(start.heading_deg))
    x = _integral(speed * np.cos(yaw), zero, start.position_m[0])
    y = _integral(speed * np.sin(yaw), zero, start.position_m[1])
    return Plan(times_s, x, y, yaw, joint, work)


def _integral(rate: Array, zero: int, at_zero: float) -> Array:
    total = np.concatenate([[0.0], np.cumsum(0.5 * GRID_S * (rate[1:] + rate[:-1]))])
    return np.asarray(total - total[zero] + at_zero)


class _Driver:
    """Where the machine is while its driver thinks, step by step of the grid."""

    def __init__(self, start: Start, limits: Drive) -> None:
        self._limits = limits
        self._x, self._y = start.position_m
        self._yaw = radians(start.heading_deg)
        self._speed, self._yaw_rate = start.speed_m_s, 0.0
        self._joint = radians(start.cabin_deg)

    def command(self, work: float = IDLE) -> tuple[float, float, float, float]:
        """Return speed [m/s], yaw rate [rad/s], joint angle [rad] and work of this step."""
        return self._speed, self._yaw_rate, self._joint, work

    def standing(self) -> tuple[float, float, float, float]:
        """Brake, if there is speed left, and return the command."""
        self._steer(0.0, 0.0)
        return self.command()

    def rows(self, activities: tuple[Activity, ...]) -> Iterator[tuple[float, float, float, float]]:
        """Yield one command per step of the grid."""
        for activity in activities:
            if activity.stand_s is not None:
                yield from (self.standing() for _ in range(round(activity.stand_s / GRID_S)))
            elif activity.drive_to_m is not None:
                yield from self._drive_to(activity.drive_to_m, activity.speed_m_s or self._limits.speed_m_s)
            elif activity.slew_to_deg is not None:
                yield from self._slew(radians(activity.slew_to_deg))
            elif activity.dig is not None:
                yield from self._dig(activity.dig)
            for _ in range(activity.repeat or 0):
                yield from self.rows(activity.of)

    def _dig(self, dig: Dig) -> Iterator[tuple[float, float, float, float]]:
        trench = self._joint
        for _ in range(dig.cycles):
            yield from (self.command(DIGGING) for _ in range(round(dig.dig_s / GRID_S)))
            yield from self._slew(trench + radians(dig.swing_deg))
            yield from (self.command(DUMPING) for _ in range(round(dig.dump_s / GRID_S)))
            yield from self._slew(trench)

    def _slew(self, target_rad: float) -> Iterator[tuple[float, float, float, float]]:
        """Ramp the rate up and down as a raised cosine: its steepest slope is pi rate / (2 ramp)."""
        origin, angle = self._joint, target_rad - self._joint
        acceleration = self._limits.slew_acceleration_rad_s2
        rate = min(self._limits.slew_rate_rad_s, sqrt(2.0 * acceleration * abs(angle) / pi))
        if rate == 0.0:
            return
        ramp_s = pi * rate / (2.0 * acceleration)
        cruise_s = abs(angle) / rate - ramp_s
        for step in range(1, round((2.0 * ramp_s + cruise_s) / GRID_S) + 1):
            done = _ramped(step * GRID_S, rate, ramp_s, cruise_s)
            self._joint = origin + np.copysign(min(done, abs(angle)), angle)
            yield self.command(SWINGING)
        self._joint = target_rad

    def _drive_to(self, waypoints: tuple[Point, ...], speed_m_s: float) -> Iterator[tuple[float, float, float, float]]:
        """Steer towards one waypoint after the other; slow down in curves, and stop at the last."""
        for index, (x, y) in enumerate(waypoints):
            rest_m = sum(hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(waypoints[index:]))
            last = index == len(waypoints) - 1
            while (distance := hypot(x - self._x, y - self._y)) > (ARRIVAL_M if last else ARRIVAL_M + self._speed):
                error = remainder(atan2(y - self._y, x - self._x) - self._yaw, 2.0 * pi)
                if last and abs(error) > pi / 2 and distance < 2.0:
                    break  # driven past it
                to_stop = sqrt(
                    2.0 * BRAKING_RATIO * self._limits.acceleration_m_s2 * max(distance + rest_m - ARRIVAL_M, 0.0)
                )
                self._steer(min(speed_m_s, to_stop + 0.05) * max(cos(error), 0.0) ** 2, 1.2 * error)
                yield self.command(DRIVING)
        while self._speed > 0.0 or self._yaw_rate != 0.0:
            self._steer(0.0, 0.0)
            yield self.command(DRIVING)

    def _steer(self, speed: float, yaw_rate: float) -> None:
        """Approach the wanted speed and yaw rate within the limits, and move on by one step."""
        limits = self._limits
        most, most_yaw = limits.acceleration_m_s2 * GRID_S, limits.yaw_acceleration_rad_s2 * GRID_S
        self._speed += min(max(speed - self._speed, -most), most)
        wanted = min(max(yaw_rate, -limits.yaw_rate_rad_s), limits.yaw_rate_rad_s)
        self._yaw_rate += min(max(wanted - self._yaw_rate, -most_yaw), most_yaw)
        self._x += self._speed * GRID_S * cos(self._yaw)
        self._y += self._speed * GRID_S * sin(self._yaw)
        self._yaw += self._yaw_rate * GRID_S


def _ramped(t_s: float, rate: float, ramp_s: float, cruise_s: float) -> float:
    """Return the angle after `t_s` of a move whose rate rises as a raised cosine, stays and falls likewise."""
    if t_s < ramp_s:
        return rate * (t_s - ramp_s / pi * sin(pi * t_s / ramp_s)) / 2.0
    if t_s < ramp_s + cruise_s:
        return rate * (ramp_s / 2.0 + t_s - ramp_s)
    return rate * (ramp_s + cruise_s) - _ramped(max(2.0 * ramp_s + cruise_s - t_s, 0.0), rate, ramp_s, cruise_s)
