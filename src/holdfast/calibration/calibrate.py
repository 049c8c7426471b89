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
from holdfast.errors import ConfigError
from holdfast.printable import one_line
from holdfast.recording.source import Recording

MAX_ROUNDS, AT_REST = 5, 0.3  # sigmas by which nothing moves any more
JUDGED = frozenset(Family) - {Family.TURN_JOINT}
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
    """

    before: Config
    config: Config
    text: str
    estimates: Sequence[Estimated]
    held_out: Sequence[HeldOut]
    recordings: Sequence[str]
    rounds: int


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
    """
    if not recordings:
        raise ConfigError("recordings: must name at least one recording")
    paths = [Path(one).resolve() for one in recordings]
    if twice := [one for one, path in zip(recordings, paths, strict=True) if paths.count(path) > 1]:
        raise ConfigError(f"{twice[0]}: is given twice, and would count twice")
    if every < 2:
        raise ConfigError(f"hold_out: must be an integer >= 2, not {every}")
    draft = Draft.of(given)
    runs = _Runs(recordings, every, watch)
    found, evidence, rounds = _constants(draft, runs)
    found += [turn_joint(evidence, draft.config), imu_noise(evidence, draft.config)]
    now = draft.changed([change for one in found[:2] for change in one.changes])
    if with_lever_arms:
        config, resting = with_estimated_arms(now.config)
        found.append(lever_arms(runs.run("lever arms", config, resting), draft.config, config))
    found.append(fix_noise(evidence, draft.config))
    odometries = draft.config.sensors_of(DriftingConfig)
    if odometries and any(isinstance(one, PositionConfig) for one in draft.config.sensors.values()):
        found.append(odometry_noise(runs.run("odometry noise", now.config, list(odometries)), draft.config))
    names = [one_line(Path(one).name) for one in recordings]
    after, estimates, verdicts = _accepted(draft, _commented(draft, found, names), runs, evidence)
    return Calibration(draft.config, after.config, after.written(), estimates, verdicts, names, rounds)


@dataclass(frozen=True, slots=True)
class _Runs:
    """Runs over all recordings."""

    recordings: Sequence[str]
    every: int
    watch: Watch

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


def _constants(draft: Draft, runs: _Runs) -> tuple[list[Found], list[Evidence], int]:
    """Return clocks, mountings and scales once they have come to rest, and the runs that tell them."""
    now, before, evidence, found = draft, list[float](), list[Evidence](), list[Found]()
    for number in range(1, MAX_ROUNDS + 1):
        evidence = runs.run(f"round {number}", now.config)
        found = [family(evidence, draft.config, now.config) for family in (clocks, mountings, scales)]
        written = [one for family in found for one in family.estimates if one.is_written]
        now = draft.changed([change for family in found for change in family.changes])
        values = [one.after / one.sigma for one in written]
        is_same = len(values) == len(before)
        if not written or (is_same and all(abs(a - b) < AT_REST for a, b in zip(values, before, strict=True))):
            break
        before = values
    return found, evidence, number


def _commented(draft: Draft, found: Sequence[Found], names: Sequence[str]) -> list[Found]:
    """Return what was found with comments that say from, to, sigma and recording."""
    source = ", ".join(names[:3]) + f" and {len(names) - 3} more" * (len(names) > 3)
    return [
        one._replace(changes=[change._replace(comment=_comment(draft, one, change, source)) for change in one.changes])
        for one in found
    ]


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


def _accepted(
    draft: Draft, found: Sequence[Found], runs: _Runs, evidence: Sequence[Evidence]
) -> tuple[Draft, list[Estimated], list[HeldOut]]:
    """Return the draft with every family that held-out fixes do not speak against, and what they say."""
    durations = [one.duration_s for one in evidence]
    now = draft
    verdicts: list[HeldOut] = []
    if any(one.changes for one in found if one.estimates and one.estimates[0].family in JUDGED):
        verdicts.append(held_out("as configured", runs.run("held out: before", draft.config, (), durations)))
    rows: list[Estimated] = []
    for one in found:
        if not one.changes:
            rows += one.estimates
            continue
        family, tried = one.estimates[0].family, now.changed(one.changes)
        if family not in JUDGED:
            now, rows = tried, rows + list(one.estimates)
            continue
        verdict = held_out(f"with {family}", runs.run(f"held out: {family}", tried.config, (), durations))
        if why := is_worse(verdicts[-1], verdict):
            rows += [row.kept(why) for row in one.estimates]
        else:
            now, rows = tried, rows + list(one.estimates)
            verdicts.append(verdict)
    return now, rows, verdicts
