"""Whether a heading turns counter-clockwise where the machine does: it must turn as the gyroscope does."""

import numpy as np

from holdfast.messages import Array

SPAN_S = 2.0  # over which turns are compared
MAX_TURN_RAD = 2.5  # beyond it a turn could be one the other way round
MIN_TURN_RAD = 0.1
MIN_ROWS = 8
BETTER = 3.0  # times


def is_clockwise(imu_s: Array, imu: Array, heading_s: Array, headings_rad: Array) -> bool:
    """Return whether a heading counts clockwise, as a compass does, and not counter-clockwise (REP-103).

    Args:
        imu_s: (N,) stamps, increasing.
        imu: (N, 6) angular velocity [rad/s] and specific force [m/s^2]; the mean of the latter is up.
        heading_s: (M,) stamps, increasing.
        headings_rad: (M,), from anywhere.
    """
    if len(imu_s) < 2 or len(heading_s) < 2:
        return False
    up = np.mean(imu[:, 3:], axis=0)
    rate = imu[:, :3] @ (up / max(float(np.linalg.norm(up)), 1e-9))
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(imu_s))])
    after = np.searchsorted(heading_s, heading_s + SPAN_S)
    begin = np.flatnonzero((after < len(heading_s)) & (heading_s >= imu_s[0]))
    end = after[begin]
    felt = np.interp(heading_s[end], imu_s, yaw) - np.interp(heading_s[begin], imu_s, yaw)
    told = (headings_rad[end] - headings_rad[begin] + np.pi) % (2.0 * np.pi) - np.pi
    turns = (np.abs(felt) > MIN_TURN_RAD) & (np.abs(felt) < MAX_TURN_RAD)
    turns &= (heading_s[end] - heading_s[begin] < 2.0 * SPAN_S) & (heading_s[end] <= imu_s[-1])
    if turns.sum() < MIN_ROWS:
        return False
    told, felt = told[turns], felt[turns]
    return bool(np.median(np.abs(told - felt)) > BETTER * np.median(np.abs(told + felt)))
