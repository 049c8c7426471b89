"""The zero of the turn joint's encoder, and how both IMUs sit on it, from the gyroscopes of cabin and chassis.

What does not turn about the joint must be felt by both alike. With the angle q of the encoder, a the angular velocity
of the cabin and w that of the chassis, both in the axes of the joint as they are configured, the horizontal rows of

    Rz(q) (a + (c + z e_z) x a - b_a) = w + d x w - b_w,    e_z along the joint                     (56) in docs/math.md

tell the zero z and the tilts c of the cabin and d of the chassis' IMU. The yaw of both mounts cannot be told from z, so
that z is known no better than `mounting_sigma_deg` of the chassis' IMU says.
"""

from collections.abc import Iterator, Sequence
from math import degrees, hypot, radians

import gtsam
import numpy as np
from numpy.typing import NDArray

from holdfast.calibration.estimated import Estimated, Family, Found, judged
from holdfast.calibration.evidence import Evidence, Readings
from holdfast.calibration.placing import entry_of, moved, placed
from holdfast.config.edit import Change
from holdfast.config.model import Config
from holdfast.messages import Array

BIN_S = 0.1  # rates are averaged over, so that vibration and noise of the stamps weigh less
CHUNK_S = 120.0  # in which a bias is constant
CLUSTER_S = 5.0  # errors further apart are independent
GAP_S = 0.05
AXES_RAD = 5e-4  # sigma: axes of a gyroscope that are not at right angles look like a tilt
TILT_DEG = 1.0  # sigma of how an IMU was mounted
HUBER, ROUNDS = 2.0, 8
MIN_BINS = 200
CONSTANTS = 5  # z, c_x, c_y, d_x, d_y


def turn_joint(evidence: Sequence[Evidence], original: Config) -> Found:
    """Return the zero of the encoder and the tilts of cabin and chassis' IMU against the joint.

    Args:
        evidence: of runs; only the readings count, which no rotation of a mount has touched.
        original: the configuration.
    """
    if original.joint is None or original.turn_joint is None or original.base_imu is None:
        return Found()
    (name, section), (base, chassis_imu) = original.joint, original.base_imu
    path, tilts = ("sensors", name, "zero_offset_deg"), ("turn_joint", "rotation_rpy_deg")
    base_frame = original.frame_of(base)
    before, prior = section.zero_offset_deg, section.zero_offset_sigma_deg
    solved = _solve([rows for one in evidence for rows in _chunks(one, original)], original)
    if solved is None:
        nothing = Estimated(Family.TURN_JOINT, path, f"zero of {name}", "deg", before, before, prior, prior)
        return Found([nothing.kept("not observable: too little motion of cabin and chassis")])
    values = np.degrees(solved[0]).tolist()
    sigmas = [hypot(degrees(one), degrees(AXES_RAD)) for one in solved[1].tolist()]
    sigmas[0] = hypot(degrees(float(solved[1][0])), chassis_imu.mounting_sigma_deg)  # its yaw looks like a zero
    rows = [Estimated(Family.TURN_JOINT, path, f"zero of {name}", "deg", before, before + values[0], sigmas[0], prior)]
    chassis = "extrinsics", entry_of(original, base_frame), "rotation"
    places = [(original.turn_joint.child, tilts, axis) for axis in "xy"] + [(base, chassis, axis) for axis in "xy"]
    for (what, where, axis), value, sigma in zip(places, values[1:], sigmas[1:], strict=True):
        text = f"{what}, about the joint's {axis}"
        rows.append(Estimated(Family.TURN_JOINT, where, text, "deg", 0.0, value, sigma, TILT_DEG))
    rows = [judged(one) for one in rows]
    return Found(*_changes(original, rows, path, base_frame))


def _changes(
    original: Config, rows: list[Estimated], path: tuple[str, ...], base_frame: str
) -> tuple[list[Estimated], list[Change]]:
    """Return the rows and the changes that they make."""
    assert original.turn_joint is not None
    changes: list[Change] = []
    if rows[0].is_written:
        changes.append(Change(path, round(rows[0].after, 3)))
    cabin, chassis = rows[1:3], rows[3:5]
    if any(one.is_written for one in cabin):
        T_parent_child = original.turn_joint.matrix()
        T_parent_child[:3, :3] = _tilt(cabin)[:3, :3] @ T_parent_child[:3, :3]
        changes += placed(("turn_joint",), original.turn_joint, T_parent_child)
    if any(one.is_written for one in chassis):
        T = original.T(original.turn_joint.parent, base_frame)
        turned = _tilt(chassis)
        turned[:3, 3] = T[:3, 3] - turned[:3, :3] @ T[:3, 3]  # it stays where it is
        written = moved(original, base_frame, np.linalg.inv(T) @ turned @ T)
        if isinstance(written, str):
            chassis = [one.kept(written) for one in chassis]
        else:
            changes += written
    return [rows[0], *cabin, *chassis], changes


