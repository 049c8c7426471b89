"""Noise and drift of odometries, against a track that knows nothing of them.

A motion on the track of an odometry over some time differs from the true one by the noise of two poses and the drift
between them. The truth is told by GNSS and IMU alone: attitude by the gyroscope, without its bias, position by the
nodes of a run without odometries, where GNSS was trusted. What those do not know is added to the variance of each
difference. The factors k on what is configured have a posterior on a grid: (57) in docs/math.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import log

import gtsam
import numpy as np
from numpy.typing import NDArray

from holdfast.calibration.estimated import Estimated, Family, Found
from holdfast.calibration.evidence import Evidence
from holdfast.config.edit import Change
from holdfast.config.model import Config
from holdfast.config.sensors import DriftingConfig
from holdfast.messages import Array
from holdfast.sensors.odometry import TrackPose

GRID = np.geomspace(0.03, 30.0, 121)  # factors on what is configured
PRIOR = log(3.0)  # sigma of the logarithm of a factor
SEEN, CHANGED = 0.35, log(1.25)  # sigma of a logarithm below which a factor is observed; a smaller change stays
SPANS_S = (5.0, 10.0, 20.0)
MAX_STEP_S = 1.0  # between poses that follow each other
FEW = 10  # differences, below which nothing is said
SAME_MOTION_M = 5e-4  # sigma of the change from one step to the next, as the nodes have it
MAX_RATIO = 4.0  # sigmas, beyond which one difference tells no more
AFTER = 0.5  # of the variance of the newest state is left once it has seen what follows
GYROSCOPE_RATIO = 1e-3  # error in proportion to the rotation: scale and axes
KEYS = {
    "translation_sigma_m": ("noise", 1, "m"),
    "rotation_sigma_rad": ("noise", 0, "rad"),
    "drift_m_per_sqrt_m": ("distance", 1, "m/sqrt(m)"),
    "drift_rad_per_sqrt_m": ("distance", 0, "rad/sqrt(m)"),
    "drift_rad_per_sqrt_rad": ("rotation", 0, "sqrt(rad)"),
}
ROTATION, TRANSLATION = 0, 1


@dataclass(frozen=True, slots=True, eq=False)
class Differences:
    """Differences of motions, (N, 3) of a kind, between poses that are a span of time apart.

    Attributes:
        noise: (N,) variance that the configured noise of two poses makes, per axis.
        distance: (N,) that of the configured drift over the distance.
        rotation: (N,) that of the configured drift over the rotation.
        known: (N,) that of what is compared with.
        weight: by which each counts, as motions overlap.
    """

    values: Array
    noise: Array
    distance: Array
    rotation: Array
    known: Array
    weight: float


def odometry_noise(evidence: Sequence[Evidence], original: Config) -> Found:
    """Return noise and drift of each odometry, translation and rotation apart.

    Args:
        evidence: of runs without odometries; their tracks were read all the same.
        original: the configuration, whose numbers are scaled.
    """
    estimates: list[Estimated] = []
    changes: list[Change] = []
    for name, section in original.sensors_of(DriftingConfig).items():
        for kind in (ROTATION, TRANSLATION):
            found = [one for run in evidence for one in _differences(run, name, section, kind)]
            posterior = _posterior(found)
            for key, (part, of, unit) in KEYS.items():
                if of == kind:
                    row = _row(name, key, unit, float(getattr(section, key)), posterior.get(part))
                    estimates.append(row)
                    if row.is_written:
                        changes.append(Change(row.path, float(f"{row.after:.3g}")))
    return Found(estimates, changes)


def _row(name: str, key: str, unit: str, before: float, factor: tuple[float, float] | None) -> Estimated:
    path = "sensors", name, key
    if factor is None or before == 0.0:
        row = Estimated(Family.ODOMETRY_NOISE, path, name, unit, before, before, before * PRIOR, before * PRIOR)
        return row.kept("not observable: too little motion with trusted GNSS")
    mean, sigma = factor
    after = before * float(np.exp(mean))
    row = Estimated(Family.ODOMETRY_NOISE, path, name, unit, before, after, after * sigma, before * PRIOR)
    if sigma > SEEN:
        return row.kept(f"not observable: a factor of {np.exp(mean):.2g}, known to a factor of {np.exp(sigma):.2g}")
    if abs(mean) < max(CHANGED, 2.0 * sigma):
        return row.kept("as configured")
    return row


def _posterior(found: Sequence[Differences]) -> dict[str, tuple[float, float]]:
    """Return mean and sigma of the logarithms of the factors on noise and drifts, from their posteriors (57).

    First that of the noise, with one factor on both drifts; then those of the two drifts, with the noise as it is.
    """
    if not found:
        return {}
    together = [(one.noise, one.distance + one.rotation, one.known) for one in found]
    noise, _ = _marginals(found, together)
    square = float(np.exp(2.0 * noise[0]))
    apart = [(one.distance, one.rotation, one.known + square * one.noise) for one in found]
    distance, rotation = _marginals(found, apart)
    return {"noise": noise, "distance": distance, "rotation": rotation}


def _marginals(
    found: Sequence[Differences], variances: Sequence[tuple[Array, Array, Array]]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the moments of the factors on the first two of three variances (N,), the third being known."""
    logs = np.log(GRID)
    prior = -0.5 * (logs / PRIOR) ** 2
    density = prior[:, None] + prior[None, :]
    for one, (first, second, known) in zip(found, variances, strict=True):
        squares = (one.values**2).sum(axis=1)
        for i, factor in enumerate(GRID.tolist()):
            variance: Array = factor**2 * first + GRID[:, None] ** 2 * second + known
            ratio = np.minimum(squares / variance, 3.0 * MAX_RATIO**2)
            density[i] -= 0.5 * one.weight * (ratio + 3.0 * np.log(variance)).sum(axis=1)
    weights = np.exp(density - density.max())
    weights /= weights.sum()
    return _moments(logs, weights.sum(axis=1)), _moments(logs, weights.sum(axis=0))


