"""Which pose of the estimate is compared with which pose of the reference."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf, isfinite
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import ConfigError, RecordingError
from holdfast.evaluation import quaternions
from holdfast.messages import Array
from holdfast.state import Trajectory

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])

MAX_OFFSET_S = 4e9  # more than the time since the epoch, and stamps stay within 64 bits


@dataclass(frozen=True, slots=True)
class Association:
    """How poses are paired.

    Attributes:
        method: `interpolate` takes the estimate at each stamp of the reference, linear in position and slerp in
            rotation, without extrapolation; `nearest` lets each pose of the shorter trajectory take the nearest pose
            of the longer one, as evo does.
        max_gap_s: `interpolate` does not bridge a longer gap between two poses of the estimate [s].
        max_difference_s: `nearest` pairs no stamps that are farther apart [s].
        reference_offset_s: is added to the stamps of the reference [s].
        reference_lever_arm: x, y, z of the point that the reference describes, in the estimate's body frame [m].
        position_only: the orientation of the reference is not to be used.
        names: of those of these numbers that the user can give, as he gives them, for errors.

    Raises:
        ConfigError: a number is not finite or beyond all times, or max_gap_s or max_difference_s is negative.
    """

    method: Literal["interpolate", "nearest"] = "interpolate"
    max_gap_s: float = 0.5
    max_difference_s: float = 0.01
    reference_offset_s: float = 0.0
    reference_lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    position_only: bool = False
    names: Mapping[str, str] = field(default_factory=dict, compare=False)

    def __post_init__(self) -> None:
        """Refuse numbers with which nothing can be paired."""
        for name, value in (("max_gap_s", self.max_gap_s), ("max_difference_s", self.max_difference_s)):
            if not 0.0 <= value < inf:
                raise ConfigError(f"{self._named(name)} {value:g}: must be >= 0 and finite")
        if not abs(self.reference_offset_s) <= MAX_OFFSET_S:
            raise ConfigError(
                f"{self._named('reference_offset_s')} {self.reference_offset_s:g}: "
                f"must be finite and within +-{MAX_OFFSET_S:g}"
            )
        if not all(map(isfinite, self.reference_lever_arm)):
            arm = " ".join(f"{value:g}" for value in self.reference_lever_arm)
            raise ConfigError(f"{self._named('reference_lever_arm')} {arm}: must be finite")

    def _named(self, name: str) -> str:
        return self.names.get(name, name)

    def remedy(self, name: str, what: str) -> str:
        """Return that a number does something, with `; ` before it; nothing where the user cannot give it."""
        return f"; {self.names[name]} {what}" if name in self.names else ""


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Poses of the estimate and of the reference at the same stamps, of the same point of the body.

    Attributes:
        oriented: both have an orientation; where False, the quaternions mean nothing.
        reference_start_ns: first stamp of the whole reference, from which intervals count.
    """

    estimate: Trajectory
    reference: Trajectory
    oriented: bool
    reference_start_ns: int

    def between(self, start_s: float, end_s: float) -> Self:
        """Return the pairs from start to before end, in seconds since the reference's first stamp."""
        since_start_s = self.since_start_s()
        inside = np.flatnonzero((since_start_s >= start_s) & (since_start_s < end_s))
        return replace(self, estimate=_take(self.estimate, inside), reference=_take(self.reference, inside))

    def since_start_s(self) -> Array:
        """Return the stamps (N,) in seconds since the reference's first stamp."""
        since: Array = (self.reference.stamps_ns - self.reference_start_ns) * np.float64(1e-9)
        return since

    def driven_m(self) -> Array:
        """Return the distance (N,) that the reference has driven from the first pair to each pair [m]."""
        steps = np.linalg.norm(np.diff(self.reference.positions, axis=0), axis=1)
        return np.concatenate([np.zeros(min(1, len(self))), np.cumsum(steps)])

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self.reference.stamps_ns)


def associate(estimate: Trajectory, reference: Trajectory, options: Association | None = None) -> Pairs:
    """Pair the estimate with the reference.

    Raises:
        RecordingError: a trajectory has fewer than two poses, stamps that do not increase or values that are not
            finite; or the two do not overlap in time, or fewer than two poses find a partner.
        ConfigError: there is a lever arm but no orientation of the estimate to rotate it by.
    """
    options = options or Association()
    check_trajectory(estimate, "estimate")
    check_trajectory(reference, "reference")
    reference = replace(reference, stamps_ns=reference.stamps_ns + round(options.reference_offset_s * 1e9))
    _check_overlap(estimate, reference, options)
    turned = has_orientation(estimate)
    oriented = turned and not options.position_only and has_orientation(reference)
    estimate, start_ns = _normalised(estimate), int(reference.stamps_ns[0])
    reference = _normalised(reference)
    pair = _interpolate if options.method == "interpolate" else _nearest
    estimate, reference = pair(estimate, reference, options)
    if len(reference.stamps_ns) < 2:
        raise RecordingError(f"{len(reference.stamps_ns)} poses of the reference find a partner; {_remedy(options)}")
    if any(options.reference_lever_arm):
        if not turned:
            raise ConfigError("a lever arm needs an estimate with orientation; this one has positions only")
        estimate = _move(estimate, np.array(options.reference_lever_arm))
    return Pairs(estimate, reference, oriented, start_ns)


