"""Whether an odometry turns otherwise than the gyroscope because its clock has stepped: (92) in docs/math.md."""

from collections import deque
from math import radians

import numpy as np

from holdfast.messages import Array

STEPS = 5  # over which it is asked
FARTHEST_S = 0.5  # that a clock is believed to step
NEAREST_S = 0.02  # less is left to the graph
LEFT = 0.25  # of the squares, of what a clock explains
SEEN_RAD = radians(1.0)  # in all, of what a clock explains


class ClockTrace:
    """The newest steps of an odometry beside the gyroscope: what is early turns too far while the rate grows."""

    def __init__(self) -> None:
        self._steps: deque[tuple[Array, Array]] = deque(maxlen=STEPS)
        self._believed_s = 0.0

    def add(self, beyond: Array, change: Array, believed_s: float) -> None:
        """Take in a step.

        Args:
            beyond: (3,) by which the odometry has turned further than the gyroscope [rad].
            change: (3,) of the angular velocity over the step [rad/s].
            believed_s: by how much the stamps are believed to be early, by which the two were compared.
        """
        self._steps.append((beyond + believed_s * change, change))
        self._believed_s = believed_s

    def clear(self) -> None:
        """Nothing before is to be compared with what comes."""
        self._steps.clear()

    def may_be_late(self) -> bool:
        """Whether another clock than is believed explains most of what the odometry has turned otherwise."""
        return self._fitted_s() is not None

    def stepped_s(self) -> float | None:
        """Return by how much the stamps are early, as more steps than one have told; None where they have not."""
        early_s = self._fitted_s()
        if early_s is None or abs(early_s - self._believed_s) < NEAREST_S:
            return None
        beyond, change = self._all()
        others = np.arange(len(beyond)) != np.argmax(np.linalg.norm(beyond - self._believed_s * change, axis=1))
        return early_s if self._is_explained(beyond[others], change[others], early_s) else None

    def _all(self) -> tuple[Array, Array]:
        beyond, change = (np.array(part).reshape(-1, 3) for part in zip(*self._steps, strict=True))
        return beyond, change

    def _fitted_s(self) -> float | None:
        """Return by how much the stamps are early if that explains most of what is there; None if it does not."""
        if not self._steps:
            return None
        beyond, change = self._all()
        changed = float(np.vdot(change, change))
        if changed == 0.0:
            return None
        early_s = float(np.vdot(beyond, change)) / changed
        return early_s if abs(early_s) < FARTHEST_S and self._is_explained(beyond, change, early_s) else None

    def _is_explained(self, beyond: Array, change: Array, early_s: float) -> bool:
        left, seen = (beyond - clock_s * change for clock_s in (early_s, self._believed_s))
        squared = float(np.vdot(seen, seen))
        return squared > SEEN_RAD**2 and float(np.vdot(left, left)) < LEFT * squared
