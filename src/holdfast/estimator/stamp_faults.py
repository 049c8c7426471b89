"""Stamps with which no start is possible: they stand still."""

from collections.abc import Collection
from dataclasses import dataclass

IN_A_ROW = 10


@dataclass(slots=True)
class _Seen:
    """The newest stamp of a sensor [ns], and how many in a row are it."""

    stamp_ns: int
    stand: int = -1


class StampFaults:
    """What the stamps of the sensors beside the IMU show before a start."""

    def __init__(self) -> None:
        self._seen: dict[str, _Seen] = {}

    def note(self, sensor: str, stamp_ns: int) -> None:
        """Take in a stamp of a sensor as it arrives."""
        seen = self._seen.setdefault(sensor, _Seen(stamp_ns))
        seen.stand = seen.stand + 1 if stamp_ns == seen.stamp_ns else 0
        seen.stamp_ns = stamp_ns

    def why_not(self, needed: Collection[str]) -> str:
        """Return what is wrong with the stamps of all sensors of which one is needed; empty if nothing is."""
        stand = [name for name, seen in self._seen.items() if seen.stand >= IN_A_ROW]
        came = [name for name in needed if name in self._seen]
        if not came or any(name not in stand for name in came):
            return ""
        at_s = self._seen[came[0]].stamp_ns * 1e-9
        return f"the stamps of {', '.join(stand)} do not advance: they stand at {at_s:.3f} s while messages arrive"
