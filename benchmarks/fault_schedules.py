"""Runs random fault schedules through the estimator and prints every seed that breaks it.

`python benchmarks/fault_schedules.py --count 1000`: each schedule is simulated, recorded and replayed; no exception, no
number that is none, and no step of the odometry frame may come of it. Clocks step, sensors flood, have twins and send
garbage on top of what `--mild` leaves. With `--mild` it is counted, too, how often an estimate began anew that was
right, within its covariance of the truth (NEES), and whether one was far off and did not know. It is a failure where
something was there that could tell: a receiver to which nothing happened. Where all that came were positions that lied,
or a start in two steps has come to its second, a line says so.

With `--realtime` the engine takes the recording at `--rate` times its pace while its optimiser is killed at random, and
no answer may come later than 5 ms. What this process waits for a processor that others keep busy is no fault of the
engine, and not counted (Linux: /proc/thread-self/schedstat).
"""

import argparse
import gc
import os
import signal
import sys
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, perf_counter_ns, sleep

import numpy as np

from holdfast.config.load import config_of
from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.estimator.successor import IN_DOUBT
from holdfast.evaluation.consistency import chi_square_quantile, nees
from holdfast.evaluation.soundness import violations
from holdfast.evaluation.states import States, state_errors
from holdfast.events import EventKind
from holdfast.messages import Message
from holdfast.realtime.engine import RealtimeEstimator
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.replay.published import PublishedRecorder
from holdfast.sim.configuration import configuration_data
from holdfast.sim.faults import effects
from holdfast.sim.readings import generator
from holdfast.sim.schedules import DURATION_S, hostile_schedule, random_schedule
from holdfast.sim.sensors.gnss import SimulatedGnss
from holdfast.sim.simulation import START_NS, Simulation
from holdfast.state import Output
from holdfast.trial.run import RECORDING, estimate, write_simulation
from holdfast.trial.truth import true_states

LATE_NS = 5_000_000
SCHEDSTAT = Path("/proc/thread-self/schedstat")
SOUND = 0.997  # of estimates that are right are nearer to the truth, by their covariance
RECENT_S = 1.0  # before an estimate begins anew, a receiver to which nothing happened could tell that it need not
FAR_M, FAR_SIGMA = 10.0, 10.0  # off, more than an estimate may be that does not know
MENDED_S = 10.0  # in which a receiver that is right has brought it back
DIVERGED_M = 1000.0  # off, where nothing that is measured is
EVERY = 50  # schedules that are done, a line says so
NOTE = "(no failure) "  # begins a line that is none
NO_WITNESS, SETTLED = f"{NOTE}no receiver was right: ", f"{NOTE}second step of a start: "
MENDED = f"{NOTE}found by itself: "
KILLED_RATIO = 0.5  # of the runs in real time


def complaints(
    seed: int, preset: str = "holdfast", *, hostile: bool = False, starts: bool = False, rate: float | None = None
) -> list[str]:
    """Return what the schedule of a seed broke, one line each.

    Args:
        seed: of the schedule.
        preset: of the configuration.
        hostile: with what broken software does, too.
        starts: also that an estimate which was right began anew, or was far off and did not know.
        rate: run the engine at so many times the pace of the recording, and kill its optimiser; else the estimator.
    """
    scenario = (hostile_schedule if hostile else random_schedule)(seed)
    config = config_of({"preset": preset} | configuration_data(scenario, seed), f"schedule {seed}")
    with TemporaryDirectory() as folder:
        try:
            simulation = write_simulation(scenario, seed, Path(folder))
        except ConfigError as error:
            return [f"no such simulation: {error}"]
        try:
            late: list[str] = []
            if rate is None:
                recorder = estimate(Path(folder), config)
            else:
                recorder, late = played(Path(folder), config, seed, rate)
            errors = Errors(simulation, recorder) if starts else None
            wrong = [] if errors is None else errors.sound_starts() + errors.lost()
            return [line for life in recorder.lives() for line in violations(life, START_NS)] + wrong + late
        except Exception as error:
            at = traceback.extract_tb(error.__traceback__)[-1]
            return [f"{type(error).__name__} in {Path(at.filename).name}:{at.lineno} {at.name}: {error}".split("\n")[0]]


