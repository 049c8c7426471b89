"""Where everything lies: the records that the compiled functions read and write, one table each.

Stamps and counts are 64-bit integers, the rest are doubles in SI units. What is published, `ESTIMATE` and `CHASSIS`, is
laid out in `holdfast.state`. Matrices lie row by row; tangents are those of `holdfast.state`.
"""

from typing import Any

import numba
import numpy as np

from holdfast.state import NAV, POSE, PUBLISHED

INT, FLOAT = np.int64, np.float64
NEVER = -(1 << 62)  # a stamp before all others

SAMPLE = np.dtype([
    ("stamp_ns", INT),  # in continuous time, offset applied
    ("force", FLOAT, 3),
    ("rate", FLOAT, 3),
    ("is_gap", INT),  # the interval that ends here
])  # fmt: skip
"""One reading of the IMU; 64 bytes, a line of the cache."""

BLOCK = np.dtype([("number", INT), ("force", FLOAT), ("rate", FLOAT)])
"""Noise density that a block of samples shows, once it was asked for; `number` counts from 1."""

STEP = np.dtype([("dt_s", FLOAT), ("force", FLOAT, 3), ("rate", FLOAT, 3)])
"""A stretch of IMU data with its mean readings."""

BUFFER = np.dtype([
    ("samples_at", INT), ("rows", INT),  # where the rows of `SAMPLE` lie, and how many there are
    ("blocks_at", INT), ("block_rows", INT),
    ("first", INT), ("end", INT),  # the samples that are held
    ("dropped", INT),  # samples since the last `clear` that are held no more, and lay before row 0
    ("newest_ns", INT),  # 0 before the first
    ("before_ns", INT),  # of the one before it
    ("arrival_ns", INT),  # of the newest
    ("line_start", INT),  # row at which the run on one line begins that the newest is on
    ("gaps", INT),  # rows with is_gap set
    ("max_gap_ns", INT), ("least_gap_ns", INT),  # as it is now, and as configured
    ("is_suspicious", INT),  # the last stamps were refused
    ("delay_ns", INT), ("older_delay_ns", INT), ("delays", INT),
    ("periods", INT), ("periods_ns", INT, 64),
    ("accelerometer_range", FLOAT), ("gyroscope_range", FLOAT),
    ("sway", FLOAT),  # density of what the accelerometer feels, and no receiver sees
])  # fmt: skip
"""The buffer of the IMU's samples."""

PREINTEGRATED = np.dtype([
    ("dt_s", FLOAT),
    ("theta", FLOAT, 3), ("p", FLOAT, 3), ("v", FLOAT, 3),  # rotation vector, position, velocity
    ("covariance", FLOAT, (9, 9)),
    ("by_bias", FLOAT, (9, 6)),  # derivative by the biases, accelerometer first
])  # fmt: skip
"""Consecutive steps, preintegrated with one bias."""

OPTIMISED = np.dtype([
    ("stamp_ns", INT),
    ("nav", NAV),
    ("bias_accel", FLOAT, 3), ("bias_gyro", FLOAT, 3),
    ("rate", FLOAT, 3),  # bias removed
    ("P", FLOAT, (15, 15)),
])  # fmt: skip
"""A state of the optimiser."""

PROPAGATION = np.dtype([
    ("stamp_ns", INT), ("from_imu", INT),
    ("optimised", OPTIMISED),
    ("start", NAV), ("P", FLOAT, (15, 15)),  # of the samples in `pim`
    ("noise", FLOAT, 3),  # variance densities of accelerometer, gyroscope, integration of position
    ("rate", FLOAT, 3),
    ("pim", PREINTEGRATED),
    ("nav", NAV),  # at the stamp
])  # fmt: skip
"""An optimised state, carried forward by the samples since."""

FRAME = np.dtype([
    ("T_W_O", POSE), ("rest", POSE),
    ("flows", INT), ("always", INT),  # whether T_W_O moves, and the policy
])  # fmt: skip
"""The odometry frame."""

