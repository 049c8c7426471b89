"""Errors over time, thin enough to be drawn: the data of Figs. 3, 4 and 6, and of what the paper lacks."""

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import EstimatorError
from holdfast.evaluation.at_fixes import AtFixes, nis
from holdfast.evaluation.consistency import nees
from holdfast.evaluation.evidence import Published, Truth
from holdfast.evaluation.scenario import BLOCKS
from holdfast.evaluation.smoothness import steps
from holdfast.evaluation.states import StateErrors
from holdfast.messages import Array
from holdfast.paper.stream import OutcomeLog

MAX_ROWS = 2000
Curves = dict[str, Array]


def curves(published: Published, truth: Truth, errors: StateErrors) -> Curves:
    """Return columns of at most `MAX_ROWS` rows beside `time_s`; worst values stand for all since the row before.

    `east_m`, `north_m`, `up_m`: estimate minus truth; `x_m` to `z_m` and `true_x_m` to `true_z_m`: positions in W;
    `heading_deg`, `velocity_m_s`: errors; `sigma_horizontal_m`, `sigma_up_m`: standard deviations as reported;
    `nees_attitude`, `nees_position`, `nees_velocity`: per degree of freedom; `step_m`, `step_deg`: worst steps of O;
    `trusted`: whether GNSS is used; `base_m`, `base_yaw_rate_rad_s`: errors of the chassis beyond those of the cabin.
    """
    poses = published.world.poses
    rows = rows_of(len(poses.stamps_ns))
    found: Curves = {
        "time_s": truth.seconds(poses.stamps_ns[rows]),
        "trusted": published.trusted[rows].astype(np.float64),
    }
    for k, axis in enumerate(("east_m", "north_m", "up_m")):
        found[axis] = errors.position[rows, k]
    for k, axis in enumerate("xyz"):
        found[f"{axis}_m"] = poses.positions[rows, k]
        found[f"true_{axis}_m"] = truth.states.poses.positions[rows, k]
    found["heading_deg"] = np.degrees(errors.attitude[rows, 2])
    found["velocity_m_s"] = np.linalg.norm(errors.tangent[rows, 6:], axis=1)
    found |= _consistency(published, errors, rows)
    moved, turned = steps(published.odometry, published.inertial)
    found |= {"step_m": worst_since(moved, rows), "step_deg": worst_since(turned, rows)}
    if published.chassis is not None:
        apart = published.chassis.in_imu.positions[rows] - truth.chassis.in_imu.positions[rows]
        found["base_m"] = np.linalg.norm(apart, axis=1)
        found["base_yaw_rate_rad_s"] = (published.chassis.yaw_rate - truth.chassis.yaw_rate)[rows]
    return thin(found)


def curves_at_fixes(published: Published, truth: Truth, found: AtFixes) -> Curves:
    """Return `rtk_time_s` with `rtk_m`, the distance of the published antenna from the fix, and `nis`, per degree."""
    order = np.argsort(found.stamps_ns, kind="stable")
    values = nis(published, found)
    rows = rows_of(len(order))
    if not len(values):
        return {}
    chosen = order[rows]
    return thin(
        {
            "rtk_time_s": truth.seconds(found.stamps_ns[chosen]),
            "rtk_m": np.linalg.norm(found.residuals[chosen], axis=1),
            "nis": values[chosen] / 3.0,
        }
    )


def curves_of_corrections(truth: Truth, stamps_ns: NDArray[np.int64], distances_m: Array) -> Curves:
    """Return `correction_time_s` with `correction_m`: |propagated - optimised|, worst since the row before."""
    rows = rows_of(len(stamps_ns))
    found = {"correction_time_s": truth.seconds(stamps_ns[rows]), "correction_m": worst_since(distances_m, rows)}
    return thin(found)


def curves_of_outcomes(truth: Truth, log: OutcomeLog) -> Curves:
    """Return `outcome_time_s` with `outcome:SENSOR:OUTCOME`: counts of the receivers in the second before."""
    keys = sorted({key for _, counts in log.rows for key in counts if key[0] in log.receivers})
    rows = rows_of(len(log.rows))
    stamps = np.array([stamp for stamp, _ in log.rows], dtype=np.int64)
    found: Curves = {"outcome_time_s": truth.seconds(stamps[rows])}
    for sensor, outcome in keys:
        every = np.array([counts.get((sensor, outcome), 0) for _, counts in log.rows], dtype=np.float64)
        found[f"outcome:{sensor}:{outcome}"] = every[rows]
    return thin(found)


def _consistency(published: Published, errors: StateErrors, rows: NDArray[np.intp]) -> Curves:
    covariances = published.covariances[rows]
    found: Curves = {}
    for name, block in BLOCKS.items():
        try:
            found[f"nees_{name}"] = nees(errors.tangent[rows, block], covariances[:, block, block]) / 3.0
        except EstimatorError:
            found[f"nees_{name}"] = np.full(len(rows), np.inf)
    # the trace is that of the body's axes, which is near the world's for a machine that stands upright
    found["sigma_horizontal_m"] = np.sqrt(covariances[:, 3, 3] + covariances[:, 4, 4])
    found["sigma_up_m"] = np.sqrt(covariances[:, 5, 5])
    return found


def rows_of(count: int) -> NDArray[np.intp]:
    """Return at most `MAX_ROWS` rows out of `count`, evenly."""
    stride = max(1, -(-count // MAX_ROWS))
    return np.arange(stride - 1, count, stride, dtype=np.intp)


def worst_since(values: Array, rows: NDArray[np.intp]) -> Array:
    """Return the largest of the values (N,) from behind one row to the next; NaN counts as nothing."""
    if not len(rows):
        return np.zeros(0)
    known = np.where(np.isnan(values), 0.0, values)[: rows[-1] + 1]
    worst: Array = np.maximum.reduceat(known, np.concatenate([[0], rows[:-1] + 1]))
    return worst


def thin(columns: Curves) -> Curves:
    """Return times in double and everything else in single precision."""
    return {name: values if name.endswith("time_s") else values.astype(np.float32) for name, values in columns.items()}
