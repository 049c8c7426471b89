"""One run over a recording with all its files: what the commands `replay` and `smooth` and the functions share."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.calibration.learnt_file import Loaded, load_learnt, save_learnt
from holdfast.calibration.learnt_table import learnt_rows, plain_rows, wrong_lines
from holdfast.config.model import Config
from holdfast.errors import EstimatorError, HoldfastError
from holdfast.events import EventKind
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT, LearntSnapshot
from holdfast.lidar_odometry.replayed import ReplayedScans
from holdfast.loops.opening import loop_closer
from holdfast.messages import Message
from holdfast.recording.driver_check import driver_faults
from holdfast.recording.source import Recording
from holdfast.replay.batch_outputs import CAUSAL, BatchOutputs
from holdfast.replay.held_out import HoldOut
from holdfast.replay.interrupts import Uninterrupted
from holdfast.replay.never_started import never_started
from holdfast.replay.outputs import SUMMARY, Outputs
from holdfast.replay.runner import Replay
from holdfast.replay.summary import summarise_replay
from holdfast.smoothing.batch_smoother import BatchSmoother
from holdfast.smoothing.block import Block
from holdfast.state import Output
from holdfast.whole_file import write_whole

if TYPE_CHECKING:  # starting processes is left to whoever wants them
    from holdfast.realtime.engine import RealtimeEstimator

OFTEN = 2  # times that an estimate has begun anew: its sensors contradict each other
ShowProgress = AbstractContextManager[Callable[[int], None] | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """What is to be run.

    Attributes:
        path: of the recording, as it was given.
        config: of the estimator.
        folder: for the results; it may hold none of an earlier run.
        messages: of the recording, in the order of arrival.
        missing: why the recording holds nothing of other sensors, by name.
        rules: what is held back.
        batch_s: window and overlap of the optimum over the recording; None for the causal run alone.
        rate: how many times faster than the recording; None is as fast as possible.
        realtime: run the engine of two processes.
        command: that asked for it; empty for a program that did.
        keep_track: keep the causal track in memory for a figure.
        learnt: file of what was learnt of the sensors: read if it is there, and written in the end; None for none.
        on_output: takes the output of each message.
        on_block: takes each stretch of the optimum.
    """

    path: str
    config: Config
    folder: Path
    messages: Iterable[Message]
    missing: Mapping[str, str] = field(default_factory=dict)
    rules: Sequence[HoldOut] = ()
    batch_s: tuple[float, float] | None = None
    rate: float | None = None
    realtime: bool = False
    command: str = ""
    keep_track: bool = False
    learnt: Path | None = None
    on_output: Callable[[Output], None] = lambda _: None
    on_block: Callable[[Block], None] = lambda _: None


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """What has run.

    Attributes:
        causal: folder of the causal run.
        summary: as it was written.
        warnings: one line each; those about missing sensors stand in `summary` alone.
        failure: what ended it early.
    """

    run: Replay
    causal: Path
    summary: dict[str, Any]
    warnings: list[str]
    failure: BaseException | None

    def check_end(self) -> None:
        """Raise what ended it early, if something did: a `HoldfastError` or a `KeyboardInterrupt`, as it came."""
        if self.failure is not None:
            raise self.failure

    def check_start(self, session: Session) -> None:
        """See that there are estimates.

        Raises:
            EstimatorError: the estimator never started; says why.
        """
        if not self.run.has_started:
            estimator = self.run.estimator
            why = never_started(estimator.waiting_for, estimator.counts, session.config)
            looks_wrong = "".join(f"; {line}" for line in self.summary["looks_wrong"])
            raise EstimatorError(f"{session.path}: the estimator never started: {why}{looks_wrong}")


def run(session: Session, opened: Recording, show: ShowProgress) -> Finished:
    """Run the estimator, and write all files; what could be done until a failure is written as well.

    Raises:
        ConfigError: a file cannot be written, or is not what it should be, or something is not installed.
        RecordingError: the recording cannot be opened for its scans.
        KeyboardInterrupt: before there was anything to write, or while it was being written, which is done first.
    """
    ending = Uninterrupted()
    with ExitStack() as stack:
        ending.start()
        stack.callback(ending.stop)
        return _run(session, opened, show, lambda: stack.enter_context(ending))


def _run(session: Session, opened: Recording, show: ShowProgress, begin_to_end: Callable[[], object]) -> Finished:
    """Run the estimator; after `begin_to_end` an interrupt waits until all is written."""
    config, folder = session.config, session.folder
    causal = folder if session.batch_s is None else folder / CAUSAL
    batch: BatchSmoother | None = None
    failure: BaseException | None = None
    takers = [session.on_block]
    before = Loaded(NOTHING_LEARNT, []) if session.learnt is None else load_learnt(session.learnt, config)

    def stamp(time_ns: int) -> int:
        return replay.stamp(time_ns)

    with ExitStack() as stack:
        outputs, files = stack.enter_context(Outputs(causal, config)), None
        if session.batch_s is not None:
            closer = stack.enter_context(loop_closer(session.path, opened, config, stamp))
            batch = BatchSmoother(config, *session.batch_s, closer)
            files = stack.enter_context(BatchOutputs(folder, config))
            takers.append(files.write)
        scanned = stack.enter_context(ReplayedScans(config, session.messages))
        replay = Replay(
            config,
            outputs,
            session.rules,
            session.keep_track,
            realtime=stack.enter_context(_engine(config, session.realtime, before.learnt)),
            batch=batch,
            learnt=before.learnt,
            on_output=session.on_output,
            on_block=lambda block: [take(block) for take in takers],
        )
        try:
            with show as progress:
                replay.run(scanned, session.rate or (1.0 if session.realtime else None), progress)
        except (HoldfastError, KeyboardInterrupt) as error:
            failure = error
        begin_to_end()
        replay.write_events()
    learnt = replay.estimator.learnt()
    warnings = [*before.warnings, *opened.warnings, *scanned.warnings(), *replay.warnings, *_stopped(replay)]
    warnings += [] if batch is None else batch.warnings()
    went_badly = not replay.has_started or replay.estimator.event_counts[EventKind.BEGUN_ANEW] >= OFTEN
    of_driver = driver_faults(opened, config) if went_badly and failure is None else []
    if session.learnt is not None and replay.has_started:
        if of_driver:  # all that was learnt explains readings that are wrong
            warnings.append(f"{session.learnt}: not written, as keys of the IMU look wrong")
        else:
            save_learnt(session.learnt, learnt, config)
    summary = _summarise(session, replay, warnings, failure is None)
    rows = learnt_rows(learnt, config)
    summary |= {"learnt": plain_rows(rows), "looks_wrong": of_driver or wrong_lines(rows)}
    _write_summary(causal, summary)
    if batch is not None and files is not None:
        summary["smooth"] = files.summary(batch)
        _write_summary(folder, summary)
    return Finished(replay, causal, summary, warnings, failure)


def _summarise(session: Session, replay: Replay, warnings: list[str], is_finished: bool) -> dict[str, Any]:
    told = [*(f"{sensor}: {reason}" for sensor, reason in session.missing.items()), *warnings]
    return summarise_replay(replay, session.path, told, is_finished, session.command, session.missing)


def _write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write summary.json.

    Raises:
        ConfigError: it cannot be written.
    """
    write_whole(folder / SUMMARY, json.dumps(summary, indent=2) + "\n")


def _engine(config: Config, wanted: bool, learnt: LearntSnapshot) -> "AbstractContextManager[RealtimeEstimator | None]":
    if not wanted:
        return nullcontext()
    from holdfast.realtime.engine import RealtimeEstimator

    return RealtimeEstimator(config, learnt=learnt)


def _stopped(replay: Replay) -> list[str]:
    """Return the warning that the estimator was beginning anew when the recording ended, if it was."""
    if replay.estimator.initialised or not replay.has_started:
        return []
    return [f"the estimator had begun anew, and was not running at the end: {replay.estimator.waiting_for}"]