class Errors:
    """What an estimate was off by beside what it said.

    Args:
        simulation: that was estimated.
        recorder: of the estimate.
    """

    def __init__(self, simulation: Simulation, recorder: PublishedRecorder) -> None:
        self._scenario, self._events = simulation.scenario, recorder.events
        published = recorder.published()
        self._stamps_ns, self._covariances = published.world.poses.stamps_ns, published.covariances
        truth = States(*true_states(simulation, self._stamps_ns))
        self._tangent = state_errors(published.world, truth).tangent
        self._off_m = np.linalg.norm(self._tangent[:, 3:6], axis=1)

    def sound_starts(self) -> list[str]:
        """Return a line for each time that an estimate began anew which was right; NOTE begins what is no failure."""
        is_right = nees(self._tangent, self._covariances) < chi_square_quantile(SOUND, self._tangent.shape[1])
        lines, is_second = [], False
        for event in self._events:
            if event.kind is not EventKind.BEGUN_ANEW:
                continue
            row = max(int(np.searchsorted(self._stamps_ns, event.stamp_ns)) - 1, 0)
            at_s = (event.stamp_ns - START_NS) * 1e-9
            if is_right[row]:
                excuse = SETTLED if is_second else self._excuse(at_s, RECENT_S)
                off = f"a sound estimate, {self._off_m[row]:.2f} m off"
                lines.append(f"{excuse}{off}, began anew at {at_s:.2f} s: {event.reason}")
            is_second = event.reason.endswith(IN_DOUBT)
        return lines

    def lost(self) -> list[str]:
        """Return a line if an estimate was far off and did not know; NOTE begins it where that is no failure."""
        sigmas_m = np.sqrt(np.trace(self._covariances[:, 3:6, 3:6], axis1=1, axis2=2))
        is_far = (self._off_m > FAR_M) & (self._off_m > FAR_SIGMA * sigmas_m)
        if not is_far.any():
            return []
        worst = int(np.argmax(np.where(is_far, self._off_m, 0.0)))
        at_s = (self._stamps_ns - START_NS) * 1e-9
        near_s = at_s[~is_far]
        before_s = near_s[near_s < at_s[worst]].max(initial=at_s[0])
        after_s = near_s[near_s > at_s[worst]].min(initial=at_s[-1])
        excuse = MENDED if after_s - before_s < MENDED_S else self._excuse(after_s, after_s - before_s)
        excuse = "" if self._off_m[worst] > DIVERGED_M else excuse
        return [f"{excuse}{self._off_m[worst]:.0f} m off for {after_s - before_s:.1f} s, sigma {sigmas_m[worst]:.2f} m"]

    def _excuse(self, at_s: float, since_s: float) -> str:
        """Return why nothing could tell at a time what is right, or nothing if a receiver could, since so long."""
        recent = [fault for fault in self._scenario.faults if fault.start_s <= at_s and fault.end_s >= at_s - since_s]
        suffering = {name for fault in recent for name, _ in effects(fault, self._scenario.sensors)}
        return "" if self._scenario.sensors_of(SimulatedGnss).keys() - suffering else NO_WITNESS


def played(folder: Path, config: Config, seed: int, rate: float) -> tuple[PublishedRecorder, list[str]]:
    """Run the engine over a recording and return what it published, with a line if an answer came late."""
    rng = generator(seed, "kills")
    kills_s = rng.uniform(0.0, DURATION_S, int(rng.integers(1, 4))) if rng.random() < KILLED_RATIO else ()
    with open_recording(folder / RECORDING) as recording, RealtimeEstimator(config) as engine:
        engine.wait_until_ready()
        timed = TimedEngine(engine)
        recorder = PublishedRecorder(config, timed)
        gc.collect()
        gc.freeze()  # as `holdfast live` does: looking through what the schedules before have left may take 80 ms
        recorder.run(paced(recording.read(subscriptions(config)), rate, sorted(kills_s), engine))
        gc.unfreeze()
        engine.flush()
    return recorder, timed.complaints()


