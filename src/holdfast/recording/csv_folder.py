"""A folder of CSV files, one per topic: the file's stem is the topic, its header names columns with their units.

The format is documented in docs/recordings.md; the header of EuRoC's IMU files is understood as well.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import islice
from math import nan
from pathlib import Path

from holdfast.errors import RecordingError
from holdfast.measured_fields import is_stamp
from holdfast.messages import Message
from holdfast.printable import one_line, quoted
from holdfast.recording.columns import Columns
from holdfast.recording.decode import UndecodableError
from holdfast.recording.kinds import KINDS
from holdfast.recording.merge import SkippedMessages
from holdfast.recording.plain_numbers import check_plain
from holdfast.recording.source import TopicInfo
from holdfast.recording.stamp_units import Stamps, check_units
from holdfast.recording.tracks import TrackRecording, last_line

STAMP, ARRIVAL = "stamp_ns", "arrival_ns"
FEWEST_LINES, MOST_LINES = 20, 1000  # of the beginning of a file, by which its pace is known
ABSENT = -1
"""Index of an optional column that a file has not: behind the cells of every line stands `nan`."""
EUROC = {
    "timestamp": STAMP,
    **{f"w_RS_S_{axis}": f"w{axis}_rad_s" for axis in "xyz"},
    **{f"a_RS_S_{axis}": f"a{axis}_m_s2" for axis in "xyz"},
}


def open_files(path: Path, files: Sequence[Path]) -> TrackRecording:
    """Open a folder of CSV files; those without any column that is known are left out with a warning.

    Raises:
        RecordingError: a header or the first line of a file cannot be read, no file has a line, or stamps are in
            another unit.
    """
    tracks: list[CsvTrack] = []
    foreign: list[_ForeignFileError] = []
    for file in files:
        try:
            tracks.append(CsvTrack(file))
        except _ForeignFileError as error:
            foreign.append(error)
    if not tracks:
        raise foreign[0]
    check_units([stamps for track in tracks for stamps in track.stamps()])
    recording = TrackRecording(path, tracks)
    recording.warnings += [f"{error}; the file is left out" for error in foreign]
    return recording


class _ForeignFileError(RecordingError):
    """A CSV file that has nothing to do with Holdfast."""


class CsvTrack:
    """One CSV file; see `holdfast.recording.tracks.Track`. It can be of every kind whose columns it has.

    Raises:
        RecordingError: the header names columns that are unknown or misses some; or the first line cannot be read.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        with file.open(encoding="utf-8-sig", errors="replace") as stream:
            header = stream.readline()
        self._names = [_column_name(name) for name in header.split(",")]
        self._columns = _fitting_columns(self._names, f"{file}:1")
        self.kinds = tuple(self._columns)
        self._stamp = self._names.index(STAMP)
        self._arrival = self._names.index(ARRIVAL) if ARRIVAL in self._names else self._stamp
        self.start_ns = next((self._times(cells, line)[1] for line, cells, _ in self._lines()), None)
        last = None if self.start_ns is None else self._last_times()
        self.end_ns = None if last is None else last[1]
        self.info = TopicInfo(one_line(file.stem), KINDS[self.kinds[0]].csv_type, 0 if self.start_ns is None else None)

    def messages(self, kind: str, sensor: str, skipped: SkippedMessages, warnings: list[str]) -> Iterator[Message]:
        """Read the file line by line; see `Track.messages`. A last line that was cut off is a warning."""
        columns = self._columns[kind]
        indices = [self._names.index(name) if name in self._names else ABSENT for name in columns.names]
        for line, cells, whole in self._lines():
            try:
                stamp_ns, arrival_ns = self._times(cells, line)
                values = self._parse([*cells, "nan"], indices, columns, line)
            except RecordingError as error:
                if whole:
                    raise
                warnings.append(f"{error}; the line is the last one and was cut off, so it is left out")
                return
            try:
                yield columns.build(stamp_ns, arrival_ns, sensor, values)
            except UndecodableError as error:
                skipped.add(self.info.topic, arrival_ns, error)

    def stamps(self) -> list[Stamps]:
        """Return what its columns of times hold; nothing of a file without lines."""
        head = list(self._first_times())
        if not head:
            return []
        (stamps, arrivals), (stamp_ns, arrival_ns) = zip(*head, strict=True), self._last_times() or head[-1]
        pace = (stamps[-1] - stamps[0]) / (len(head) - 1) if len(head) >= FEWEST_LINES else None
        found = [Stamps(str(self.file), STAMP, stamps[0], stamp_ns, pace)]
        if ARRIVAL in self._names:  # which may come in bursts
            found.append(Stamps(str(self.file), ARRIVAL, arrivals[0], arrival_ns, None))
        return found

    def _first_times(self) -> Iterator[tuple[int, int]]:
        """Yield the times of the first lines, as far as they can be read."""
        with suppress(RecordingError):  # whoever reads the file names the line
            for line, cells, _ in islice(self._lines(), MOST_LINES):
                yield self._times(cells, line)

    def _last_times(self) -> tuple[int, int] | None:
        try:
            return self._times(last_line(self.file).split(","), 0)
        except RecordingError:  # it was cut off
            return None

    def _lines(self) -> Iterator[tuple[int, list[str], bool]]:
        """Yield the line's number, its cells, and whether it ends as a line should."""
        with self.file.open(encoding="utf-8-sig", errors="replace") as stream:
            next(stream)
            for number, line in enumerate(stream, start=2):
                if line.strip() and line[0] != "#":
                    yield number, line.split(","), line.endswith("\n")

    def _times(self, cells: list[str], line: int) -> tuple[int, int]:
        if len(cells) != len(self._names):
            raise RecordingError(
                f"{self.file}:{line}: has {len(cells)} columns (allowed: {len(self._names)}, as above)"
            )
        try:
            check_plain((cells[self._stamp], cells[self._arrival]))
            stamp_ns, arrival_ns = int(cells[self._stamp]), int(cells[self._arrival])
            if is_stamp(stamp_ns) and is_stamp(arrival_ns):
                return stamp_ns, arrival_ns
        except ValueError:
            pass
        bad = STAMP if not _is_stamp(cells[self._stamp]) else ARRIVAL
        text = cells[self._names.index(bad)].strip()
        raise RecordingError(
            f"{self.file}:{line}: column {bad} is {quoted(text)!r} (allowed: a whole number of nanoseconds in 64 bits)"
        )

    def _parse(self, cells: list[str], indices: list[int], columns: Columns, line: int) -> list[float]:
        try:
            check_plain(cells)
            return [float(cells[index]) for index in indices]
        except ValueError:
            named = zip(columns.names, indices, strict=True)
            return [self._parse_cell(cells[index].strip(), name, columns, line) for name, index in named]

    def _parse_cell(self, text: str, name: str, columns: Columns, line: int) -> float:
        may_be_empty = name not in columns.required
        if not text and may_be_empty:
            return nan
        try:
            check_plain((text,))
            return float(text)
        except ValueError:
            raise RecordingError(
                f"{self.file}:{line}: column {name} is {quoted(text)!r} (allowed: a number"
                + (" or nothing)" if may_be_empty else ", nan if it is unknown)")
            ) from None


