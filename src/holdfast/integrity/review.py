"""The positions that were used, while the main graph holds them: what is to be taken out again once more is known."""

from math import inf

import numpy as np

from holdfast.graph.sensor_parameters import believed_parameters
from holdfast.graph.smoother import Smoother
from holdfast.measured_fields import NEVER_NS
from holdfast.messages import Array
from holdfast.sensors.clock import receiver_constants
from holdfast.sensors.position import Motion, predicted_position
from holdfast.sensors.sensor import Position, PositionSensor


class UsedPositions:
    """The positions in the window of the main graph, in the order in which they entered.

    Args:
        sensors: their models, by name.
    """

    def __init__(self, sensors: dict[str, PositionSensor]) -> None:
        self._sensors = sensors
        self._used: list[Position] = []

    def __len__(self) -> int:
        return len(self._used)

    @property
    def newest_ns(self) -> int:
        """Stamp of the one that entered last; there must be one."""
        return self._used[-1].stamp_ns

    def add(self, position: Position) -> None:
        """Note that a position entered the main graph."""
        self._used.append(position)

    def extend(self, positions: list[Position]) -> None:
        """Note that positions entered the main graph."""
        self._used.extend(positions)

    def remove(self, position: Position) -> None:
        """Forget a position that was taken out."""
        self._used.remove(position)

    def forget_before(self, oldest_ns: int) -> None:
        """Forget what left the window."""
        self._used = [one for one in self._used if one.stamp_ns >= oldest_ns]  # they are in the order of arrival

    def of(self, sensor: str | None = None, since_ns: int = NEVER_NS) -> list[Position]:
        """Return the positions of a receiver, or of all, since a time."""
        return [one for one in self._used if sensor in (None, one.sensor) and one.stamp_ns >= since_ns]

    def since_last_s(self, position: Position) -> float:
        """Return the time since a used position of the same receiver [s], infinite if the window holds none."""
        before = next((one.stamp_ns for one in reversed(self._used) if one.sensor == position.sensor), None)
        return inf if before is None else abs(position.stamp_ns - before) * 1e-9

    def worst(self, smoother: Smoother, quarantine_ns: dict[str, int]) -> Position | None:
        """Return the position that later ones contradict most, if that is beyond its gate: (21) in docs/math.md.

        A position that looked plausible when it came may stand alone once its successors are in.

        Args:
            smoother: the main one, just optimised.
            quarantine_ns: for how long a used position of each receiver can be taken out again.
        """
        # the newest has no successor yet, and may be what pulls at the others
        older = self._used[:-1]
        doubted = [one for one in older if self.newest_ns - one.stamp_ns <= quarantine_ns[one.sensor]]
        if not doubted:
            return None
        nis = self._residual_nis(doubted, smoother)
        k = int(nis.argmax())
        return doubted[k] if nis[k] > self._sensors[doubted[k].sensor].limit else None

    def median_nis(self, positions: list[Position], smoother: Smoother) -> float:
        """Return the median of the squared residuals of positions over their covariance, infinite if there are none."""
        return float(np.median(self._residual_nis(positions, smoother))) if positions else inf

    def _residual_nis(self, positions: list[Position], smoother: Smoother) -> Array:
        """Return the squared residuals (N,) of positions at the optimised states over their covariance."""
        names = {one.sensor for one in positions}
        sensors = {name: self._sensors[name] for name in names}
        constants = {n: receiver_constants(one, believed_parameters(smoother, one)) for n, one in sensors.items()}
        rows = {stamp: row for row, stamp in enumerate({one.stamp_ns for one in positions})}
        motions = [Motion.of(smoother.nav(stamp), smoother.angular_velocity(stamp)) for stamp in rows]
        index = [rows[one.stamp_ns] for one in positions]
        motion = Motion(*(np.array(part)[index] for part in zip(*motions, strict=True)))
        arms, offsets_s = (np.array(part) for part in zip(*(constants[one.sensor] for one in positions), strict=True))
        y: Array = np.array([one.p_W_P for one in positions]) - predicted_position(motion, arms, offsets_s)
        weighted = np.linalg.solve(np.array([one.covariance for one in positions]), y[:, :, None])[:, :, 0]
        squared: Array = (y * weighted).sum(axis=1)
        return squared