def _tilt(rows: Sequence[Estimated]) -> Array:
    x, y = (radians(one.after) if one.is_observable else 0.0 for one in rows)
    T = np.eye(4)
    T[:3, :3] = gtsam.Rot3.Expmap(np.array([x, y, 0.0])).matrix()
    return T


def _chunks(evidence: Evidence, config: Config) -> Iterator[tuple[Array, Array]]:
    """Yield design (M, 9) and right side (M,) of stretches in which the biases are constant; rows in pairs x, y."""
    assert config.joint is not None and config.base_imu is not None
    names = config.imu_name, config.base_imu[0], config.joint[0]
    found = [evidence.readings.get(name) for name in names]
    if any(one is None or len(one.times_ns) < MIN_BINS for one in found):
        return
    imu, base, joint = (one for one in found if one is not None)
    begin = max(one.times_ns[0] for one in (imu, base, joint))
    end = min(one.times_ns[-1] for one in (imu, base, joint))
    chunk_ns = round(CHUNK_S * 1e9)
    for start in range(int(begin), int(end), chunk_ns):
        rows = _rows((imu, base, joint), config, start, min(start + chunk_ns, int(end)))
        if rows is not None:
            yield rows


def _rows(
    found: tuple[Readings, Readings, Readings], config: Config, start_ns: int, end_ns: int
) -> tuple[Array, Array] | None:
    imu, base, joint = found
    chosen = slice(*np.searchsorted(base.times_ns, [start_ns, end_ns]))
    times_s: Array = np.asarray((base.times_ns[chosen] - start_ns) * 1e-9, np.float64)
    if len(times_s) < MIN_BINS:
        return None
    size = max(1, round(BIN_S / float(np.median(np.diff(times_s)))))
    count = len(times_s) // size
    zero_rad = 0.0 if config.joint is None else radians(config.joint[1].zero_offset_deg)
    q = _at(joint, start_ns, times_s)[:, 0] + zero_rad
    a = _at(imu, start_ns, times_s)[:, :3] @ _joint_from(config, config.imu_frame, is_cabin=True).T
    assert config.base_imu is not None
    w = base.values[chosen][:, :3] @ _joint_from(config, config.frame_of(config.base_imu[0]), is_cabin=False).T
    cos, sin = np.cos(q), np.sin(q)
    felt = np.column_stack([cos * a[:, 0] - sin * a[:, 1], sin * a[:, 0] + cos * a[:, 1]])
    none = np.zeros_like(q)
    x = np.column_stack([-felt[:, 1], sin * a[:, 2], cos * a[:, 2], none, -w[:, 2], -cos, sin, none + 1.0, none])
    y = np.column_stack([felt[:, 0], -cos * a[:, 2], sin * a[:, 2], w[:, 2], none, -sin, -cos, none, none + 1.0])
    right = w[:, :2] - felt
    usable = _without_gaps(imu, joint, base, start_ns, times_s)
    kept = usable[: count * size].reshape(count, size).all(axis=1)
    if kept.sum() < MIN_BINS:
        return None

    def mean(values: Array) -> Array:
        averaged: Array = values[: count * size].reshape(count, size, -1).mean(axis=1)[kept]
        return averaged

    design = np.stack([mean(x), mean(y)], axis=1).reshape(-1, 9)
    return design, mean(right).ravel()


def _at(readings: Readings, start_ns: int, times_s: Array) -> Array:
    """Return readings (N, m) at times, linear between them."""
    known_s = (readings.times_ns - start_ns) * 1e-9
    return np.column_stack([np.interp(times_s, known_s, column) for column in readings.values.T])


def _without_gaps(imu: Readings, joint: Readings, base: Readings, start_ns: int, times_s: Array) -> NDArray[np.bool_]:
    """Return at which times (N,) all three measured."""
    usable: NDArray[np.bool_] = np.ones(len(times_s), dtype=np.bool_)
    for one in (imu, joint, base):
        known_s = (one.times_ns - start_ns) * 1e-9
        after = np.clip(np.searchsorted(known_s, times_s), 1, len(known_s) - 1)
        usable &= known_s[after] - known_s[after - 1] < GAP_S
    return usable


