"""The optimised states on their way from the shared memory into the IMU path."""

from dataclasses import replace

from holdfast.config.model import Config
from holdfast.estimator.imu_path import ImuPath
from holdfast.geometry.world import World
from holdfast.realtime.layout import Board
from holdfast.realtime.records import Published, Records
from holdfast.sensors.imu import ImuBuffer
from holdfast.state import OptimisedState

NEVER = 1 << 62  # a stamp after all others
KEPT_NS = 1_000_000_000  # of samples before the newest optimised state
RESCUE_S = 5.0  # without an optimised state for so long, or three node intervals, the propagated one takes its place


class StateFollower:
    """Takes in the newest optimised state, and goes on without one if none comes for long.

    Attributes:
        epoch: how often all began anew.
        newest: what was taken in last, None before the first state of the epoch.
        rescue_ns: without a new state, an estimate after this should `rescue`.
        world: W, as published.

    Args:
        config: of the estimator.
        board: the shared memory.
        records: its layouts.
        path: into which the states go.
        buffer: of the IMU's samples.
    """

    def __init__(self, config: Config, board: Board, records: Records, path: ImuPath, buffer: ImuBuffer) -> None:
        self._slot, self._rescue_slot = board.published, board.rescue
        self._records, self._path, self._buffer = records, path, buffer
        self._patience_ns = round(max(RESCUE_S, 3.0 * config.graph.max_node_interval_s) * 1e9)
        self._life = self._recoveries = self._anchor_ns = 0
        self.rescue_ns = NEVER
        self._is_rescued = False
        self.epoch = self.seen = 0
        self.newest: Published | None = None
        self.world = World()

    @property
    def has_new(self) -> bool:
        """Whether there is a state that has not been taken in."""
        return self._slot.version != self.seen

    @property
    def version(self) -> int:
        """How many states there have been."""
        return self._slot.version

    def begin_anew(self) -> None:
        """Take in no state of before any more."""
        self.epoch, self.newest, self.rescue_ns = self.epoch + 1, None, NEVER

    def take(self) -> OptimisedState | None:
        """Take in the newest optimised state; None if there is none of this epoch."""
        found = self._slot.read()
        if found is None:
            return None
        self.seen, record = found
        newest = self._records.unpack_published(record)
        if newest.epoch != self.epoch:
            return None  # the optimiser does not know yet that all began anew
        if newest.datum is not None and newest.datum != self.world.datum:
            self.world.place(newest.datum)
        state = newest.state
        if state is None:
            return None
        if not self._path.is_running or newest.life != self._life:
            self._path.start(state, newest.gravity)
        elif state.stamp_ns < self._anchor_ns and self._is_rescued:
            return None  # of an optimiser that had been stopped: the samples since are no longer kept
        else:
            self._path.anchor(state, is_recovery=newest.recoveries != self._recoveries)
        self._life, self._recoveries, self.newest = newest.life, newest.recoveries, newest
        self._anchor_at(state, is_rescued=False)
        return state

    def rescue(self) -> None:
        """Without news for long: go on from the propagated state, and let a successor of the optimiser begin there."""
        assert self.newest is not None
        state = self._path.settle()
        self.newest = replace(self.newest, state=state)
        self._rescue_slot.write(self._records.pack_published(self.newest))
        self._anchor_at(state, is_rescued=True)

    def _anchor_at(self, state: OptimisedState, *, is_rescued: bool) -> None:
        self._anchor_ns, self._is_rescued = state.stamp_ns, is_rescued
        self.rescue_ns = state.stamp_ns + self._patience_ns
        self._buffer.forget_before(state.stamp_ns - KEPT_NS)
