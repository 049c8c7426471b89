"""What is learnt at the turn joint: from the kernel's record to what is kept over a restart, and back.

The zero of the encoder is a prior of the next start, which motion that contradicts it refutes: (74) in docs/math.md.
The tilts of both units are told, not applied.
"""

from math import log, radians, remainder, sqrt, tau
from typing import Any

import numpy as np

from holdfast.chassis.base_gyro import BaseGyro
from holdfast.chassis.encoder import JointModel
from holdfast.chassis.encoder_zero import TILT_SIGMA_RAD, tilts
from holdfast.kernel.turn_joint import begin_with_zero
from holdfast.messages import Array
from holdfast.sensors.constants import ANOTHER, OBSERVED, LearntConstant
from holdfast.sensors.learnt_joint import LearntJoint
from holdfast.sensors.sensor import CHANGE_RAD


def begin_with(record: Any, learnt: LearntJoint, encoder: JointModel, gyro: BaseGyro) -> None:
    """Write into a record what was learnt before.

    The zero, and the yaw of the chassis' unit that looks like it, may each have changed by what a mount gives, but by
    no more than the configuration trusts them.

    Args:
        record: (1,) of `JOINT`, of which nothing is known.
        learnt: what was learnt.
        encoder: model of the encoder.
        gyro: model of the base IMU's gyroscope.
    """
    if learnt.zero is None:
        return
    zero, changes = record[0]["zero"], (sqrt(encoder.zero_variance), radians(gyro.config.mounting_sigma_deg))
    zero["kept_rad"], zero["kept_variance"] = remainder(learnt.zero.mean[0], tau), learnt.zero.sigmas[0] ** 2
    zero["kept_change"] = sum(min(CHANGE_RAD, one) ** 2 for one in changes)
    zero["another_log_odds"] = log(ANOTHER / (1.0 - ANOTHER))
    begin_with_zero(record)


def learnt_joint(zero: Any, before: LearntJoint) -> LearntJoint:
    """Return what is known now; what has not shown itself since is as before, unless it is refuted.

    Args:
        zero: a `ZERO`.
        before: what it began with.
    """
    known = before.zero
    if zero["measured_variance"] > 0.0:
        known = _constant([zero["measured_rad"]], [zero["measured_variance"]])
    elif zero["kept_variance"] == 0.0:
        known = None
    cabin, base = tilts(zero, before)
    return LearntJoint(
        zero=known,
        cabin_tilt=_learnt_tilt(zero, 4, cabin, before.cabin_tilt),
        base_tilt=_learnt_tilt(zero, 6, base, before.base_tilt),
    )


def _learnt_tilt(
    zero: Any, row: int, found: tuple[Array, Array], before: LearntConstant | None
) -> LearntConstant | None:
    """Return a tilt as it is kept, of which the variances of what was measured alone are in two rows."""
    is_seen = (zero["P"][0].diagonal()[row : row + 2] < (OBSERVED * TILT_SIGMA_RAD) ** 2).all()
    return _constant(*found) if is_seen else before


def _constant(mean: Any, variances: Any) -> LearntConstant | None:
    """Return numbers as they are kept; None where they are none."""
    values, sigmas = np.asarray(mean, np.float64), np.sqrt(np.asarray(variances, np.float64))
    if not (np.isfinite(values).all() and np.isfinite(sigmas).all() and (sigmas > 0.0).all()):
        return None
    return LearntConstant(mean=tuple(values.tolist()), sigmas=tuple(sigmas.tolist()))
