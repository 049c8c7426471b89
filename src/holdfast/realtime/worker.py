"""The optimiser process: takes in samples and measurements in the order of their arrival, optimises, publishes.

Started as `python -m holdfast.realtime.worker MEMORY REPORTS SETTINGS`: two inherited descriptors, and the length of
the pickled settings on its standard input. A byte on the standard input wakes it; the end of it says that the IMU path
is gone, and the process takes in what is left and ends.
"""

import os
import pickle
import select
import signal
import sys
import traceback
from pathlib import Path
from time import perf_counter_ns, process_time
from typing import NamedTuple

from holdfast.config.model import Config
from holdfast.estimator.clock import MAX_SILENCE_NS
from holdfast.estimator.imu_path import receive
from holdfast.estimator.optimiser import Optimiser
from holdfast.estimator.tracking import Update
from holdfast.event_log import EventLog
from holdfast.events import Outcome
from holdfast.geometry.earth import Geodetic
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT, LearntSnapshot
from holdfast.measured_fields import NEVER_NS
from holdfast.messages import ImuSample
from holdfast.parent import die_with_parent
from holdfast.realtime.layout import Board
from holdfast.realtime.memory import Word
from holdfast.realtime.placement import place_optimiser
from holdfast.realtime.records import Published, Records, Request, pack_nav
from holdfast.realtime.reports import Outbox, Report
from holdfast.sensors.imu import ImuBuffer
from holdfast.state import OptimisedState

POLL_S = 0.001  # while a measurement waits for the IMU, whose samples wake nobody
IDLE_S = 0.05
BATCH = 256  # measurements that are taken in before an update: it must end before someone thinks that this hangs
LEARNT_NS = 5_000_000_000  # what was learnt is reported this often
HISTORY_NS = 4_000_000_000  # of samples before the state at which a successor begins


class Settings(NamedTuple):
    """What the optimiser process must know.

    Attributes:
        in_step: an update at every trigger, as in one process.
        cores: that the process may use; its parent may have been tied to one of them.
        learnt: of the sensors, before this process.
    """

    config: Config
    in_step: bool
    cores: frozenset[int] | None
    learnt: LearntSnapshot = NOTHING_LEARNT


