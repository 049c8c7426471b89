"""Relative pose error: how much the estimate drifts over a distance or a time."""

from dataclasses import dataclass
from math import inf
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import ConfigError
from holdfast.evaluation import quaternions
from holdfast.evaluation.association import Pairs
from holdfast.messages import Array

Unit = Literal["m", "s", "frames"]
Pairing = Literal["all", "consecutive"]

KITTI_LENGTHS_M = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
KITTI_STEP_POSES = 10
MIN_DISTANCE_M = 1.0  # near standstill a percentage over a second has no meaning

_Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class RelativeErrors:
    """Errors of motions from pose `first[k]` to pose `second[k]` of the pairs.

    Attributes:
        first: (K,) indices of the poses at which the motions start.
        second: (K,) indices of the poses at which they end.
        errors: by name, each (K,); NaN where one is not defined. See `rpe`.
    """

    first: _Index
    second: _Index
    errors: dict[str, Array]


def rpe(
    pairs: Pairs, delta: float, unit: Unit = "m", pairing: Pairing = "all", tolerance: float = 0.1
) -> RelativeErrors:
    """Return the errors of the motions over `delta` metres driven, seconds or poses.

    With the motions P = P_i^-1 P_j of the estimate and Q = Q_i^-1 Q_j of the reference (Sturm et al., A benchmark for
    the evaluation of RGB-D SLAM systems, IROS 2012, error Q^-1 P):

    `translation_m` = |t_P - t_Q|, which is the translation of Q^-1 P; `forward_m`, `left_m`, `up_m` are t_P - t_Q on
    the axes of the body at the start; `rotation_deg` is the angle of R_Q^T R_P, `roll_deg`, `pitch_deg`, `yaw_deg` its
    angles of Rz Ry Rx. `translation_percent` is translation_m in percent of the distance that the reference drove
    between the two poses; over time only where that is 1 m at least. `rotation_deg_per_m` and `rotation_deg_per_s`
    divide by the distance, or by the time, between the two poses.

    Without orientation the motions are the displacements p_j - p_i on the axes of the world: `translation_m`,
    `translation_percent`, `east_m`, `north_m`, `up_m`; these depend on the alignment, the others do not.

    `all` starts at every pose and ends at the pose whose distance (time) is nearest to `delta`, if it is within
    `tolerance * delta`; `consecutive` chains motions, each ending at the first pose at or beyond `delta`. Both are
    evo's definitions with pairs_from_reference. Time and poses are counted in integers.

    Raises:
        ConfigError: delta is not positive and finite, or not whole for a unit of frames.
    """
    if not 0.0 < delta < inf or (unit == "frames" and delta != int(delta)):
        raise ConfigError(f"RPE over {delta} {unit}: must be positive, and whole for frames")
    odometer: NDArray[Any]
    if unit == "m":
        odometer, step = pairs.driven_m(), delta
    elif unit == "s":
        odometer, step = pairs.reference.stamps_ns, round(delta * 1e9)
    else:
        odometer, step, tolerance = np.arange(len(pairs)), int(delta), 0.0
    select = _all_pairs if pairing == "all" else _consecutive_pairs
    first, second = select(odometer, step, tolerance * step)
    return _errors(pairs, first, second, unit)


def kitti(pairs: Pairs) -> RelativeErrors:
    """Return the errors of the segments of the KITTI odometry benchmark: 100 m to 800 m, started at every tenth pose.

    As its development kit does, a segment ends at the first pose beyond its length, and `translation_percent` and
    `rotation_deg_per_m`, the only errors here, divide by the nominal length (Geiger, Lenz, Urtasun, CVPR 2012). Their
    means are the two numbers of the benchmark's table.
    """
    driven = pairs.driven_m()
    starts = np.arange(0, len(pairs), KITTI_STEP_POSES)
    first, second, length = [], [], []
    for length_m in KITTI_LENGTHS_M:
        ends = np.searchsorted(driven, driven[starts] + length_m, side="right")
        inside = ends < len(pairs)
        first.append(starts[inside])
        second.append(ends[inside])
        length.append(np.full(int(inside.sum()), length_m))
    result = _errors(pairs, np.concatenate(first), np.concatenate(second), "m")
    nominal = np.concatenate(length)
    errors = {"translation_percent": 100.0 * result.errors["translation_m"] / nominal}
    if pairs.oriented:
        errors["rotation_deg_per_m"] = result.errors["rotation_deg"] / nominal
    return RelativeErrors(result.first, result.second, errors)


