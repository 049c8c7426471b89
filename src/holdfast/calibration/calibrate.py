"""The whole calibration: runs over all recordings until no constant moves, then noise, then what held-out fixes say."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from holdfast.calibration.clocks import clocks
from holdfast.calibration.draft import AnyConfig, Draft
from holdfast.calibration.estimated import Estimated, Family, Found
from holdfast.calibration.evidence import Evidence, Progress, gather
from holdfast.calibration.fix_noise import fix_noise
from holdfast.calibration.held_out import HeldOut, held_out, is_worse, rules_of
from holdfast.calibration.imu_noise import imu_noise
from holdfast.calibration.lever_arms import lever_arms, with_estimated_arms
from holdfast.calibration.mountings import mountings
from holdfast.calibration.odometry_noise import odometry_noise
from holdfast.calibration.scales import scales
from holdfast.calibration.turn_joint import turn_joint
from holdfast.config.document import Path as KeyPath
from holdfast.config.document import value_at, yaml_text
from holdfast.config.edit import Change
from holdfast.config.model import Config
from holdfast.config.sensors import DriftingConfig, PositionConfig
from holdfast.errors import ConfigError, HoldfastError
from holdfast.printable import one_line
from holdfast.recording.source import Recording

MAX_ROUNDS, AT_REST = 5, 0.3  # sigmas by which nothing moves any more
JUDGED = frozenset(Family) - {Family.TURN_JOINT}
UNJUDGED = "it ended before held-out fixes could judge it"
Watch = Callable[[str, Recording], AbstractContextManager[Progress]]
"""Shows how far a recording has been read, given what is being done."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What a calibration found.

    Attributes:
        before: the configuration as it was.
        config: the configuration with what was found.
        text: the file of `config`: that of `before` with its comments, and one above each key that changed.
        estimates: each number before and after, with its sigma and why it was not written, if it was not.
        held_out: errors at held-out fixes, before and with one family after the other.
        recordings: names.
        rounds: runs over all recordings until no constant moved.
        failure: what ended it early; what held-out fixes could not judge any more is not written.
    """

    before: Config
    config: Config
    text: str
    estimates: Sequence[Estimated]
    held_out: Sequence[HeldOut]
    recordings: Sequence[str]
    rounds: int
    failure: HoldfastError | KeyboardInterrupt | None


def calibrated(
    recordings: Sequence[str],
    given: AnyConfig,
    *,
    with_lever_arms: bool = False,
    every: int = 10,
    watch: Watch = lambda _title, _recording: nullcontext(),
) -> Calibration:
    """Calibrate the sensors of a machine from recordings of it.

    Args:
        recordings: paths.
        given: the configuration that all of them have.
        with_lever_arms: estimate lever arms of antennas, too.
        every: n-th fix that is held out, to judge by.
        watch: shows progress.

    Raises:
        ConfigError: the configuration holds mistakes, or an argument is wrong.
        RecordingError: a recording cannot be read.
        EstimatorError: the estimator never started in one of them; says why.
        KeyboardInterrupt: as it came.

    What ends it once something was found is not raised but in what is returned.
    """
    if not recordings:
        raise ConfigError("recordings: must name at least one recording")
    paths = [Path(one).resolve() for one in recordings]
    if twice := [one for one, path in zip(recordings, paths, strict=True) if paths.count(path) > 1]:
        raise ConfigError(f"{twice[0]}: is given twice, and would count twice")
    if every < 2:
        raise ConfigError(f"hold_out: must be an integer >= 2, not {every}")
    work = _Work(Draft.of(given), _Runs(recordings, every, watch))
    failure: HoldfastError | KeyboardInterrupt | None = None
    try:
        work.find_constants()
        work.find_noise(with_lever_arms)
        work.judge()
    except (HoldfastError, KeyboardInterrupt) as error:
        if not work.found:
            raise
        failure = error
    return work.result(failure)


@dataclass(frozen=True, slots=True)
class _Runs:
    """Runs over all recordings."""

    recordings: Sequence[str]
    every: int
    watch: Watch

    @property
    def names(self) -> list[str]:
        """What the recordings are called."""
        return [one_line(Path(one).name) for one in self.recordings]

    def run(
        self, title: str, config: Config, ignored: Sequence[str] = (), durations_s: Sequence[float | None] = ()
    ) -> list[Evidence]:
        """Run under a configuration; with the durations of the recordings, outages are cut into them."""
        spans = durations_s or [None for _ in self.recordings]
        return [
            gather(
                path,
                config,
                [rule for rule in rules_of(config, self.every, span) if rule.sensor not in ignored],
                ignored=ignored,
                watch=lambda recording: self.watch(title, recording),
            )
            for path, span in zip(self.recordings, spans, strict=True)
        ]


class _Work:
    """A calibration under way; what it has found when it is interrupted stays."""

    def __init__(self, draft: Draft, runs: _Runs) -> None:
        self.draft, self.runs = draft, runs
        self.found: list[Found] = []  # of which `judge` takes one after the other
        self.evidence: list[Evidence] = []  # the runs that tell the constants
        self.rounds = 0
        self._accepted = draft
        self._rows: list[Estimated] = []
        self._verdicts: list[HeldOut] = []

    def find_constants(self) -> None:
        """Find clocks, mountings and scales, until they have come to rest."""
        now, before = self.draft, list[float]()
        for _ in range(MAX_ROUNDS):
            evidence = self.runs.run(f"round {self.rounds + 1}", now.config)
            found = [family(evidence, self.draft.config, now.config) for family in (clocks, mountings, scales)]
            self.found, self.evidence, self.rounds = found, evidence, self.rounds + 1
            written = [one for family in found for one in family.estimates if one.is_written]
            now = self.draft.changed([change for family in found for change in family.changes])
            values = [one.after / one.sigma for one in written]
            is_same = len(values) == len(before)
            if not written or (is_same and all(abs(a - b) < AT_REST for a, b in zip(values, before, strict=True))):
                break
            before = values

    def find_noise(self, with_lever_arms: bool) -> None:
        """Find the turn joint, lever arms if they are asked for, and noise."""
        config = self.draft.config
        now = self.draft.changed([change for one in self.found[:2] for change in one.changes])
        self.found += [turn_joint(self.evidence, config), imu_noise(self.evidence, config)]
        if with_lever_arms:
            free, resting = with_estimated_arms(now.config)
            self.found.append(lever_arms(self.runs.run("lever arms", free, resting), config, free))
        self.found.append(fix_noise(self.evidence, config))
        odometries = config.sensors_of(DriftingConfig)
        if odometries and any(isinstance(one, PositionConfig) for one in config.sensors.values()):
            self.found.append(odometry_noise(self.runs.run("odometry noise", now.config, list(odometries)), config))

    def judge(self) -> None:
        """Accept every family that held-out fixes do not speak against."""
        durations = [one.duration_s for one in self.evidence]
        if any(_is_judged(one) for one in self.found):
            before = self.runs.run("held out: before", self.draft.config, (), durations)
            self._verdicts.append(held_out("as configured", before))
        while self.found:
            one = self.found[0]
            if not _is_judged(one):
                self._accept(one)
            else:
                tried, family = self._accepted.changed(self._commented(one)), one.estimates[0].family
                runs = self.runs.run(f"held out: {family}", tried.config, (), durations)
                verdict = held_out(f"with {family}", runs)
                if why := is_worse(self._verdicts[-1], verdict):
                    self._rows += [row.kept(why) for row in one.estimates]
                else:
                    self._accept(one)
                    self._verdicts.append(verdict)
            del self.found[0]

    def result(self, failure: HoldfastError | KeyboardInterrupt | None) -> Calibration:
        """Return what was found; a family that held-out fixes could not judge any more is not written."""
        for one in self.found:
            if _is_judged(one):
                self._rows += [row.kept(UNJUDGED) for row in one.estimates]
            else:
                self._accept(one)
        after = self._accepted
        return Calibration(
            self.draft.config,
            after.config,
            after.written(),
            self._rows,
            self._verdicts,
            self.runs.names,
            self.rounds,
            failure,
        )

    def _accept(self, found: Found) -> None:
        self._accepted = self._accepted.changed(self._commented(found))
        self._rows += found.estimates

    def _commented(self, found: Found) -> list[Change]:
        """Return the changes with comments that say from, to, sigma and recording."""
        names = self.runs.names
        source = ", ".join(names[:3]) + f" and {len(names) - 3} more" * (len(names) > 3)
        return [change._replace(comment=_comment(self.draft, found, change, source)) for change in found.changes]


def _is_judged(found: Found) -> bool:
    return bool(found.changes) and found.estimates[0].family in JUDGED


def _comment(draft: Draft, found: Found, change: Change, source: str) -> str:
    rows = [row for row in found.estimates if row.is_written and _belongs(row.path, change.path)]
    sigmas = " ".join(f"{row.sigma:.2g}" for row in rows)
    unit = f" {rows[0].unit}" if rows else ""
    old = value_at(draft.data, change.path)
    default = f"default {rows[0].before:.4g}" if len(rows) == 1 else "default"
    before = default if old is None else yaml_text(old)
    return f"calibrated: {before} -> {yaml_text(change.value)}{unit}, sigma {sigmas}, from {source}"


def _belongs(row: KeyPath, change: KeyPath) -> bool:
    return row == change or (row[0] == change[0] and row[0] in ("extrinsics", "turn_joint") and row[:-1] == change[:-1])