def _moments(values: Array, weights: Array) -> tuple[float, float]:
    mean = float(values @ weights)
    step = float(values[1] - values[0])
    variance = float((values - mean) ** 2 @ weights)
    return mean, max(variance, step**2 / 4.0) ** 0.5


def _differences(run: Evidence, name: str, section: DriftingConfig, kind: int) -> list[Differences]:
    """Return differences between successive poses, and over spans."""
    track = run.tracks.get(name, [])
    if len(track) < 3 or len(run.nodes.times_ns) < 2:  # shorter than the window: nothing has left it
        return []
    against = _rotations(run, track) if kind == ROTATION else _positions(run, track)
    spans = [_over(against, section, kind, span_s) for span_s in SPANS_S]
    return [one for one in (_successive(against, section, kind), *spans) if one is not None]


@dataclass(frozen=True, slots=True, eq=False)
class _Steps:
    """Steps of a track, of which each is compared with the truth.

    Attributes:
        usable: (N - 1,) whether what it is compared with is known.
        difference: (N - 1, 3) of the step, in axes that do not turn.
        distance: (N - 1,) [m] and
        rotation: (N - 1,) [rad] that the machine moved.
        at: (N,) variance of where each end is.
        rate: (N,) variance that grows with the square of time.
        white: (N - 1,) variance that each step adds.
    """

    times_s: Array
    usable: NDArray[np.bool_]
    difference: Array
    distance: Array
    rotation: Array
    at: Array
    rate: Array
    white: Array


def _variances(section: DriftingConfig, kind: int, distance: Array, rotation: Array) -> tuple[float, Array, Array]:
    """Return the variances that are configured: of the noise of a motion, of its drifts by distance and by rotation."""
    if kind == ROTATION:
        by_distance = section.drift_rad_per_sqrt_m**2 * distance
        return section.rotation_sigma_rad**2, by_distance, section.drift_rad_per_sqrt_rad**2 * rotation
    return section.translation_sigma_m**2, section.drift_m_per_sqrt_m**2 * distance, np.zeros(len(rotation))


