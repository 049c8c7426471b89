"""The verdict on one run of a scenario: scores by name, and the outages one by one."""

from dataclasses import dataclass
from math import inf, nan

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import EstimatorError
from holdfast.evaluation import quaternions
from holdfast.evaluation.at_fixes import at_fixes
from holdfast.evaluation.consistency import nees
from holdfast.evaluation.evidence import Chassis, Published, Truth
from holdfast.evaluation.outages import Outage, judge_outages, nominal, norm_rms, outage_spans, sum_up, within
from holdfast.evaluation.smoothness import drift_m, steps
from holdfast.evaluation.spans import Span, longest_s
from holdfast.evaluation.states import StateErrors, state_errors
from holdfast.messages import Array
from holdfast.state import Trajectory

MISLED_M = 0.3
BLOCKS = {"attitude": slice(0, 3), "position": slice(3, 6), "velocity": slice(6, 9)}

Scores = dict[str, float]


@dataclass(frozen=True, slots=True)
class Verdict:
    """The result; a score that the scenario has no occasion for is NaN."""

    scores: Scores
    outages: tuple[Outage, ...]


def judge(published: Published, truth: Truth) -> Verdict:
    """Judge one run.

    Raises:
        EstimatorError: nothing was published.
    """
    stamps = published.world.poses.stamps_ns
    if len(stamps) < 2:
        raise EstimatorError("nothing was published that could be judged")
    times_s = truth.seconds(stamps)
    errors = state_errors(published.world, truth.states)
    spans = outage_spans(truth, Span(float(times_s[0]), float(times_s[-1])))
    outages = judge_outages(errors, published, truth, spans)
    good = nominal(times_s, spans)
    far = np.linalg.norm(errors.position, axis=1) > MISLED_M
    scores = {"started_s": float(times_s[0]), "misled_s": longest_s(times_s, far & published.trusted)}
    scores |= _accuracy(errors, good) | _against_fixes(published.world.poses, truth, good)
    scores["horizontal_ratio"] = scores["horizontal_rms_m"] / scores["fix_horizontal_rms_m"]
    scores["vertical_ratio"] = scores["vertical_rms_m"] / scores["fix_vertical_rms_m"]
    scores |= sum_up(outages) | _smoothness(published, truth) | _chassis(published.chassis, truth)
    scores |= _consistency("nees", errors, published.covariances, good)
    scores |= _consistency("fallback_nees", errors, published.covariances, within(times_s, spans))
    return Verdict(scores, tuple(outages))


def _accuracy(errors: StateErrors, good: NDArray[np.bool_]) -> Scores:
    position, attitude = errors.position[good], np.degrees(errors.attitude[good])
    return {
        "horizontal_rms_m": norm_rms(position[:, :2]),
        "horizontal_max_m": float(np.linalg.norm(position[:, :2], axis=1).max(initial=0.0)),
        "vertical_rms_m": norm_rms(position[:, 2:]),
        "heading_rms_deg": norm_rms(attitude[:, 2:]),
        "roll_pitch_rms_deg": norm_rms(attitude[:, :2]) / np.sqrt(2.0),
    }


def _against_fixes(poses: Trajectory, truth: Truth, good: NDArray[np.bool_]) -> Scores:
    """Judge by the good fixes of nominal times, as the paper does, and judge these fixes by the truth.

    The paper's Table I gives 0.18 +- 1.28 cm as mean and standard deviation of the relative position error against
    RTK. No distance has a mean so far below its deviation, so these are signed errors. Here the mean is the length of
    the mean vector, and the deviation that of all three axes together: the position of the antenna, as published for
    the time of the fix, minus the fix.
    """
    found = at_fixes(poses, truth, good)
    error, residual = found.fix_errors, found.residuals
    return {
        "fix_horizontal_rms_m": norm_rms(error[:, :2]),
        "fix_vertical_rms_m": norm_rms(error[:, 2:]),
        "rtk_mean_m": float(np.linalg.norm(residual.mean(axis=0))) if len(residual) else nan,
        "rtk_std_m": float(np.sqrt(residual.var(axis=0).mean())) if len(residual) else nan,
    }


def _smoothness(published: Published, truth: Truth) -> Scores:
    moved, turned = steps(published.odometry, published.inertial)
    drift, distance = drift_m(published.odometry, truth.states)
    return {
        "step_m": float(np.nanmax(moved, initial=0.0)),
        "step_deg": float(np.nanmax(turned, initial=0.0)),
        "drift_percent": 100.0 * drift / distance if distance > 0.0 else nan,
    }


def _chassis(published: Chassis | None, truth: Truth) -> Scores:
    """Judge what the pose of the chassis adds to the errors of the cabin's, while slewing, and its yaw rate."""
    if published is None:
        return dict.fromkeys(("base_position_rms_m", "base_rotation_rms_deg", "base_yaw_rate_rms_rad_s"), nan)
    ours, theirs = published.in_imu, truth.chassis.in_imu
    known = np.isfinite(ours.positions).all(axis=1)
    slewing = known & truth.slewing
    rotation = quaternions.multiply(quaternions.conjugate(ours.quaternions), theirs.quaternions)[slewing]
    return {
        "base_position_rms_m": norm_rms((ours.positions - theirs.positions)[slewing]),
        "base_rotation_rms_deg": float(np.degrees(norm_rms(quaternions.angle_rad(rotation)[:, None]))),
        "base_yaw_rate_rms_rad_s": norm_rms((published.yaw_rate - truth.chassis.yaw_rate)[known, None]),
    }


def _consistency(prefix: str, errors: StateErrors, covariances: Array, where: NDArray[np.bool_]) -> Scores:
    """Return the mean NEES per degree of freedom of each block; infinite where one is not positive definite."""
    scores = {}
    for name, block in BLOCKS.items():
        value = nan
        if where.any():
            try:
                value = float(nees(errors.tangent[where, block], covariances[where, block, block]).mean()) / 3.0
            except EstimatorError:
                value = inf
        scores[f"{prefix}_{name}"] = value
    return scores
