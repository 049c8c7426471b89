"""What an estimation over a recording gives to a notebook."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from holdfast.api.trajectory import Trajectory
from holdfast.arguments import path_of
from holdfast.events import Event
from holdfast.extras import needing


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """The results of one recording.

    Attributes:
        world: I in W at each sample of the IMU, as it was published: causal, it may jump.
        odometry: I in O, which never jumps.
        base: the chassis B in W; None where it is not known.
        smoothed: of `smooth` the optimum over the recording at each sample, with its covariances; of `replay` the nodes
            as they left the sliding window; None if there are none.
        events: what happened, in the order of time.
        summary: what `holdfast replay` writes to summary.json: counts, errors at held-out fixes, time.
        folder: of the files.
    """

    world: Trajectory
    odometry: Trajectory
    base: Trajectory | None
    smoothed: Trajectory | None
    events: Sequence[Event]
    summary: Mapping[str, Any]
    folder: Path
    _kept: TemporaryDirectory[str] | None = field(default=None, repr=False)  # as long as someone has the result

    def __repr__(self) -> str:
        """Return what it is on a few lines: a notebook shows it."""
        tracks = {name: getattr(self, name) for name in ("world", "odometry", "base", "smoothed")}
        shown = "".join(f"  {name}: {track}\n" for name, track in tracks.items())
        return f"Result(\n{shown}  events: {len(self.events)}\n  folder: {self.folder}\n)"

    def report(self, path: str | PathLike[str]) -> Path:
        """Write an HTML page about it, which needs no network; return its path.

        Raises:
            ConfigError: plotly is not installed, or the file cannot be written or does not end in .html.
        """
        given = path_of("path", path)
        with needing("a report", "report"):
            import plotly  # noqa: F401
        from holdfast.replay.results import read_run
        from holdfast.report.page import page_file, write_page
        from holdfast.report.single_run import single_run_page

        file = page_file(given)
        write_page(single_run_page(read_run(self.folder, None)), file)
        return file
