"""The zero of the turn joint's encoder: what is believed of it at first, and what is told of what was learnt."""

from collections.abc import Iterator
from math import degrees, hypot, radians, sqrt
from typing import Any, NamedTuple

import numpy as np

from holdfast.chassis.base_gyro import BaseGyro
from holdfast.chassis.encoder import JointModel
from holdfast.config.sensors import InertialConfig
from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.kernel import layout
from holdfast.messages import Array
from holdfast.sensors.constants import LearntConstant
from holdfast.sensors.learnt_joint import LearntJoint
from holdfast.sensors.sensor import CHANGE_RAD

REVIEW_NS = 1_000_000_000
SIGMA = 4.0  # it is tested every second
SLACK_RAD, TILT_SLACK_RAD = 1e-3, 5e-3  # errors that nobody need correct
NEWS, FINER = 0.25, 0.3  # of what was told last, and of its sigma
FITTING_SIGMA = 3.0  # within which a tilt is that of before

GAIN_SIGMA = 3.0  # nothing is known of the angle before
TILT_SIGMA_RAD = 0.05  # of either inertial measurement unit
CLOCK_SIGMA_S = 0.01  # of one against the other
GAIN_WALK, TILT_WALK, CLOCK_WALK = 1e-5, 1e-5, 1e-5  # per square root of a second: half an hour is forgotten
FIRST_NOISE = 10.0  # over that of the datasheet, as variance, until it is known
LEAST_NOISE = 0.01  # the same, whatever residuals show


def fill_zero(zero: Any, encoder: JointModel, gyro: BaseGyro | None, imu: InertialConfig) -> None:
    """Write into a `ZERO` what is known at first.

    Args:
        zero: the record, all zero.
        encoder: model of the encoder.
        gyro: of the base IMU; without one the zero stays as it is configured.
        imu: that of the cabin.
    """
    zero["since_ns"] = zero["base_ns"] = layout.NEVER
    zero["correction_variance"] = zero["zero_variance"] = encoder.zero_variance
    if gyro is None:
        return
    base = gyro.config
    zero["R_J_S"], zero["p_J_S"] = gyro.T_J_S[:3, :3], gyro.T_J_S[:3, 3]
    zero["mounting_variance"] = radians(base.mounting_sigma_deg) ** 2
    for k, sensor in enumerate(("gyroscope", "accelerometer")):
        bias, walk, noise = (
            float(np.linalg.norm([getattr(one, f"{sensor}_{name}") for one in (imu, base)]))
            for name in ("bias_sigma", "random_walk", "noise_density")
        )
        sigmas = [GAIN_SIGMA, bias, TILT_SIGMA_RAD, TILT_SIGMA_RAD, CLOCK_SIGMA_S]
        walks = [GAIN_WALK, walk, TILT_WALK, TILT_WALK, CLOCK_WALK]
        zero["P"][k] = np.diag(np.square(np.repeat(sigmas, [2, 2, 2, 2, 1])))
        zero["walk"][k] = np.square(np.repeat(walks, [2, 2, 2, 2, 1]))
        zero["floor"][k], zero["variance"][k] = LEAST_NOISE * noise**2, FIRST_NOISE * noise**2


