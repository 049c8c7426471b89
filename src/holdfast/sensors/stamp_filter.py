"""Which stamps can be right: none twice, none ahead of the IMU's clock."""

from collections import deque

from holdfast.events import Outcome

RECENT = 64  # stamps per sensor among which a duplicate is looked for
FUTURE_NS = 1_000_000_000  # further ahead of the IMU's clock a stamp is an error
LEAD_NS = 500_000_000  # further ahead than its sensor's stamps use to be, too
LEAD_STEP_NS = 10_000_000  # by which what they use to be falls with each message


class StampFilter:
    """Duplicates, and stamps that are ahead of the IMU's clock; one for all sensors."""

    def __init__(self) -> None:
        self._recent: dict[str, deque[int]] = {}
        self._newest: dict[str, int] = {}
        self._leads: dict[str, int] = {}  # by how much stamps of a sensor use to be ahead at most

    def check(self, sensor: str, stamp_ns: int, arrival_ns: int, reached_ns: int, reached_arrival_ns: int) -> Outcome:
        """Say whether a stamp, time offset applied, can be right; the IMU has reached a time, and when it arrived.

        A stamp is in the future if it is further ahead than silence of the IMU and the habit of its sensor explain.
        """
        recent = self._recent.setdefault(sensor, deque(maxlen=RECENT))
        newest_ns = self._newest.get(sensor, stamp_ns - 1)
        if stamp_ns <= newest_ns and stamp_ns in recent:
            return Outcome.DUPLICATE
        if reached_ns > 0:
            lead_ns = stamp_ns - reached_ns - max(0, arrival_ns - reached_arrival_ns)
            usual_ns = max(0, self._leads.get(sensor, FUTURE_NS))
            if lead_ns > min(FUTURE_NS, usual_ns + LEAD_NS):
                return Outcome.CLOCK_JUMP
            self._leads[sensor] = max(lead_ns, usual_ns - LEAD_STEP_NS) if sensor in self._leads else lead_ns
        recent.append(stamp_ns)
        self._newest[sensor] = max(stamp_ns, newest_ns)
        return Outcome.USED