def check_trajectory(trajectory: Trajectory, name: str) -> None:
    """Refuse a trajectory that cannot be judged; `name` is its name in the error.

    Raises:
        RecordingError: fewer than two poses, stamps that do not increase, or values that are not finite.
    """
    stamps = trajectory.stamps_ns
    if len(stamps) < 2:
        raise RecordingError(f"the {name} has {len(stamps)} pose{'s' * (len(stamps) != 1)}, at least 2 are needed")
    backward = np.flatnonzero(np.diff(stamps) <= 0)
    if len(backward):
        index = int(backward[0])
        raise RecordingError(
            f"the stamps of the {name} do not increase: pose {index + 2} at {stamps[index + 1] * 1e-9:.9f} s "
            f"follows {stamps[index] * 1e-9:.9f} s"
        )
    finite = np.isfinite(trajectory.positions).all(axis=1) & np.isfinite(trajectory.quaternions).all(axis=1)
    if not finite.all():
        index = int(np.flatnonzero(~finite)[0])
        raise RecordingError(f"the {name} is not finite in pose {index + 1} at {stamps[index] * 1e-9:.9f} s")


def has_orientation(trajectory: Trajectory) -> bool:
    """Return False for trajectories that carry positions only: every quaternion identity, or any of them zero."""
    norms = np.linalg.norm(trajectory.quaternions, axis=1)
    return bool((norms > 0.5).all() and (trajectory.quaternions != IDENTITY).any())


def _check_overlap(estimate: Trajectory, reference: Trajectory, options: Association) -> None:
    (e0, e1), (r0, r1) = ((int(t.stamps_ns[0]), int(t.stamps_ns[-1])) for t in (estimate, reference))
    if e1 < r0 or r1 < e0:
        raise RecordingError(
            f"no overlap in time: the estimate spans {e0 * 1e-9:.3f} to {e1 * 1e-9:.3f} s, "
            f"the reference {r0 * 1e-9:.3f} to {r1 * 1e-9:.3f} s"
            f"{options.remedy('reference_offset_s', 'shifts the reference')}"
        )


def _remedy(options: Association) -> str:
    if options.method == "nearest":
        remedy = options.remedy("max_difference_s", "allows more")
        return f"stamps may differ by {options.max_difference_s} s{remedy}"
    return f"gaps of the estimate are bridged up to {options.max_gap_s} s{options.remedy('max_gap_s', 'allows more')}"


def _normalised(trajectory: Trajectory) -> Trajectory:
    norms = np.linalg.norm(trajectory.quaternions, axis=1, keepdims=True)
    unit = np.divide(trajectory.quaternions, norms, out=np.tile(IDENTITY, (len(norms), 1)), where=norms > 0.5)
    return replace(trajectory, quaternions=unit)


def _take(trajectory: Trajectory, index: NDArray[np.intp]) -> Trajectory:
    return Trajectory(trajectory.stamps_ns[index], trajectory.positions[index], trajectory.quaternions[index])


def _interpolate(estimate: Trajectory, reference: Trajectory, options: Association) -> tuple[Trajectory, Trajectory]:
    stamps, wanted = estimate.stamps_ns, reference.stamps_ns
    before = np.clip(np.searchsorted(stamps, wanted, side="right") - 1, 0, len(stamps) - 2)
    gap = stamps[before + 1] - stamps[before]
    since = wanted - stamps[before]
    exact = (since == 0) | (since == gap)
    usable = exact | ((since > 0) & (since < gap) & (gap <= options.max_gap_s * 1e9))
    before, fraction = before[usable], since[usable] / gap[usable]
    start, end = _take(estimate, before), _take(estimate, before + 1)
    positions = start.positions + fraction[:, None] * (end.positions - start.positions)
    rotations = quaternions.slerp(start.quaternions, end.quaternions, fraction)
    return Trajectory(wanted[usable], positions, rotations), _take(reference, np.flatnonzero(usable))


def _nearest(estimate: Trajectory, reference: Trajectory, options: Association) -> tuple[Trajectory, Trajectory]:
    if len(reference.stamps_ns) < len(estimate.stamps_ns):
        short, long = _nearest_index(reference.stamps_ns, estimate.stamps_ns, options.max_difference_s)
        found = _take(estimate, long), _take(reference, short)
    else:
        short, long = _nearest_index(estimate.stamps_ns, reference.stamps_ns, options.max_difference_s)
        found = _take(estimate, short), _take(reference, long)
    stamps = found[1].stamps_ns if len(reference.stamps_ns) < len(estimate.stamps_ns) else found[0].stamps_ns
    return replace(found[0], stamps_ns=stamps), replace(found[1], stamps_ns=stamps)


def _nearest_index(
    short: NDArray[np.int64], long: NDArray[np.int64], max_difference_s: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices of the short stamps that find a partner, and of their partners; the earlier wins a draw."""
    after = np.clip(np.searchsorted(long, short, side="right"), 1, len(long) - 1)
    partner = np.where(long[after] - short < short - long[after - 1], after, after - 1)
    close = np.flatnonzero(np.abs(long[partner] - short) <= max_difference_s * 1e9)
    return close, partner[close]


def _move(trajectory: Trajectory, lever_arm: Array) -> Trajectory:
    """Describe another point of the body: p + R * lever_arm."""
    moved = trajectory.positions + quaternions.rotate(trajectory.quaternions, lever_arm)
    return replace(trajectory, positions=moved)
