"""What is otherwise than configured, mountings, clocks, the gyroscope, as the graph has found: told once it is sure."""

from collections.abc import Iterable, Iterator, Mapping
from math import degrees, exp, radians
from typing import NamedTuple

import numpy as np

from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.graph.smoother import Smoother
from holdfast.measured_fields import NEVER_NS
from holdfast.messages import Array
from holdfast.sensors.clock import CLOCK, DELAY
from holdfast.sensors.constants import length_and_sigma
from holdfast.sensors.heading import MOUNT
from holdfast.sensors.lever_arm import ARM
from holdfast.sensors.odometry import OdometryModel
from holdfast.sensors.scale import SCALE
from holdfast.sensors.sensor import Parameter, Sensor

REVIEW_NS = 1_000_000_000
SIGMA = 4.0  # it is tested every second
SLACK_S, SLACK_RAD, SLACK_RATIO, SLACK_M = 2e-3, 5e-3, 3e-3, 0.03  # an error that nobody need correct
TOLD_RAD = radians(1.0)  # sigma of a mounting that may be any: before that nothing is told
NEWS = 0.25  # of what was told last


class Finding(NamedTuple):
    """A constant of a sensor that is otherwise than configured.

    Attributes:
        what: which of its constants.
        off: by how much [s, rad, m or 1].
        sigma: of that.
        slack: below it nothing is told.
    """

    what: str
    off: float
    sigma: float
    slack: float

    @property
    def is_sure(self) -> bool:
        """Whether it is so beyond doubt, and matters."""
        return self.off > SIGMA * self.sigma + self.slack


class Calibration:
    """What was told of the constants of all sensors.

    Args:
        sensors: the models, by name.
        imu: name of the primary IMU.
        log: where events go.
    """

    def __init__(self, sensors: Mapping[str, Sensor], imu: str, log: EventLog) -> None:
        self._sensors, self._imu, self._log = sensors, imu, log
        self._told: dict[tuple[str, str], float] = {}
        self._reviewed_ns = NEVER_NS

    def review(self, smoother: Smoother, now_ns: int) -> None:
        """Report what is new, once a second."""
        if now_ns - self._reviewed_ns < REVIEW_NS:
            return
        self._reviewed_ns = now_ns
        for name, sensor in self._sensors.items():
            for prior in sensor.parameters:
                estimate = smoother.parameters.estimate(prior.name(name))
                if estimate is not None:
                    self._tell(name, _findings(sensor, prior, *estimate), now_ns)
        scale = smoother.parameters.estimate(self._imu)
        if scale is not None:
            self._tell(self._imu, _findings_of_gyroscope(*scale), now_ns)

    def _tell(self, name: str, findings: Iterable[tuple[Finding, str]], now_ns: int) -> None:
        for finding, in_words in findings:
            told = self._told.get((name, finding.what))
            if finding.is_sure and (told is None or abs(finding.off - told) > NEWS * told):
                self._told[name, finding.what] = finding.off
                self._log.report(EventKind.CALIBRATION, now_ns, name, in_words)


def _findings(sensor: Sensor, prior: Parameter, value: Array, sigmas: Array) -> Iterator[tuple[Finding, str]]:
    """Yield the constants of a sensor with what is to be told of them."""
    if prior.has_clock:
        off_s, sigma_s = float(value[-1]), float(sigmas[-1])
        early_or_late = "early" if off_s > 0.0 else "late"
        beside, what = (" beside those of positions", DELAY) if prior.part == DELAY else ("", CLOCK)
        text = (
            f"its stamps are {abs(off_s) * 1e3:.1f} ms {early_or_late}{beside}, sigma {sigma_s * 1e3:.1f} ms: "
            f"add {off_s:.4f} to time_offset_s"
        )
        yield Finding(what, abs(off_s), sigma_s, SLACK_S), text
    is_odometry = isinstance(sensor, OdometryModel)
    if prior.part == MOUNT and sigmas[0] < TOLD_RAD:
        off_rad, sigma_rad = float(value[0] - prior.mean[0]), float(sigmas[0])
        way, off_deg = "left" if off_rad > 0.0 else "right", degrees(off_rad)
        text = (
            f"its axis points {abs(off_deg):.1f} deg further to the {way} than configured, "
            f"sigma {degrees(sigma_rad):.1f} deg: add {off_deg:.2f} to mounting_yaw_deg"
        )
        yield Finding("mounting", abs(off_rad), sigma_rad, SLACK_RAD), text
    if prior.part == ARM:
        off_m, sigma_m = length_and_sigma(value - prior.mean, sigmas)
        x, y, z = value - prior.mean
        text = (
            f"{off_m:.2f} m beside where it is configured, sigma {sigma_m:.2f} m: "
            f"moved by {x:.2f}, {y:.2f}, {z:.2f} m along {'its own axes' if is_odometry else 'the axes of the IMU'}"
        )
        yield Finding("lever arm", off_m, sigma_m, SLACK_M), text
    elif prior.part == SCALE:
        off, sigma = float(value[0]), float(sigmas[0])
        short_or_long = "short" if off > 0.0 else "long"
        text = f"its distances are too {short_or_long}: multiply `scale` by {exp(off):.4f}, sigma {100.0 * sigma:.2f} %"
        yield Finding("scale", abs(off), sigma, SLACK_RATIO), text
    elif is_odometry:
        off_rad, sigma_rad = length_and_sigma(value[:3], sigmas[:3])
        x, y, z = np.degrees(value[:3])
        text = (
            f"mounted {degrees(off_rad):.1f} deg otherwise than configured, sigma {degrees(sigma_rad):.1f} deg: "
            f"rotated by {x:.2f}, {y:.2f}, {z:.2f} deg about its own axes"
        )
        yield Finding("mounting", off_rad, sigma_rad, SLACK_RAD), text


def _findings_of_gyroscope(scale: Array, sigmas: Array) -> Iterator[tuple[Finding, str]]:
    """Yield the scale factors of the gyroscope with what is to be told of them."""
    for axis, off, sigma in zip("xyz", scale.tolist(), sigmas.tolist(), strict=True):
        more_or_less = "more" if off > 0.0 else "less"
        text = (
            f"its gyroscope shows {100.0 * abs(off):.2f} % {more_or_less} about {axis} than it turns, "
            f"sigma {100.0 * sigma:.2f} %"
        )
        yield Finding(f"scale {axis}", abs(off), sigma, SLACK_RATIO), text