def _successive(against: _Steps, section: DriftingConfig, kind: int) -> Differences | None:
    """Return how much successive steps differ from each other: three poses, and no error that is alike in both."""
    both = against.usable[1:] & against.usable[:-1]
    if both.sum() < FEW:
        return None

    def of_both(steps: Array) -> Array:
        total: Array = (steps[1:] + steps[:-1])[both]
        return total

    values = (against.difference[1:] - against.difference[:-1])[both]
    noise, *drifts = _variances(section, kind, of_both(against.distance), of_both(against.rotation))
    known = of_both(against.white) + SAME_MOTION_M**2 * (kind == TRANSLATION)
    return Differences(values, np.full(len(values), 3.0 * noise), drifts[0], drifts[1], known, 0.5)


def _over(against: _Steps, section: DriftingConfig, kind: int, span_s: float) -> Differences | None:
    """Return the differences over a span."""
    times = against.times_s
    first = np.arange(len(times) - 1)
    last = np.searchsorted(times, times[:-1] + span_s)
    inside = last < len(times)
    first, last = first[inside], last[inside]
    broken = np.concatenate([[0], np.cumsum(~against.usable)])
    whole = broken[last] == broken[first]
    first, last = first[whole], last[whole]
    if len(first) < FEW:
        return None

    def between(steps: Array) -> Array:
        sums = np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])
        total: Array = sums[last] - sums[first]
        return total

    noise, *drifts = _variances(section, kind, between(against.distance), between(against.rotation))
    seconds = times[last] - times[first]
    known = against.at[first] + against.at[last] + against.rate[first] * seconds**2 + between(against.white)
    overlap = float(np.median(last - first)) * len(SPANS_S)
    noises = np.full(len(first), noise)
    return Differences(between(against.difference), noises, drifts[0], drifts[1], known, 1.0 / overlap)


def _rotations(run: Evidence, track: Sequence[TrackPose]) -> _Steps:
    """Compare the rotation of each step with that of the gyroscope without its bias."""
    imu = run.readings[run.config.imu_name]
    times_ns = np.array([pose.stamp_ns for pose in track])
    bias_rows = np.clip(
        np.searchsorted(run.states.times_ns, times_ns + 20_000_000_000), 0, len(run.states.times_ns) - 1
    )
    steps = [
        _rotated(imu.times_ns, imu.values[:, :3], one.stamp_ns, other.stamp_ns, run.states.gyroscope_bias[row])
        for (one, other), row in zip(pairwise(track), bias_rows.tolist(), strict=False)
    ]
    attitude, differences = gtsam.Rot3(), []
    for (one, other), by_gyroscope in zip(pairwise(track), steps, strict=True):
        by_odometry = one.T_I0_I.rotation().between(other.T_I0_I.rotation())
        if by_gyroscope is None:
            differences.append(np.zeros(3))
            continue
        off = gtsam.Rot3.Logmap(by_gyroscope.between(by_odometry))
        attitude = attitude.compose(by_gyroscope)
        differences.append(attitude.rotate(off))  # in axes that do not turn
    rotated = np.array([0.0 if one is None else float(np.linalg.norm(gtsam.Rot3.Logmap(one))) for one in steps])
    usable = np.array([one is not None for one in steps])
    moved = np.array([_distance(one, other) for one, other in pairwise(track)])
    seconds = np.diff(times_ns) * 1e-9
    usable &= (seconds <= MAX_STEP_S) & _sound(track)
    density = run.config.imu.gyroscope_noise_density
    white = density**2 * seconds + (GYROSCOPE_RATIO * rotated) ** 2
    rate = run.states.sigmas[bias_rows, 2] ** 2
    nothing = np.zeros(len(track))
    return _Steps(times_ns * 1e-9, usable, np.array(differences), moved, rotated, nothing, rate, white)


