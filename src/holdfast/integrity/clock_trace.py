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
    """The newest steps of an odometry beside the gyroscope: what is early turns too far while the rate grows.

    Attributes:
        may_be_late: whether another clock than is believed explains most of what the odometry has turned otherwise.
        stepped_s: by how much the stamps are early, as more steps than one have told; None where they have not.
    """

    def __init__(self) -> None:
        self._steps: deque[tuple[Array, Array]] = deque(maxlen=STEPS)
        self.may_be_late = False
        self.stepped_s: float | None = None

    def add(self, beyond: Array, change: Array, believed_s: float) -> None:
        """Take in a step.

        Args:
            beyond: (3,) by which the odometry has turned further than the gyroscope [rad].
            change: (3,) of the angular velocity over the step [rad/s].
            believed_s: by how much the stamps are believed to be early, by which the two were compared.
        """
        self._steps.append((beyond + believed_s * change, change))
        changes = np.array([one for _, one in self._steps])
        seen = np.array([one for one, _ in self._steps]) - believed_s * changes
        changed = float(np.vdot(changes, changes))
        further_s = float(np.vdot(seen, changes)) / changed if changed > 0.0 else 0.0
        self.may_be_late = abs(believed_s + further_s) < FARTHEST_S and _explains(further_s, seen, changes)
        others = np.arange(len(seen)) != np.argmax(np.linalg.norm(seen, axis=1))
        is_told = self.may_be_late and abs(further_s) >= NEAREST_S
        has_stepped = is_told and _explains(further_s, seen[others], changes[others])
        self.stepped_s = believed_s + further_s if has_stepped else None

    def clear(self) -> None:
        """Nothing before is to be compared with what comes."""
        self._steps.clear()
        self.may_be_late, self.stepped_s = False, None


def _explains(further_s: float, seen: Array, changes: Array) -> bool:
    """Whether a clock that is off by so much explains most of what is seen (N, 3), of changes of the rate (N, 3)."""
    left, squared = seen - further_s * changes, float(np.vdot(seen, seen))
    return squared > SEEN_RAD**2 and float(np.vdot(left, left)) < LEFT * squared
