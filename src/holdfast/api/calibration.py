"""`holdfast.calibrate`: recordings of one machine in, a configuration that fits them out."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from holdfast.api.progress import shown
from holdfast.arguments import check_count, check_flag, path_of
from holdfast.calibration.calibrate import Calibration as Found
from holdfast.calibration.calibrate import calibrated
from holdfast.calibration.estimated import Estimated
from holdfast.calibration.evidence import Progress
from holdfast.calibration.held_out import HeldOut
from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.extras import needing
from holdfast.recording.source import Recording
from holdfast.whole_file import write_whole

AnyPath = str | PathLike[str]


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What recordings say of a configuration.

    Attributes:
        config: with what was found.
        text: the same as a file: that which was given, with its comments, and one above each key that changed.
        estimates: each number before and after, with `sigma`, `prior`, `is_observable`, `is_written` and `reason`.
        held_out: errors at held-out fixes, before and with one family of numbers after the other.
    """

    config: Config
    text: str
    estimates: Sequence[Estimated]
    held_out: Sequence[HeldOut]
    _found: Found

    def save(self, path: AnyPath) -> Path:
        """Write the configuration; return its path.

        Raises:
            ConfigError: it cannot be written.
        """
        file = path_of("path", path)
        write_whole(file, self.text)
        return file

    def report(self, path: AnyPath) -> Path:
        """Write an HTML page about it, which needs no network; return its path.

        Raises:
            ConfigError: plotly is not installed, or the file cannot be written or does not end in .html.
        """
        with needing("a report", "report"):
            from holdfast.calibration.page import calibration_page
        from holdfast.report.page import page_file, write_page

        file = page_file(path_of("path", path))
        write_page(calibration_page(self._found, "holdfast.calibrate"), file)
        return file


def calibrate(
    recordings: AnyPath | Sequence[AnyPath],
    config: Config | Mapping[str, Any] | AnyPath,
    *,
    lever_arms: bool = False,
    hold_out: int = 10,
    progress: bool = False,
) -> Calibration:
    """Find clocks, mountings, the encoder's zero, noise and drift of a machine's sensors from recordings of it.

    Args:
        recordings: one or several, as `replay` takes them, all made with this configuration.
        config: a file, what such a file holds, or a `Config`.
        lever_arms: estimate the lever arms of the antennas, too.
        hold_out: every n-th fix is kept back, to judge by it what was found.
        progress: show how far it is.

    Raises:
        ConfigError: the configuration, or an argument, is wrong.
        RecordingError: a recording cannot be read.
        EstimatorError: the estimator never started; says why.
    """
    if not isinstance(recordings, str | PathLike | Iterable):
        raise ConfigError(f"recordings: must be a path or several, not {type(recordings).__name__}")
    paths = [recordings] if isinstance(recordings, str | PathLike) else list(recordings)
    for path in paths:
        path_of("recordings", path)
    check_count("hold_out", hold_out, 2)
    for name, flag in (("lever_arms", lever_arms), ("progress", progress)):
        check_flag(name, flag)

    @contextmanager
    def watch(_title: str, opened: Recording) -> Iterator[Progress]:
        with shown(opened.start_ns, opened.end_ns, progress) as show:
            yield show

    found = calibrated([str(path) for path in paths], config, with_lever_arms=lever_arms, every=hold_out, watch=watch)
    if found.failure is not None:
        raise found.failure
    return Calibration(found.config, found.text, found.estimates, found.held_out, found)