SHARED = np.dtype([
    ("ring_at", INT), ("ring_rows", INT), ("written_at", INT),  # rows of samples, and how many were written
    ("slot_at", INT), ("slot_words", INT), ("healths", INT),  # 0 without another process; words of a row, of health
    ("taken_at", INT),  # where the row of the state is kept that was taken in last
    ("epoch", INT),  # how often all began anew
    ("seen", INT), ("left", INT),  # version of the state taken in last; samples for which a newer one was left alone
    ("life", INT), ("recoveries", INT), ("flags", INT), ("datum", FLOAT, 3),  # as they were in that one
    ("anchor_ns", INT), ("is_rescued", INT), ("rescue_ns", INT), ("patience_ns", INT), ("kept_ns", INT),
])  # fmt: skip
"""What `holdfast.realtime` shares with the other process, and what was last taken from there."""

PATH = np.dtype([
    ("propagations_at", INT), ("buffer_at", INT), ("work_at", INT), ("mount_at", INT),
    ("joint_at", INT), ("rotations_at", INT), ("rotation_rows", INT), ("waiting_at", INT), ("waiting_rows", INT),
    ("used", INT),  # samples, since they were last counted
    ("offset_ns", INT),  # of the IMU, that stamps in the buffer have and those in the ring have not
    ("clock_ns", INT),  # of its stamps against continuous time
    ("is_running", INT),
    ("newest", INT),  # which of the two propagations is published; the other is what was before
    ("is_replaced", INT), ("is_recovery", INT),
    ("was_ahead", INT), ("has_imu", INT),
    ("gravity", FLOAT),
    ("accelerometer_density", FLOAT), ("gyroscope_density", FLOAT),  # of the datasheet
    ("force_error", FLOAT), ("rate_error", FLOAT),  # in proportion to the motion, as densities
    ("walk", FLOAT, 6),  # of the biases, variance densities
    ("imu_noise", FLOAT, 3), ("motion_noise", FLOAT, 3),  # variance densities as in PROPAGATION
    ("incoming", OPTIMISED),  # a new state of the optimiser
    ("frame", FRAME),
    ("shared", SHARED),
    ("published", PUBLISHED),
])  # fmt: skip
"""The IMU path: what it is configured to, and what it has published last."""

ROTATION = np.dtype([("stamp_ns", INT), ("angle_rad", FLOAT)])
"""By how much the joint has turned until a time, since long ago."""

JOINT_READING = np.dtype([
    ("stamp_ns", INT), ("order", INT), ("is_angle", INT), ("value", FLOAT),
    ("rate", FLOAT, 3), ("force", FLOAT, 3),  # of the base IMU, in its own axes
])  # fmt: skip
"""A reading of the encoder [rad] or the base gyroscope [rad/s]; `order` is that of sensors at equal stamps."""

REPEATS = np.dtype([
    ("has_reading", INT), ("is_frozen", INT), ("since_ns", INT),
    ("reading_rad", FLOAT), ("rotation_rad", FLOAT), ("step_rad", FLOAT),
    ("least_rad", FLOAT),  # of hidden rotation, for a frozen one
])  # fmt: skip
"""The encoder while it repeats a reading: (35) in docs/math.md."""

CABIN_ROWS = 128  # some tenths of a second

ZERO = np.dtype([
    # what the cabin has measured, in the axes of J: rate, its vertical part turned along, force, its vertical part
    ("rows", INT), ("stamps_ns", INT, CABIN_ROWS), ("integrals", FLOAT, (CABIN_ROWS, 8)),
    ("cabin", FLOAT, 8), ("cabin_rate", FLOAT, 3),  # at the newest row
    # what the base IMU has measured since the window began: rate and force in the axes of J
    ("base_ns", INT), ("since_ns", INT),  # of the newest reading, and of the window's begin; NEVER
    ("base", FLOAT, 6), ("base_rate", FLOAT, 3), ("base_integrals", FLOAT, 6), ("smooth", FLOAT, 6),
    ("cabin_at_start", FLOAT, 8), ("smooth_at_start", FLOAT, 6),
    # increments over a window that is done
    ("is_pending", INT), ("window_s", FLOAT),
    ("window_cabin", FLOAT, 8), ("window_base", FLOAT, 6), ("window_change", FLOAT, 6),
    # the regressions of rates and forces
    ("windows", INT), ("x", FLOAT, (2, 9)), ("P", FLOAT, (2, 9, 9)),
    ("variance", FLOAT, 2),  # of an increment, per second of the window
    ("h", FLOAT, 9), ("Ph", FLOAT, 9),  # scratch paper
    # what comes of it
    ("correction_rad", FLOAT), ("correction_variance", FLOAT), ("is_wrong", INT),
    ("is_contradictory", INT),  # rates and forces do not agree
    ("applied_rad", FLOAT),  # of the correction, until now
    ("measured_rad", FLOAT), ("measured_variance", FLOAT),  # with what was known before; variance 0: nothing
    # what was known before the start, its variance and by how much it may have changed since; variance 0: nothing
    ("kept_rad", FLOAT), ("kept_variance", FLOAT), ("kept_change", FLOAT), ("another_log_odds", FLOAT),
    ("is_refuted", INT),  # it has just been: what was applied of it goes out fast
    # what is configured
    ("R_J_S", FLOAT, (3, 3)), ("p_J_S", FLOAT, 3),  # of the base IMU
    ("walk", FLOAT, (2, 9)), ("floor", FLOAT, 2), ("mounting_variance", FLOAT), ("zero_variance", FLOAT),
])  # fmt: skip
"""The zero of the encoder, and the measurements from which it is learnt."""