def paced(
    messages: Iterator[Message], rate: float, kills_s: Sequence[float], engine: RealtimeEstimator
) -> Iterator[Message]:
    """Yield messages at their times, and kill the optimiser at others."""
    began, left = perf_counter(), list(kills_s)
    for message in messages:
        at_s = (message.arrival_ns - START_NS) * 1e-9
        if (ahead_s := at_s / rate - (perf_counter() - began)) > 0.0:
            sleep(ahead_s)
        while left and at_s >= left[0]:
            left.pop(0)
            if (pid := engine.optimiser_pid) is not None:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
        yield message


class TimedEngine:
    """An engine of which is noted how late it answers."""

    def __init__(self, engine: RealtimeEstimator) -> None:
        self._engine = engine
        self._late: list[tuple[int, Message]] = []

    def __getattr__(self, name: str) -> object:
        return getattr(self._engine, name)

    def process(self, message: Message) -> Output:
        """Take in a message."""
        queued_ns, began_ns = waited_for_processor_ns(), perf_counter_ns()
        output = self._engine.process(message)
        took_ns = perf_counter_ns() - began_ns
        if took_ns > LATE_NS and (took_ns := took_ns - (waited_for_processor_ns() - queued_ns)) > LATE_NS:
            self._late.append((took_ns, message))
        return output

    def complaints(self) -> list[str]:
        """Return a line if an answer was late."""
        if not self._late:
            return []
        took_ns, message = max(self._late, key=lambda one: one[0])
        latest = f"{took_ns * 1e-6:.1f} ms to {message.sensor} at {(message.arrival_ns - START_NS) * 1e-9:.2f} s"
        return [f"{len(self._late)} late answers, the latest after {latest}"]


def waited_for_processor_ns() -> int:
    """Return how long this thread was ready and did not run; 0 where the kernel does not say."""
    try:
        return int(SCHEDSTAT.read_bytes().split()[1])
    except (OSError, IndexError):
        return 0


def run(seeds: Sequence[int], jobs: int, options: argparse.Namespace) -> Iterator[tuple[int, list[str]]]:
    """Yield every seed with its complaints, in order."""
    rate = options.rate if options.realtime else None
    found = partial(complaints, preset=options.preset, hostile=not options.mild, starts=options.mild, rate=rate)
    if jobs == 1:
        yield from ((seed, found(seed)) for seed in seeds)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from zip(seeds, pool.map(found, seeds, chunksize=4), strict=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, help="seed of the first schedule")
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seeds", type=int, nargs="+", help="these instead")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--preset", choices=["holdfast", "paper"], default="holdfast")
    parser.add_argument("--mild", action="store_true", help="without steps of all clocks, floods, twins and garbage")
    parser.add_argument("--realtime", action="store_true", help="the engine in two processes, which is killed at times")
    parser.add_argument("--rate", type=float, default=8.0, help="how much faster than real time, with --realtime")
    options = parser.parse_args()
    seeds = options.seeds or range(options.first, options.first + options.count)
    failed = 0
    for number, (seed, found) in enumerate(run(seeds, options.jobs, options), start=1):
        for line in found:
            print(f"seed {seed}: {line}", flush=True)
        failed += any(not line.startswith(NOTE) for line in found)
        if number % EVERY == 0:
            print(f"{number} of {len(seeds)}, {failed} failed", flush=True)
    kind = f"{'mild' if options.mild else 'hostile'} schedules, {'engine' if options.realtime else 'estimator'}"
    print(f"{len(seeds)} {kind}, preset {options.preset}: {failed} failed")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