def _all_pairs(odometer: NDArray[Any], step: float, tolerance: float) -> tuple[_Index, _Index]:
    """For each start the nearest end after it; of ends that are equally near the first."""
    first = np.arange(len(odometer) - 1)
    after = np.clip(np.searchsorted(odometer, odometer[:-1] + step), first + 1, len(odometer) - 1)
    before = np.maximum(after - 1, first + 1)
    residual_after = np.abs(odometer[after] - odometer[first] - step)
    residual_before = np.abs(odometer[before] - odometer[first] - step)
    second = np.where(residual_before <= residual_after, before, after)
    # poses at which the reference stands still have driven the same distance: take the first of them
    second = np.maximum(np.searchsorted(odometer, odometer[second]), first + 1)
    near = np.minimum(residual_before, residual_after) <= tolerance
    return first[near], second[near]


def _consecutive_pairs(odometer: NDArray[Any], step: float, tolerance: float) -> tuple[_Index, _Index]:  # noqa: ARG001
    chain = [0]
    following = 0
    while following < len(odometer):
        chain.append(following)
        # never the same pose again, though the step may be lost in the rounding of the sum
        following = max(following + 1, int(np.searchsorted(odometer, odometer[following] + step)))
    chain = chain[1:]
    return np.array(chain[:-1], dtype=np.intp), np.array(chain[1:], dtype=np.intp)


def _errors(pairs: Pairs, first: _Index, second: _Index, unit: Unit) -> RelativeErrors:
    driven = pairs.driven_m()
    distance_m = driven[second] - driven[first]
    ours, theirs = pairs.estimate, pairs.reference
    move_ours = ours.positions[second] - ours.positions[first]
    move_theirs = theirs.positions[second] - theirs.positions[first]
    axes = ("east_m", "north_m", "up_m")
    if pairs.oriented:
        to_start_ours = quaternions.conjugate(ours.quaternions[first])
        to_start_theirs = quaternions.conjugate(theirs.quaternions[first])
        move_ours = quaternions.rotate(to_start_ours, move_ours)
        move_theirs = quaternions.rotate(to_start_theirs, move_theirs)
        axes = ("forward_m", "left_m", "up_m")
    difference = move_ours - move_theirs
    errors = {"translation_m": np.linalg.norm(difference, axis=1)}
    if unit != "frames":
        errors["translation_percent"] = _ratio(
            100.0 * errors["translation_m"], distance_m, MIN_DISTANCE_M if unit == "s" else 0.0
        )
    errors |= dict(zip(axes, difference.T, strict=True))
    if pairs.oriented:
        rotation_ours = quaternions.multiply(to_start_ours, ours.quaternions[second])
        rotation_theirs = quaternions.multiply(to_start_theirs, theirs.quaternions[second])
        rotation = quaternions.multiply(quaternions.conjugate(rotation_theirs), rotation_ours)
        errors["rotation_deg"] = np.degrees(quaternions.angle_rad(rotation))
        roll, pitch, yaw = np.degrees(quaternions.roll_pitch_yaw_rad(rotation)).T
        errors |= {"roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw}
        if unit == "m":
            errors["rotation_deg_per_m"] = _ratio(errors["rotation_deg"], distance_m, 0.0)
        elif unit == "s":
            time_s = (theirs.stamps_ns[second] - theirs.stamps_ns[first]) * np.float64(1e-9)
            errors["rotation_deg_per_s"] = _ratio(errors["rotation_deg"], time_s, 0.0)
    return RelativeErrors(first, second, errors)


def _ratio(numerator: Array, denominator: Array, shortest: float) -> Array:
    """Divide where the denominator is positive and long enough; NaN elsewhere."""
    defined = (denominator > 0.0) & (denominator >= shortest)
    ratio: Array = np.divide(numerator, denominator, out=np.full(len(numerator), np.nan), where=defined)
    return ratio