def tilts(zero: Any, before: LearntJoint) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return the tilts (2,) of cabin's and chassis' unit about x and y [rad], each with its variances (2,) [rad^2].

    Args:
        zero: a `ZERO`.
        before: what was learnt before, which counts where it fits.
    """
    x, variances = zero["x"][0], zero["P"][0].diagonal()
    # a rotation phi of the unit lets a rate about the vertical appear along (-phi_y, phi_x) of it: (58)
    cabin = _with_before(np.array([-x[5], x[4]]), variances[5:3:-1], before.cabin_tilt)
    return cabin, _with_before(np.array([x[7], -x[6]]), variances[7:5:-1], before.base_tilt)


def _with_before(tilt: Array, variances: Array, before: LearntConstant | None) -> tuple[Array, Array]:
    if before is None:
        return tilt, variances
    kept, of_kept = np.array(before.mean), np.square(before.sigmas) + CHANGE_RAD**2
    if (np.abs(tilt - kept) > FITTING_SIGMA * np.sqrt(variances + of_kept)).any():
        return tilt, variances
    share = of_kept / (of_kept + variances)
    return kept + share * (tilt - kept), share * variances


class _Finding(NamedTuple):
    """An angle that is otherwise than configured, of a sensor: off and its sigma [rad], and what to tell."""

    sensor: str
    off_rad: float
    sigma_rad: float
    slack_rad: float
    text: str


class ZeroReport:
    """Tells where the zero is and how the two inertial measurement units are tilted, once it is sure that it matters.

    Args:
        zero: the `ZERO` of which it is told.
        names: of the encoder, the base IMU and the cabin's IMU.
        ratio: error of the gyroscopes in proportion to the rotation, which looks like a tilt.
        log: where events go.
    """

    def __init__(self, zero: Any, names: tuple[str, str, str], ratio: float, log: EventLog) -> None:
        self._zero, self._names, self._ratio, self._log = zero, names, ratio, log
        self._reviewed_ns = layout.NEVER
        self._told: dict[str, tuple[float, float]] = {}  # by sensor, with sigma [rad]
        self._was_contradictory = False

    def review(self, stamp_ns: int, before: LearntJoint) -> None:
        """Report what is new, once a second, with what was learnt before."""
        if stamp_ns - self._reviewed_ns < REVIEW_NS:
            return
        self._reviewed_ns = stamp_ns
        for one in self._findings(before):
            told, of_told = self._told.get(one.sensor, (0.0, np.inf))
            is_sure = abs(one.off_rad) > SIGMA * one.sigma_rad + one.slack_rad
            if is_sure and (abs(one.off_rad - told) > NEWS * abs(told) or one.sigma_rad < FINER * of_told):
                self._told[one.sensor] = one.off_rad, one.sigma_rad
                self._log.report(EventKind.CALIBRATION, stamp_ns, one.sensor, one.text)
        is_contradictory = bool(self._zero["is_contradictory"])
        if is_contradictory and not self._was_contradictory:
            reason = "gyroscopes and accelerometers of cabin and chassis disagree about its zero, which is not learnt"
            self._log.report(
                EventKind.CALIBRATION, stamp_ns, self._names[0], f"{reason}: check the base IMU's mounting"
            )
        self._was_contradictory = is_contradictory

    def _findings(self, before: LearntJoint) -> Iterator[_Finding]:
        zero, (encoder, base, cabin) = self._zero, self._names
        off_rad, sigma_rad = float(zero["correction_rad"]), sqrt(float(zero["correction_variance"]))
        off_deg = degrees(off_rad)
        text = (
            f"its zero is {off_deg:+.2f} deg from the configured one, sigma {degrees(sigma_rad):.2f} deg: "
            f"add {off_deg:.3f} to zero_offset_deg, or {-off_deg:.3f} to the yaw of {base}"
        )
        yield _Finding(encoder, off_rad, sigma_rad, SLACK_RAD, text)
        of_cabin, of_base = tilts(zero, before)
        for sensor, (found, variances) in ((base, of_base), (cabin, of_cabin)):
            (roll, pitch), sigma = found.tolist(), sqrt(0.5 * float(variances[0] + variances[1]) + self._ratio**2)
            tilt = hypot(roll, pitch)
            text = (
                f"tilted by {degrees(tilt):.1f} deg against the axis of the joint otherwise than configured, "
                f"sigma {degrees(sigma):.1f} deg: roll {degrees(roll):+.2f}, pitch {degrees(pitch):+.2f} deg"
            )
            yield _Finding(sensor, tilt, sigma, TILT_SLACK_RAD, text)
