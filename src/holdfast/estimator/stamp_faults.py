"""Stamps with which no start is possible: they stand still, or lie far from those of the IMU."""

from collections.abc import Collection
from dataclasses import dataclass

from holdfast.sensors.stamp_filter import FUTURE_NS

IN_A_ROW = 10
FAR_NS = 60_000_000_000  # an age that no transport explains; the future needs no explanation
MANY_S = 60.0  # of which a tenth does not matter


@dataclass(slots=True)
class _Seen:
    """The newest stamp of a sensor [ns], and of how many in a row it is true that they stand, or are far."""

    stamp_ns: int
    stand: int = 0
    behind_ns: int = 0
    far: int = 0


class StampFaults:
    """What the stamps of the sensors beside the IMU show before a start."""

    def __init__(self) -> None:
        self._seen: dict[str, _Seen] = {}

    def note(self, sensor: str, stamp_ns: int, behind_ns: int | None) -> None:
        """Take in a stamp as it arrives.

        Args:
            sensor: whose it is.
            stamp_ns: it.
            behind_ns: by how much it is behind the IMU's clock at its arrival; None where that is not known.
        """
        seen = self._seen.get(sensor)
        if seen is None:
            seen = self._seen[sensor] = _Seen(stamp_ns, -1)
        seen.stand = seen.stand + 1 if stamp_ns == seen.stamp_ns else 0
        seen.stamp_ns = stamp_ns
        if behind_ns is not None:
            seen.far = seen.far + 1 if behind_ns > FAR_NS or behind_ns < -FUTURE_NS else 0
            seen.behind_ns = behind_ns

    def why_not(self, needed: Collection[str]) -> str:
        """Return what is wrong with the stamps of all sensors of which one is needed; empty if nothing is."""
        if not needed or not self._seen.keys() & needed:
            return ""
        stand = [name for name, seen in self._seen.items() if seen.stand >= IN_A_ROW]
        far = [name for name, seen in self._seen.items() if seen.far >= IN_A_ROW and name not in stand]
        if any(name in self._seen and name not in stand + far for name in needed):
            return ""
        if set(stand) & set(needed):
            at_s = self._seen[next(name for name in stand if name in needed)].stamp_ns * 1e-9
            return f"the stamps of {', '.join(stand)} do not advance: they stand at {at_s:.3f} s while messages arrive"
        behind_ns = self._seen[next(name for name in far if name in needed)].behind_ns
        apart = _in_words(abs(behind_ns) * 1e-9)
        if len(far) + len(stand) == len(self._seen):  # no sensor agrees with the IMU
            way = "ahead of" if behind_ns > 0 else "behind"
            return f"the stamps of the IMU are {apart} {way} those of {', '.join(far)}"
        return f"the stamps of {', '.join(far)} are {apart} {'behind' if behind_ns > 0 else 'ahead of'} the IMU's"


def _in_words(apart_s: float) -> str:
    """Return how far clocks are apart; what is a few seconds, such as leap seconds, is a matter of configuration."""
    return f"{apart_s:.0f} s" if apart_s > MANY_S else f"{apart_s:.1f} s (`time_offset_s` sets them right)"
