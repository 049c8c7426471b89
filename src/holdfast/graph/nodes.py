"""The nodes of the sliding window in the order of time, and the links of motion between neighbours.

Nodes lie on a grid of 0.1 ms: a measurement is attached to the node nearest to its exact time, at most 0.05 ms away,
and which nodes exist does not depend on the order in which measurements arrive.
"""

from bisect import bisect_left, bisect_right
from dataclasses import dataclass

import gtsam

from holdfast.graph.solver import Placed
from holdfast.sensors.imu import Turning

NODE_RESOLUTION_NS = 100_000
NODE, FRAME, BIAS = "x", "l", "b"  # letters of the keys of nodes, of frames of odometries, and of biases


def to_grid(stamp_ns: int) -> int:
    """Return the node time nearest to a stamp [ns]."""
    return (stamp_ns + NODE_RESOLUTION_NS // 2) // NODE_RESOLUTION_NS * NODE_RESOLUTION_NS


@dataclass(slots=True)
class Link:
    """The motion between two neighbouring nodes: an IMU factor, or a motion model where the IMU was silent."""

    start_ns: int
    end_ns: int
    bias_key: int
    is_gap: bool
    placed: Placed
    turning: Turning

    @property
    def keys(self) -> tuple[int, int]:
        """The keys of its two nodes."""
        start, end, _ = self.placed.factor.keys()
        return start, end


class Timeline:
    """Node stamps and keys, sorted by time."""

    def __init__(self) -> None:
        self.stamps: list[int] = []
        self._keys: list[int] = []
        self._made = 0

    def __len__(self) -> int:
        return len(self.stamps)

    def copy(self) -> "Timeline":
        """Return an equal one that goes its own way."""
        other = Timeline()
        other.stamps, other._keys, other._made = list(self.stamps), list(self._keys), self._made
        return other

    def __contains__(self, stamp_ns: int) -> bool:
        k = bisect_left(self.stamps, stamp_ns)
        return k < len(self.stamps) and self.stamps[k] == stamp_ns

    def key(self, stamp_ns: int) -> int:
        """Return the key of the node at exactly this time, which must exist."""
        return self._keys[bisect_left(self.stamps, stamp_ns)]

    def insert(self, stamp_ns: int) -> int:
        """Make a node and return its key."""
        k = bisect_left(self.stamps, stamp_ns)
        key: int = gtsam.symbol(NODE, self._made)
        self._made += 1
        self.stamps.insert(k, stamp_ns)
        self._keys.insert(k, key)
        return key

    def before(self, stamp_ns: int) -> int:
        """Return the stamp of the last node before a time that lies inside the window."""
        return self.stamps[bisect_left(self.stamps, stamp_ns) - 1]

    def forget_before(self, stamp_ns: int) -> list[int]:
        """Drop the nodes before a time and return their stamps."""
        k = bisect_left(self.stamps, stamp_ns)
        dropped = self.stamps[:k]
        del self.stamps[:k], self._keys[:k]
        return dropped

    def until(self, stamp_ns: int) -> list[int]:
        """Return the stamps of the nodes at or before a time."""
        return self.stamps[: bisect_right(self.stamps, stamp_ns)]

    def at_or_before(self, stamp_ns: int) -> int | None:
        """Return the stamp of the last node at or before a time, or None if the window starts later."""
        k = bisect_right(self.stamps, stamp_ns)
        return self.stamps[k - 1] if k else None