def _joint_from(config: Config, frame: str, *, is_cabin: bool) -> Array:
    """Return R (3, 3) from the axes of a frame to those of the joint, of the cabin while the encoder reads zero."""
    assert config.turn_joint is not None
    if not is_cabin:
        return config.T(config.turn_joint.parent, frame)[:3, :3]
    R: Array = config.turn_joint.matrix()[:3, :3] @ config.T(config.turn_joint.child, frame)[:3, :3]
    return R


def _solve(chunks: Sequence[tuple[Array, Array]], config: Config) -> tuple[Array, Array] | None:
    """Return constants (5,) [rad] and their sigmas by reweighted least squares, the biases of each chunk its own."""
    if not chunks:
        return None
    assert config.base_imu is not None and config.joint is not None
    bias = np.repeat([config.imu.gyroscope_bias_sigma, config.base_imu[1].gyroscope_bias_sigma], 2)
    tilt = radians(TILT_DEG)
    # the zero has a wide prior of its own: what the file believes must not hide what is measured
    prior = np.array([radians(10.0), tilt, tilt, tilt, tilt]) ** -2.0
    weights = [np.ones(len(right)) for _, right in chunks]
    solution: Array = np.zeros(CONSTANTS)
    biases = [np.zeros(4) for _ in chunks]
    for _ in range(ROUNDS):
        residuals = [
            right - design @ np.concatenate([solution, own])
            for (design, right), own in zip(chunks, biases, strict=True)
        ]
        scale = max(1.4826 * float(np.median(np.abs(np.concatenate(residuals)))), 1e-9)
        weights = [np.minimum(1.0, HUBER * scale / np.maximum(np.abs(one), 1e-12)) / scale**2 for one in residuals]
        information: Array = np.diag(prior)
        total = np.zeros(CONSTANTS)
        for (design, right), weight in zip(chunks, weights, strict=True):
            normal, side = _marginal(design, right, weight, bias)
            information, total = information + normal, total + side
        solution = np.asarray(np.linalg.solve(information, total), np.float64)
        biases = [
            _own(design, right, weight, bias, solution) for (design, right), weight in zip(chunks, weights, strict=True)
        ]
    covariance = _clustered(chunks, weights, bias, biases, solution, np.asarray(np.linalg.inv(information)))
    return solution, np.sqrt(covariance.diagonal())


def _marginal(design: Array, right: Array, weight: Array, bias: Array) -> tuple[Array, Array]:
    """Return information (5, 5) and right side (5,) of the constants, the biases taken out."""
    normal = design.T @ (design * weight[:, None])
    side = design.T @ (weight * right)
    inner = normal[CONSTANTS:, CONSTANTS:] + np.diag(bias**-2.0)
    gain = np.linalg.solve(inner, normal[CONSTANTS:, :CONSTANTS]).T
    return (
        normal[:CONSTANTS, :CONSTANTS] - gain @ normal[CONSTANTS:, :CONSTANTS],
        side[:CONSTANTS] - gain @ side[CONSTANTS:],
    )


def _own(design: Array, right: Array, weight: Array, bias: Array, solution: Array) -> Array:
    """Return the biases (4,) of a chunk, given the constants."""
    own = design[:, CONSTANTS:]
    normal = own.T @ (own * weight[:, None]) + np.diag(bias**-2.0)
    side = own.T @ (weight * (right - design[:, :CONSTANTS] @ solution))
    return np.asarray(np.linalg.solve(normal, side), np.float64)


def _clustered(  # noqa: PLR0917 (what was solved)
    chunks: Sequence[tuple[Array, Array]],
    weights: Sequence[Array],
    bias: Array,
    biases: Sequence[Array],
    solution: Array,
    covariance: Array,
) -> Array:
    """Return the covariance of the constants as the scatter of what clusters of rows say shows it (sandwich)."""
    size = 2 * max(1, round(CLUSTER_S / BIN_S))
    scores = []
    for (design, right), weight, own in zip(chunks, weights, biases, strict=True):
        residual = right - design @ np.concatenate([solution, own])
        normal = design.T @ (design * weight[:, None])
        inner = normal[CONSTANTS:, CONSTANTS:] + np.diag(bias**-2.0)
        gain = np.linalg.solve(inner, normal[CONSTANTS:, :CONSTANTS]).T
        rows = (design[:, :CONSTANTS] - design[:, CONSTANTS:] @ gain.T) * (weight * residual)[:, None]
        scores += [rows[k : k + size].sum(axis=0) for k in range(0, len(rows), size)]
    meat = np.array(scores).T @ np.array(scores)
    sandwich: Array = covariance @ meat @ covariance
    return np.maximum(sandwich, covariance * np.eye(CONSTANTS))