class Worker:
    """The optimiser and its end of the shared memory."""

    def __init__(self, settings: Settings, records: Records, board: Board, reports: Outbox) -> None:
        self._config, self._records = settings.config, records
        self._in_step = settings.in_step
        self._board, self._words, self._reports = board, board.words, reports
        self._epoch = self._life = self._updates = self._recoveries = 0
        self._sample, self._request = self._words[Word.SAMPLES], self._words[Word.BEGUN]
        self._buffer = ImuBuffer(self._config.imu)
        self._log = EventLog(self._config.imu_name)
        self._optimiser = Optimiser(self._config, self._buffer, self._log, learnt=settings.learnt)
        self._learnt_ns = NEVER_NS  # when it was last reported
        self._datum: Geodetic | None = None
        self._waiting_for = ""
        self._reported_counts: dict[tuple[str, Outcome], int] = {}
        self._smoothed: list[tuple[int, bytes]] = []
        self._took_ns: list[int] = []
        self._resume()

    def run(self) -> None:
        """Work until the IMU path is gone."""
        is_wanted = True
        while is_wanted:
            self._words[Word.HEARTBEAT] += 1
            if not self.take_in():
                is_wanted = self._sleep()
        while self.take_in():
            pass
        self._optimiser.close()
        self._report(with_learnt=True)

    @property
    def counts(self) -> dict[tuple[str, Outcome], int]:
        """What became of the measurements."""
        return dict(self._log.counts)

    def take_in(self) -> bool:
        """Take in what has come, in the order of arrival, and optimise at the end of it; whether there was anything."""
        before = self._sample, self._request
        for _ in range(BATCH):
            row = self._board.requests.read(self._request)
            if row is None:
                self._receive_until(None)
                break
            self._words[Word.BEGUN] = self._request + 1
            epoch, samples, request = self._records.unpack_request(row)
            if not self._receive_until(samples):
                break  # in step: an update first
            self._request += 1
            self._add(epoch, request)
            if self._in_step and self._optimiser.is_due:
                break
        if self._optimiser.is_due:
            self._update()
        self._report()
        self._words[Word.WAITING] = self._optimiser.waiting.total()
        self._words[Word.REQUESTS], self._words[Word.SAMPLES] = self._request, self._sample
        return (self._sample, self._request) != before

    def _receive_until(self, number: int | None) -> bool:
        """Take in the samples before a number, or all that there are; False if an update should come first."""
        ring = self._board.samples
        while number is None or self._sample < number:
            row = ring.read(self._sample)
            if row is None:
                oldest = ring.oldest_after(self._sample)
                if oldest is None:
                    return True
                self._sample = oldest  # too slow by the length of the ring: a gap that the graph bridges
                continue
            self._sample += 1
            self._receive(*self._records.unpack_sample(row))
            if self._in_step and self._optimiser.is_due:
                return False
        return True

    def _receive(self, epoch: int, sample: ImuSample) -> None:
        is_new = epoch != self._epoch
        silence_ns = sample.stamp_ns + self._buffer.offset_ns - self._buffer.latest_ns
        received = receive(self._buffer, sample, begins_anew=is_new and silence_ns > MAX_SILENCE_NS)
        if is_new and not received.begins_anew:
            self._optimiser.restart()  # a request that a predecessor has read but not answered
        self._epoch = epoch
        self._optimiser.receive(received)

    def _add(self, epoch: int, request: Request) -> None:
        if request is None or isinstance(request, Geodetic):
            self._epoch = epoch
            self._optimiser.restart(request)
            self._report(with_learnt=True)  # what is forgotten must not come back with a successor
            self._publish(None)
            return
        first = self._optimiser.add(request)
        if first is not None:
            self._life += 1
        if first is not None or self._optimiser.world.datum != self._datum:
            self._publish(first)

    def _update(self) -> None:
        began_ns = perf_counter_ns()
        update: Update = self._optimiser.update()
        self._took_ns.append(perf_counter_ns() - began_ns)
        self._optimiser.drop_samples()
        self._updates += 1
        self._recoveries += update.is_recovery
        self._smoothed += [(stamp_ns, pack_nav(nav)) for stamp_ns, nav in update.smoothed]
        self._report()  # before the state, so that who sees this finds what led to it
        self._publish(update.state)

    def _publish(self, state: OptimisedState | None) -> None:
        optimiser = self._optimiser
        self._datum = optimiser.world.datum
        counters = self._epoch, self._life, self._updates, self._recoveries
        trust, health = (optimiser.is_lost, tuple(optimiser.lost())), optimiser.monitor.snapshot()
        record = Published(*counters, *trust, health, optimiser.gravity, self._datum, state)
        self._board.published.write(self._records.pack_published(record))

    def _report(self, *, with_learnt: bool = False) -> None:
        """Report what is new; and every now and then, or if wanted, what was learnt."""
        counts, waiting_for, learnt = self.counts, self._optimiser.waiting_for, None
        if with_learnt or self._buffer.latest_ns - self._learnt_ns >= LEARNT_NS:
            learnt, self._learnt_ns = self._optimiser.learnt(), self._buffer.latest_ns
        is_news = counts != self._reported_counts or waiting_for != self._waiting_for
        if self._took_ns or self._log.events or is_news or learnt is not None:
            self._reported_counts, self._waiting_for = counts, waiting_for
            taken = self._log.take_events(), counts, self._smoothed, self._took_ns
            self._smoothed, self._took_ns = [], []
            self._reports.send(Report(*taken, waiting_for, process_time(), learnt=learnt))
        else:
            self._reports.flush()

    def _sleep(self) -> bool:
        """Wait until something may have come; False if nothing ever will."""
        patience_s = POLL_S if self._optimiser.waiting else IDLE_S
        readable, _, _ = select.select([0], [], [], patience_s)
        return not readable or bool(os.read(0, 4096))

    def _resume(self) -> None:
        """Go on where a predecessor has ended: at the newest state that was published."""
        records = [slot.read() for slot in (self._board.published, self._board.rescue)]
        found = [self._records.unpack_published(record[1]) for record in records if record is not None]
        if not found:
            return
        newest = max(found, key=lambda one: (one.epoch, -1 if one.state is None else one.state.stamp_ns))
        self._epoch, self._life = newest.epoch, max(one.life for one in found)
        self._updates = max(one.updates for one in found)
        self._recoveries = max(one.recoveries for one in found)
        if newest.datum is not None:
            self._optimiser.place(newest.datum)
        if newest.state is not None:
            self._fill(newest.state.stamp_ns - HISTORY_NS)
            self._optimiser.resume(newest.state, newest.lost)

    def _fill(self, since_ns: int) -> None:
        """Read again the samples that a predecessor had."""
        first, rows = self._sample, self._board.samples
        kept: list[ImuSample] = []
        while first > 0 and (row := rows.read(first - 1)) is not None:
            epoch, sample = self._records.unpack_sample(row)
            if epoch != self._epoch or sample.stamp_ns < since_ns:
                break
            kept.append(sample)
            first -= 1
        for sample in reversed(kept):
            receive(self._buffer, sample)


def main() -> None:
    """Run the optimiser of the engine that started this process."""
    memory, reports, length = (int(text) for text in sys.argv[1:])
    for number in (signal.SIGINT, signal.SIGTERM):  # whoever started this process decides when it ends
        signal.signal(number, signal.SIG_IGN)
    die_with_parent()
    outbox = Outbox(reports)
    settings: Settings = pickle.loads(_read_exactly(length))
    place_optimiser(settings.config.realtime, settings.cores)
    worker = None
    try:
        records = Records(settings.config)
        worker = Worker(settings, records, Board(records, memory), outbox)
        worker.run()
    except BrokenPipeError:
        sys.exit(0)  # nobody is left
    except Exception as error:  # the IMU path goes on, and starts a successor
        trace = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(trace.filename).name}:{trace.lineno}"
        outbox.send(
            Report((), {} if worker is None else worker.counts, (), (), "", 0.0, f"raised {error!r} in {where}")
        )
        outbox.finish()
        sys.exit(1)
    outbox.finish()


def _read_exactly(length: int) -> bytes:
    body = b""
    while len(body) < length:
        part = os.read(0, length - len(body))
        if not part:
            sys.exit(0)
        body += part
    return body


if __name__ == "__main__":
    main()