JOINT = np.dtype([
    ("stamp_ns", INT),  # NEVER before the first
    ("is_known", INT),  # there was a reading of the angle
    ("refused_ns", INT), ("rate_ns", INT),  # since when angles are refused, newest rate; NEVER
    ("angle_rad", FLOAT), ("rate_rad_s", FLOAT), ("bias_rad_s", FLOAT), ("lag_s", FLOAT),
    ("P", FLOAT, 10),  # upper triangle of their covariance, row by row
    ("joint_rate_rad_s", FLOAT),
    ("first", INT), ("end", INT),  # rows of ROTATION that are held
    ("gyro_ns", INT), ("angle_ns", INT), ("used_ns", INT),  # newest readings, and the newest angle in use
    ("gyro_period_s", FLOAT), ("gyro_rad_s", FLOAT),
    ("gyro_changes", FLOAT), ("gyro_changed2", FLOAT),  # of successive readings: how many, and as a noise [rad^2/s]
    ("corrected_rad", FLOAT), ("held_rad", FLOAT),  # since the last estimate; what is not let out yet
    ("encoder", INT),  # ENCODERS of `turn_joint`
    ("waiting", INT), ("is_full", INT),  # rows of JOINT_READING
    ("counts", INT, (2, 4)),  # readings by outcome: rates, angles; since they were last counted
    ("motion", FLOAT, 4),  # angle, its sigma, rate of the chassis, its sigma
    ("repeats", REPEATS),
    ("zero", ZERO),
    # what is configured
    ("has_gyro", INT), ("max_age_ns", INT), ("memory_ns", INT), ("accept_after_ns", INT), ("gyro_gap_ns", INT),
    ("bias_walk", FLOAT), ("lag_walk", FLOAT), ("gyro_density2", FLOAT),
    ("angle_variance", FLOAT),
    ("cabin_density2", FLOAT), ("motion_ratio2", FLOAT), ("silent_density2", FLOAT),
])  # fmt: skip
"""The turn joint and its filter."""

MOUNT = np.dtype([
    ("T_I_A", POSE), ("T_J_B", POSE),
    ("has_chassis", INT), ("has_joint", INT),
    ("stamp_ns", INT),  # of the estimate before
    ("axis_rate_rad_s", FLOAT),  # of the cabin about the axis, at the estimate before
])  # fmt: skip
"""Where the chassis sits: A is the joint as it sits in the cabin, J as it sits in the chassis."""

WORK = np.dtype([
    ("R", FLOAT, (3, 3)), ("left", FLOAT, (3, 3)), ("right", FLOAT, (3, 3)), ("inverse", FLOAT, (3, 3)),
    ("skew", FLOAT, (3, 3)), ("half", FLOAT, (3, 3)),
    ("by_theta_rate", FLOAT, (3, 3)), ("by_theta_force", FLOAT, (3, 3)),
    ("turn", FLOAT, (3, 3)), ("attitude", FLOAT, (3, 3)),
    ("T", FLOAT, (9, 15)), ("B", FLOAT, (6, 9)), ("cross", FLOAT, (9, 6)), ("covariance", FLOAT, (9, 9)),
    ("nav", NAV), ("pose", POSE),
    ("step", STEP),
])  # fmt: skip
"""Scratch paper: what is in it means nothing after a call."""


def records(dtype: np.dtype[Any]) -> Any:
    """Return the type of a one-dimensional array of records, for signatures."""
    return numba.from_dtype(dtype)[::1]
