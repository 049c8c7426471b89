"""`holdfast.replay` and `holdfast.smooth`: a recording in, arrays out."""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from holdfast.api.kept import Kept
from holdfast.api.progress import shown
from holdfast.api.result import Result
from holdfast.api.session import Session, run
from holdfast.arguments import check_count, check_flag, check_seconds, path_of
from holdfast.calibration.learnt_file import check_learnt_file
from holdfast.config.load import config_of, load_config
from holdfast.config.model import Config
from holdfast.config.review import check_possible
from holdfast.errors import ConfigError
from holdfast.events import Event, EventKind
from holdfast.measured_fields import got, has_double, is_number
from holdfast.output_folder import naming_the_output, replaced
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import available, subscriptions
from holdfast.replay.held_out import HoldOut, check_sensors
from holdfast.replay.results import read_events
from holdfast.smoothing.batch_smoother import OVERLAP_S, WINDOW_S, check_lengths

AnyPath = str | PathLike[str]
AnyConfig = Config | Mapping[str, Any] | AnyPath


def replay(
    recording: AnyPath,
    config: AnyConfig,
    *,
    hold_out: Mapping[str, int] | None = None,
    outage: Mapping[str, tuple[float, float]] | None = None,
    start_s: float = 0.0,
    duration_s: float | None = None,
    output: AnyPath | None = None,
    strict: bool = False,
    progress: bool = False,
    learnt: AnyPath | None = None,
) -> Result:
    """Run the estimator over a recording, as it would have run on the machine.

    Args:
        recording: a bag, an MCAP, a folder of CSV files, or `kitti`.
        config: a file, what such a file holds, or a `Config`.
        hold_out: `{"gnss": 2}` keeps every second fix from the estimator, which is judged by it: `summary["held_out"]`.
        outage: `{"gnss": (120.0, 180.0)}` keeps all of this time [s since the first message].
        start_s: skips the beginning of the recording [s].
        duration_s: takes only so much of it [s].
        output: folder for the files that `holdfast replay` writes; it is replaced as a whole, and one that holds
            anything else is refused. Without it they go with the result.
        strict: refuse a recording that lacks a sensor; else `summary["missing"]` names those that are done without.
        progress: show how far it is.
        learnt: file of what earlier runs have learnt of the sensors: read if it is there, and written in the end.

    Raises:
        ConfigError: the configuration, or an argument, is wrong.
        RecordingError: the recording cannot be read.
        EstimatorError: the estimator never started; says why.
    """
    span_s = start_s, duration_s
    return _run(recording, config, hold_out, outage, span_s, output, strict, progress, None, learnt)


def smooth(
    recording: AnyPath,
    config: AnyConfig,
    *,
    hold_out: Mapping[str, int] | None = None,
    outage: Mapping[str, tuple[float, float]] | None = None,
    start_s: float = 0.0,
    duration_s: float | None = None,
    output: AnyPath | None = None,
    strict: bool = False,
    progress: bool = False,
    window_s: float = WINDOW_S,
    overlap_s: float = OVERLAP_S,
) -> Result:
    """Find the best trajectory of a whole recording: each state from all that was measured before and after it.

    Arguments and errors are those of `replay`, but for two: `window_s` is solved at once [s], with `overlap_s` of what
    follows it [s]; memory grows with both. `Result.smoothed` is the optimum, the rest that of the causal run from which
    it starts.
    """
    check_lengths(window_s, overlap_s)
    return _run(
        recording, config, hold_out, outage, (start_s, duration_s), output, strict, progress, (window_s, overlap_s)
    )


