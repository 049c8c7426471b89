"""The optimised states on their way from the shared memory into the IMU path."""

from dataclasses import replace

import numpy as np

from holdfast.config.model import Config
from holdfast.estimator.imu_path import ImuPath
from holdfast.geometry.world import World
from holdfast.kernel.follower import FOLLOWED, HAS_DATUM, NOTHING, follow
from holdfast.realtime.layout import Board
from holdfast.realtime.records import PackedState, Published, Records
from holdfast.sensors.imu import ImuBuffer
from holdfast.state import OptimisedState

NEVER = 1 << 62  # a stamp after all others
KEPT_NS = 1_000_000_000  # of samples before the newest optimised state
RESCUE_S = 5.0  # without an optimised state for so long, or three node intervals, the propagated one takes its place


class StateFollower:
    """Takes in the newest optimised state, and goes on without one if none comes for long.

    What it must remember lies where the kernel reads it, which takes in a state that goes on where the last one was.

    Attributes:
        world: W, as published.

    Args:
        config: of the estimator.
        board: the shared memory.
        records: its layouts.
        path: into which the states go.
        buffer: of the IMU's samples.
    """

    def __init__(self, config: Config, board: Board, records: Records, path: ImuPath, buffer: ImuBuffer) -> None:
        self._slot, self._rescue_slot, samples = board.published, board.rescue, board.samples
        self._records, self._path, self._buffer = records, path, buffer
        self._board = board  # the kernel has addresses in it
        self._newest: Published | None = None
        self._packed: bytes | None = None  # the newest, where it has not been unpacked
        self._taken = np.zeros(self._slot.words, np.int64)
        self._shared = one = path.shared
        one["patience_ns"] = round(max(RESCUE_S, 3.0 * config.graph.max_node_interval_s) * 1e9)
        one["kept_ns"], one["healths"] = KEPT_NS, records.healths
        one["ring_at"], one["ring_rows"] = samples.words.ctypes.data, samples.rows
        one["written_at"], one["taken_at"] = samples.count.ctypes.data, self._taken.ctypes.data
        one["slot_at"], one["slot_words"] = self._slot.address, self._slot.words
        self.world = World()

    def release(self) -> None:
        """Let go of the memory that is shared with the other process."""
        self._shared["ring_at"] = self._shared["slot_at"] = 0

    @property
    def epoch(self) -> int:
        """How often all began anew."""
        return int(self._shared["epoch"])

    @property
    def seen(self) -> int:
        """Version of the state that was looked at last."""
        return int(self._shared["seen"])

    @property
    def rescue_ns(self) -> int:
        """Without a new state, an estimate after this should `rescue`."""
        return int(self._shared["rescue_ns"])

    @property
    def has_new(self) -> bool:
        """Whether there is a state that has not been taken in."""
        return self._slot.version != self.seen

    @property
    def version(self) -> int:
        """How many states there have been."""
        return self._slot.version

    @property
    def newest(self) -> Published | None:
        """What was taken in last, None before the first state of the epoch."""
        if self._packed is not None:
            self._newest, self._packed = self._records.unpack_published(self._packed), None
        return self._newest

    def begin_anew(self) -> None:
        """Take in no state of before any more."""
        self._newest = self._packed = None
        self._shared["epoch"] += 1
        self._shared["rescue_ns"] = NEVER

    def take(self) -> OptimisedState | None:
        """Take in the newest optimised state; None if there is none of this epoch."""
        found = follow(self._path.address)
        if found == NOTHING:
            return None
        packed = self._taken[1:-1].tobytes()
        if found == FOLLOWED:
            self._packed = packed
            return PackedState.of(int(self._shared["anchor_ns"]), packed, self._records)
        return self._begin_with(self._records.unpack_published(packed))

    def _begin_with(self, newest: Published) -> OptimisedState | None:
        """Take in a state that does not go on where the one before was."""
        if newest.epoch != self.epoch:
            return None  # the optimiser does not know yet that all began anew
        if newest.datum is not None and newest.datum != self.world.datum:
            self.world.place(newest.datum)
        state, one = newest.state, self._shared
        if state is None:
            return None
        if not self._path.is_running or newest.life != one["life"]:
            self._path.start(state, newest.gravity)
        elif state.stamp_ns < one["anchor_ns"] and one["is_rescued"]:
            return None  # of an optimiser that had been stopped: the samples since are no longer kept
        else:
            self._path.anchor(state, is_recovery=newest.recoveries != one["recoveries"])
        one["life"], one["recoveries"] = newest.life, newest.recoveries
        one["flags"], one["datum"] = (0, 0.0) if newest.datum is None else (HAS_DATUM, newest.datum)
        self._newest, self._packed = newest, None
        self._anchor_at(state, is_rescued=False)
        return state

    def rescue(self) -> None:
        """Without news for long: go on from the propagated state, and let a successor of the optimiser begin there."""
        assert self.newest is not None
        state = self._path.settle()
        self._newest = replace(self.newest, state=state)
        self._rescue_slot.write(self._records.pack_published(self._newest))
        self._anchor_at(state, is_rescued=True)

    def _anchor_at(self, state: OptimisedState, *, is_rescued: bool) -> None:
        one = self._shared
        one["anchor_ns"], one["is_rescued"] = state.stamp_ns, is_rescued
        one["rescue_ns"] = state.stamp_ns + one["patience_ns"]
        self._buffer.forget_before(state.stamp_ns - KEPT_NS)