def _fitting_columns(header: Sequence[str], place: str) -> dict[str, Columns]:
    """Return the kinds that a file with this header can be, the first one being what it is without a configuration.

    Raises:
        RecordingError: there is none; the text names what is wrong with the nearest one.
    """
    layouts = {kind.name: kind.columns for kind in KINDS.values() if kind.columns is not None}
    fitting = {name: columns for name, columns in layouts.items() if _fault(header, columns) is None}
    if fitting:
        return fitting
    name, nearest = max(layouts.items(), key=lambda item: _likeness(header, item[1]))
    if not set(header) & set(nearest.required):
        distinct = dict.fromkeys(", ".join(columns.required) for columns in layouts.values())
        raise _ForeignFileError(
            f"{place}: the header names no known column (allowed: {STAMP} and one of {'; '.join(distinct)})"
        )
    allowed = ", ".join((STAMP, *nearest.required, ARRIVAL, *nearest.names[len(nearest.required) :]))
    raise RecordingError(f"{place}: {_fault(header, nearest)} (a file of kind {name} may have {allowed})")


def _likeness(header: Sequence[str], columns: Columns) -> tuple[bool, int]:
    """Return a key that is greatest for the columns that a header most likely means."""
    known = len(set(header) & set(columns.names))
    return known > 0, known - len(columns.missing(header))


def _fault(header: Sequence[str], columns: Columns) -> str | None:
    """Return what keeps a header from being that of a file with these columns, None if nothing does."""
    missing = [name for name in (STAMP,) if name not in header] + columns.missing(header)
    if missing:
        return f"column {missing[0]} is missing"
    known = {STAMP, ARRIVAL, *columns.names}
    unknown = [name for name in header if name not in known or header.count(name) > 1]
    return f"column {quoted(unknown[0])!r} is unknown or there twice" if unknown else None


def _column_name(text: str) -> str:
    """Return a column's name; EuRoC's `#timestamp [ns]` and `w_RS_S_x [rad s^-1]` are translated."""
    bare = re.sub(r"\s*\[.*\]\s*$", "", text.strip()).lstrip("# ")
    return EUROC.get(bare, text.strip().lstrip("# "))


def _is_stamp(text: str) -> bool:
    try:
        check_plain((text,))
        return is_stamp(int(text))
    except ValueError:
        return False