def _run(  # noqa: PLR0917 (of the two above)
    recording: AnyPath,
    config: AnyConfig,
    hold_out: Mapping[str, int] | None,
    outage: Mapping[str, tuple[float, float]] | None,
    span_s: tuple[float, float | None],
    output: AnyPath | None,
    strict: bool,
    progress: bool,
    batch_s: tuple[float, float] | None,
    learnt: AnyPath | None = None,
) -> Result:
    paths = {"recording": recording, "output": output, "learnt": learnt}
    for name, path in paths.items():
        if path is not None or name == "recording":
            path_of(name, path)
    for name, flag in (("strict", strict), ("progress", progress)):
        check_flag(name, flag)
    for name, seconds in zip(("start_s", "duration_s"), span_s, strict=True):
        if (name, seconds) != ("duration_s", None):
            check_seconds(name, seconds)
    loaded, kept = resolved(config), Kept()
    rules = _rules({} if hold_out is None else hold_out, {} if outage is None else outage, loaded)
    temporary: TemporaryDirectory[str] | None = None
    if output is None:
        temporary = TemporaryDirectory(prefix="holdfast-")
        output = temporary.name
    folder = Path(output)
    name = "replay" if batch_s is None else "smooth"
    if learnt is not None:
        check_learnt_file(Path(learnt), folder, [str(recording)])
    with open_recording(Path(recording)) as opened:
        wanted, missing = (subscriptions(loaded), {}) if strict else available(opened, loaded)
        session = Session(
            path=str(recording),
            config=loaded,
            folder=folder,
            messages=opened.read(wanted, *span_s),
            missing=missing,
            rules=rules,
            batch_s=batch_s,
            learnt=None if learnt is None else Path(learnt),
            on_output=kept.add,
            on_block=kept.add_block,
        )
        of_results = nullcontext() if temporary is not None else replaced(folder, name, [str(recording)])
        with naming_the_output(folder), of_results:
            done = run(session, opened, shown(opened.start_ns, opened.end_ns, progress))
            done.check_end()
    done.check_start(session)
    events = [_event(one) for one in read_events(done.causal)]
    return Result(kept.world(), kept.odometry(), kept.base(), kept.smoothed(), events, done.summary, folder, temporary)


def resolved(config: AnyConfig) -> Config:
    """Return the configuration that a path, plain data or a `Config` mean.

    Raises:
        ConfigError: it is none of them, or holds mistakes; the text has one line per mistake.
    """
    if isinstance(config, Config):
        return check_possible(config, "config")
    if isinstance(config, Mapping):
        return check_possible(config_of(dict(config), "config"), "config")
    if isinstance(config, str | PathLike):
        return check_possible(load_config(path_of("config", config)), str(config))
    raise ConfigError(f"config: must be a path, a dict or a Config, not {type(config).__name__}")


def _rules(hold_out: Mapping[str, int], outage: Mapping[str, tuple[float, float]], config: Config) -> list[HoldOut]:
    rules = []
    for name, given in (("hold_out", hold_out), ("outage", outage)):
        if not isinstance(given, Mapping):
            raise ConfigError(f"{name}: must be a dict by sensor, not {type(given).__name__}")
    for sensor, every in hold_out.items():
        check_count(f"hold_out[{sensor!r}]", every, 2)
        rules.append(HoldOut(sensor, every, given=f"hold_out[{sensor!r}]"))
    for sensor, span in outage.items():
        times = list(span) if isinstance(span, Sequence | np.ndarray) and not isinstance(span, str) else []
        if len(times) != 2 or not all(is_number(time_s) and has_double(time_s) for time_s in times):
            raise ConfigError(f"outage[{sensor!r}]: must be (start, end) [s], {got(span)}")
        start_s, end_s = map(float, times)
        if not 0.0 <= start_s < end_s:
            raise ConfigError(f"outage[{sensor!r}]: must start at 0 s or later, and end after it starts, not {span!r}")
        rules.append(HoldOut(sensor, None, start_s, end_s, f"outage[{sensor!r}]"))
    check_sensors(rules, config)
    return rules


def _event(one: Mapping[str, Any]) -> Event:
    return Event(one["stamp_ns"], EventKind(one["kind"]), one["sensor"], one["reason"], one.get("data", {}))
