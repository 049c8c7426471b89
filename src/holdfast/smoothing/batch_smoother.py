"""The optimum over a recording of any length: windows of minutes that overlap, each handing on what it knows.

A window is solved with what follows it for `OVERLAP_S`; then its own part is done, and leaves the problem. What it
measured stays as a prior on the variables at the border, exact but for its linearisation about the optimum. So memory
is bounded, and the past is never cut off; the future is, after `OVERLAP_S`.
"""

from collections.abc import Mapping
from time import perf_counter
from typing import NamedTuple

from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.estimator.imu_path import Received
from holdfast.estimator.learnt_view import LearntView
from holdfast.estimator.tracking import Update
from holdfast.measured_fields import has_double, in_words, is_number
from holdfast.printable import first_line
from holdfast.sensors.sensor import Joint, Measurement, Parameter, Sensor
from holdfast.smoothing.block import Block
from holdfast.smoothing.closures import Closer
from holdfast.smoothing.recorded import Recorded
from holdfast.smoothing.segment import Segment
from holdfast.state import OptimisedState

WINDOW_S, OVERLAP_S = 300.0, 120.0
DROPPED_NS = 10_000_000_000  # before a start, older samples are dropped this often
BEFORE_START_NS = 60_000_000_000  # samples that are kept while nothing has started


def check_lengths(window_s: float, overlap_s: float, names: tuple[str, str] = ("window_s", "overlap_s")) -> None:
    """Refuse lengths of windows that cannot be meant; `names` are those of the two where they were given.

    Raises:
        ConfigError: says which, and what is allowed.
    """
    for name, given_s, least_s, most_s in ((names[0], window_s, 10, 36_000), (names[1], overlap_s, 5, 3600)):
        if not is_number(given_s) or not least_s <= given_s <= most_s:
            shown = f"{given_s:g}" if is_number(given_s) and has_double(given_s) else in_words(given_s)
            raise ConfigError(f"{name} {shown}: must be from {least_s} to {most_s} s")


class Failure(NamedTuple):
    """A stretch that could not be solved, and why."""

    start_ns: int
    end_ns: int
    reason: str


class BatchSmoother:
    """Listens to an estimator and estimates once more, window by window; `take` gives what is done.

    Args:
        config: of the estimator.
        window_s: that are done at once.
        overlap_s: after them that are solved, too, and once more with the next window.
        closer: finds loop closures in what is solved at once, if there are scans.
    """

    def __init__(
        self,
        config: Config,
        window_s: float = WINDOW_S,
        overlap_s: float = OVERLAP_S,
        closer: Closer | None = None,
    ) -> None:
        self._config, self._closer = config, closer
        self._window_ns, self._overlap_s = round((window_s + overlap_s) * 1e9), overlap_s
        self._recorded = Recorded(config)
        self._segment: Segment | None = None
        # models, gravity and where antennas were known to be, since the last start
        self._machine: tuple[Mapping[str, Sensor], float, Mapping[str, Parameter]] | None = None
        self._dropped_ns = 0
        self._blocks: list[Block] = []
        self.failures: list[Failure] = []
        self.wall_s = 0.0  # that solving took

    # --- what the estimator tells ------------------------------------------------------------------------------------

    def receive(self, received: Received) -> None:
        """Take note of a usable sample of the IMU."""
        self._recorded.receive(received)
        now_ns = self._recorded.buffer.latest_ns
        if self._segment is None and abs(now_ns - self._dropped_ns) > DROPPED_NS:
            self._dropped_ns = now_ns
            self._recorded.drop_before(now_ns - BEFORE_START_NS)

    def add(self, measurement: Measurement, joint: Joint | None) -> None:
        """Take note of a checked measurement."""
        self._recorded.add(measurement, joint)

    def start(
        self, state: OptimisedState, sensors: Mapping[str, Sensor], gravity: float, found: Mapping[str, Parameter]
    ) -> None:
        """Take note of a first state, and end what was before."""
        self.stop()
        self._machine = sensors, gravity, found
        self._begin(state)

    def _begin(self, state: OptimisedState) -> None:
        assert self._machine is not None
        sensors, gravity, found = self._machine
        self._recorded.drop_before(state.stamp_ns)
        self._segment = Segment(
            self._config,
            self._recorded,
            state,
            sensors,
            gravity=gravity,
            found=found,
            overlap_s=self._overlap_s,
            closer=self._closer,
        )

    def stop(self) -> None:
        """Take note that nothing of before is known any more: what there is, is solved."""
        if self._segment is not None:
            self._solve(self._recorded.buffer.latest_ns, is_last=True)
        self._segment = self._machine = None

    def update(self, update: Update, learnt: LearntView) -> None:
        """Take note of an optimisation; solve a window once it is full."""
        self._recorded.update(update, learnt)
        if self._segment is None and self._machine is not None:  # a window could not be solved
            self._begin(update.state)
        settled_ns = self._recorded.settled_ns
        if self._segment is not None and settled_ns - self._segment.oldest_ns > self._window_ns:
            self._solve(settled_ns, is_last=False)

    # --- what is done ------------------------------------------------------------------------------------------------

    def take(self) -> list[Block]:
        """Return what was finished since the last call, in the order of time."""
        blocks, self._blocks = self._blocks, []
        return blocks

    def _solve(self, until_ns: int, *, is_last: bool) -> None:
        segment, began_s = self._segment, perf_counter()
        assert segment is not None
        try:
            segment.extend(until_ns)
            work = segment.solve()
            self._blocks.append(segment.finish(work, is_last=is_last))
        except RuntimeError as error:
            self.failures.append(Failure(segment.oldest_ns, until_ns, first_line(error)))
            self._segment = None
        else:
            self._recorded.drop_before(segment.oldest_ns)
        self.wall_s += perf_counter() - began_s

    def warnings(self) -> list[str]:
        """Return what could not be solved, one line each."""
        return [
            f"the optimum of {(f.end_ns - f.start_ns) * 1e-9:.0f} s was not found: {f.reason}" for f in self.failures
        ]