def _rotated(times_ns: NDArray[np.int64], rates: Array, begin_ns: int, end_ns: int, bias: Array) -> gtsam.Rot3 | None:
    """Return the rotation that the gyroscope measured between two times, None if it did not all along."""
    i, j = np.searchsorted(times_ns, [begin_ns, end_ns])
    if i < 1 or j >= len(times_ns) or (np.diff(times_ns[i - 1 : j + 1]) > 50_000_000).any():
        return None
    edges = np.concatenate([[begin_ns], times_ns[i:j], [end_ns]])
    R = gtsam.Rot3()
    # a reading is the mean over the period before it
    for seconds, rate in zip(np.diff(edges) * 1e-9, rates[i : j + 1], strict=True):
        R = R.compose(gtsam.Rot3.Expmap((rate - bias) * seconds))
    return R


def _positions(run: Evidence, track: Sequence[TrackPose]) -> _Steps:
    """Compare the translation of each step, turned by the attitude of the nodes, with the motion of the nodes."""
    nodes, states = run.nodes, run.states
    times_ns = np.array([pose.stamp_ns for pose in track])
    after = np.clip(np.searchsorted(nodes.times_ns, times_ns), 1, len(nodes.times_ns) - 1)
    before = after - 1
    span = (nodes.times_ns[after] - nodes.times_ns[before]) * 1e-9
    share = np.clip((times_ns - nodes.times_ns[before]) * 1e-9 / np.maximum(span, 1e-9), 0.0, 1.0)
    positions = nodes.positions[before] + share[:, None] * (nodes.positions[after] - nodes.positions[before])
    rotations = np.array(
        [
            gtsam.Rot3(nodes.rotations[i]).slerp(s, gtsam.Rot3(nodes.rotations[j])).matrix()
            for i, j, s in zip(before, after, share, strict=True)
        ]
    ).reshape(-1, 3, 3)
    motions = [one.T_I0_I.between(other.T_I0_I) for one, other in pairwise(track)]
    moved = np.array([motion.translation() for motion in motions])
    seen = np.diff(positions, axis=0)
    difference = np.einsum("nij,nj->ni", rotations[:-1], moved) - seen
    rows = np.clip(np.searchsorted(states.times_ns, times_ns), 0, len(states.times_ns) - 1)
    is_known = (span < 0.6) & ~states.is_lost[rows] & (states.sigmas[rows, 1] < 0.05)
    inside = (times_ns >= nodes.times_ns[0]) & (times_ns <= nodes.times_ns[-1])
    seconds = np.diff(times_ns) * 1e-9
    usable = (is_known & inside)[:-1] & (is_known & inside)[1:] & (seconds <= MAX_STEP_S) & _sound(track)
    distance = np.linalg.norm(seen, axis=1)
    at = AFTER * states.sigmas[rows, 1] ** 2
    speed = distance / np.maximum(seconds, 1e-9)
    rate = (states.sigmas[rows[:-1], 0] * speed) ** 2  # an attitude that is off turns the motion
    turned = np.array([float(np.linalg.norm(gtsam.Rot3.Logmap(motion.rotation()))) for motion in motions])
    return _Steps(
        times_ns * 1e-9,
        usable,
        difference,
        distance,
        turned,
        at,
        np.append(rate, 0.0),
        np.zeros(len(motions)),
    )


def _sound(track: Sequence[TrackPose]) -> NDArray[np.bool_]:
    """Return which steps (N - 1,) the odometry itself does not say to be worse than usual."""
    return np.array([pose.excess is None for pose in track[1:]], dtype=np.bool_)


def _distance(one: TrackPose, other: TrackPose) -> float:
    return float(np.linalg.norm(other.T_I0_I.translation() - one.T_I0_I.translation()))
