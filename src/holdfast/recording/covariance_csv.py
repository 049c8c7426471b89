"""The covariances of a trajectory in a file beside it: `track.tum` has `track.covariance.csv`."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from holdfast.covariances import SIZE, UPPER, Covariances
from holdfast.errors import RecordingError
from holdfast.measured_fields import LIMIT_NS
from holdfast.recording.plain_numbers import check_plain
from holdfast.recording.source import Closing

AXES = ("rx", "ry", "rz", "px", "py", "pz", "vx", "vy", "vz")
HEADER = ["stamp_ns", *(f"{AXES[i]}_{AXES[j]}" for i, j in zip(*UPPER, strict=True))]


def beside(track: Path) -> Path:
    """Return the name of the file that belongs to a trajectory."""
    return track.with_suffix(".covariance.csv")


def read_covariances(path: Path) -> Covariances:
    """Read the covariances of a trajectory.

    Raises:
        RecordingError: it cannot be read, or is none; names file and line.
    """
    stamps: list[int] = []
    rows: list[list[float]] = []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise RecordingError(f"{path}: {(error.strerror or str(error)).lower()}") from None
    except UnicodeDecodeError:
        raise RecordingError(f"{path}: is not UTF-8 text") from None
    if not lines or lines[0].split(",") != HEADER:
        raise RecordingError(f"{path}:1: is no table of covariances (allowed: that of `holdfast smooth`)")
    for number, line in enumerate(lines[1:], start=2):
        cells = line.split(",")
        try:
            check_plain(cells)
            stamps.append(int(cells[0]))
            rows.append([float(cell) for cell in cells[1:]])
        except ValueError:
            raise RecordingError(f"{path}:{number}: is not made of numbers") from None
        if abs(stamps[-1]) >= LIMIT_NS:
            raise RecordingError(f"{path}:{number}: has a stamp beyond 292 years")
        if len(cells) != len(HEADER):
            raise RecordingError(f"{path}:{number}: has {len(cells)} columns (allowed: {len(HEADER)})")
    if not rows:
        raise RecordingError(f"{path}: holds no covariances")
    return Covariances.of_triangles(
        np.array(stamps, dtype=np.int64), np.array(rows).reshape(-1, SIZE * (SIZE + 1) // 2)
    )


class CovarianceWriter(Closing):
    """Writes covariances block by block; of one time, the first."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w", encoding="utf-8")
        self._file.write(",".join(HEADER) + "\n")
        self._newest_ns: int | None = None

    def extend(self, covariances: Covariances) -> None:
        """Write covariances that are later than those before."""
        self._file.writelines(self._lines(covariances))
        self._file.flush()

    def _lines(self, covariances: Covariances) -> Iterable[str]:
        for stamp_ns, row in zip(covariances.times_ns.tolist(), covariances.triangles().tolist(), strict=True):
            if self._newest_ns is None or stamp_ns > self._newest_ns:
                self._newest_ns = stamp_ns
                yield f"{stamp_ns}," + ",".join(f"{value:.9g}" for value in row) + "\n"

    def close(self) -> None:
        """Close the file."""
        self._file.close()
