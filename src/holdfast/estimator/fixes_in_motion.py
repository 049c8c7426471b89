"""The positions that a start in motion rests on, or why they are too few."""

from collections.abc import Collection, Iterable, Sequence
from itertools import pairwise
from math import cos, radians

import numpy as np

from holdfast.estimator.course import travel_m
from holdfast.graph.alignment_problem import thin
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.sensor import Position

MIN_TRAVEL_M, MIN_TRAVEL_SIGMAS = 2.0, 5.0
TURNED_RAD, TURNED_TRAVEL_M = 1.0, 0.5  # a machine that digs turns where it stands: an arc of its arm is enough
MIN_POSITIONS = 3
LEAST_WAY_M, COS_TURNED = 0.3, cos(radians(30.0))


def fixes_in_motion(
    positions: Iterable[Position], receivers: Collection[str], buffer: ImuBuffer, now_ns: int, *, is_pair: bool = False
) -> list[Position] | str:
    """Return positions, thinned, since the IMU measures without a gap; or what is missing.

    Args:
        positions: that are known.
        receivers: of them, by name.
        buffer: of the IMU's samples.
        now_ns: until when.
        is_pair: two of the receivers tell the heading: the motion need only tell whether it is the right way round.
    """
    if not receivers:
        return "moving, and no source of positions is configured: start at standstill"
    since_ns = _measuring_since_ns(buffer, now_ns)
    between = [one for one in positions if since_ns < one.stamp_ns <= now_ns]
    fixes = thin(sorted(between, key=lambda one: one.stamp_ns))
    if len(fixes) < MIN_POSITIONS:
        return f"{len(fixes)} usable positions since the IMU measures without a gap; {MIN_POSITIONS} are needed"
    travel = max(travel_m([fix for fix in fixes if fix.sensor == name]) for name in receivers)
    is_told = is_pair or (travel < MIN_TRAVEL_M and _has_turned(buffer, fixes))
    least_m = TURNED_TRAVEL_M if is_told else MIN_TRAVEL_M
    needed = max(least_m, MIN_TRAVEL_SIGMAS * float(np.sqrt(fixes[-1].covariance[:2, :2].max())))
    if travel < needed:
        return f"moved {travel:.1f} m; a heading from motion needs {needed:.1f} m"
    return fixes


def _has_turned(buffer: ImuBuffer, fixes: Sequence[Position]) -> bool:
    """Whether the gyroscope has turned far since the first of some fixes, at any of them."""
    stamps = sorted({fix.stamp_ns for fix in fixes})
    angles = np.cumsum([buffer.turning(*between).angle_rad for between in pairwise(stamps)], axis=0)
    return bool((np.linalg.norm(angles, axis=-1) > TURNED_RAD).any())


def turn(fixes: Sequence[Position]) -> bool:
    """Whether receivers have moved in directions that tell of a lever arm: without a turn it moves all alike."""
    directions = []
    for name in {one.sensor for one in fixes}:
        ways = np.diff([one.p_W_P[:2] for one in fixes if one.sensor == name], axis=0)
        lengths = np.linalg.norm(ways, axis=1)
        directions.append(ways[lengths > LEAST_WAY_M] / lengths[lengths > LEAST_WAY_M, None])
    found = np.concatenate(directions)
    return len(found) > 1 and float((found @ found.T).min()) < COS_TURNED


def _measuring_since_ns(buffer: ImuBuffer, now_ns: int) -> int:
    """Return the end of the last gap of the IMU."""
    start = buffer.oldest_ns
    for piece in buffer.pieces(start, now_ns):
        if piece.is_gap:
            start = piece.end_ns
    return start
