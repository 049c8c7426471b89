"""Trajectories in the TUM format: `t x y z qx qy qz qw` per line, seconds and metres, `#` begins a comment."""

from array import array
from collections.abc import Sequence
from decimal import Decimal
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import RecordingError
from holdfast.recording.plain_numbers import check_plain
from holdfast.recording.source import Closing
from holdfast.state import Trajectory

NORM_TOLERANCE = 0.01
NS_PER_S = 1_000_000_000
LIMIT_S = Decimal(2**63) / NS_PER_S
ROW, CELLS = b"%b%d.%09d" + b" %.9f" * 7 + b"\n", 10
ROWS_PER_WRITE = 256
BUFFER_BYTES = 1 << 16
"""More than ROWS_PER_WRITE rows, so that only whole rows reach the file."""


def read_tum(path: str | Path) -> Trajectory:
    """Read a trajectory; stamps keep every digit because they never pass through float64.

    Raises:
        RecordingError: a line is malformed, the stamps do not increase or there is no pose; names file and line.
    """
    path = Path(path)
    stamps, rows = array("q"), array("d")  # an hour at 100 Hz in 23 MB
    try:
        stream = path.open(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise RecordingError(f"{path}: {(error.strerror or str(error)).lower()}") from None
    with stream:
        for number, line in enumerate(stream, start=1):
            cells = line.split()
            if not cells or cells[0].startswith("#"):
                continue
            stamp_ns, row = _parse(cells, f"{path}:{number}")
            if stamps and stamp_ns <= stamps[-1]:
                raise RecordingError(f"{path}:{number}: stamp {cells[0]} is not later than the one before it")
            stamps.append(stamp_ns)
            rows.extend(row)
    if not rows:
        raise RecordingError(f"{path}: holds no poses (allowed: lines of t x y z qx qy qz qw)")
    values = np.array(rows).reshape(-1, 7)
    quaternions = values[:, 3:] / np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    return Trajectory(np.array(stamps, dtype=np.int64), values[:, :3], quaternions)


def _parse(cells: list[str], place: str) -> tuple[int, list[float]]:
    if len(cells) != 8:
        found = f"{len(cells)} column{'s' * (len(cells) != 1)}"
        spaces = " with spaces between them" if "," in cells[0] or ";" in cells[0] else ""
        raise RecordingError(f"{place}: has {found} (allowed: 8{spaces}, t x y z qx qy qz qw)")
    try:
        check_plain(cells)
        stamp_s = Decimal(cells[0])
        if not stamp_s.copy_abs() < LIMIT_S:  # to make an integer of 1e999999999 takes forever
            reason = "has a number that is not finite or a stamp beyond 292 years"
            raise RecordingError(f"{place}: {reason} (allowed: seconds)")
        stamp_ns = int(stamp_s.scaleb(9).to_integral_value())
        row = [float(cell) for cell in cells[1:]]
    except (ValueError, ArithmeticError):  # a stamp of 1e999999 overflows Decimal
        raise RecordingError(f"{place}: is not made of 8 numbers") from None
    if not all(map(isfinite, row)):
        raise RecordingError(f"{place}: has a number that is not finite")
    norm = float(np.sqrt(np.square(row[3:]).sum()))
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise RecordingError(f"{place}: quaternion has norm {norm:.3g} (allowed: 1, in the order x y z w)")
    return stamp_ns, row


def write_tum(path: str | Path, trajectory: Trajectory) -> None:
    """Write a trajectory with 9 decimals."""
    with TumWriter(path) as writer:
        writer.extend(trajectory.stamps_ns.tolist(), trajectory.positions, trajectory.quaternions)


class TumWriter(Closing):
    """Writes a trajectory block by block; a killed run keeps what `extend` was given, and no half row."""

    def __init__(self, path: str | Path) -> None:
        self._file = Path(path).open("wb", buffering=BUFFER_BYTES)  # noqa: SIM115 (closed by close)

    def extend(self, stamps_ns: Sequence[int], positions: ArrayLike, quaternions_xyzw: ArrayLike) -> None:
        """Write poses: stamps (N,), positions (N, 3) [m], quaternions (N, 4) x, y, z, w."""
        rows = np.hstack([np.reshape(positions, (-1, 3)), np.reshape(quaternions_xyzw, (-1, 4))])
        for begin in range(0, len(rows), ROWS_PER_WRITE):
            block = slice(begin, begin + ROWS_PER_WRITE)
            cells: list[bytes | float] = []
            for stamp_ns, row in zip(stamps_ns[block], rows[block].tolist(), strict=True):
                cells += (b"-" if stamp_ns < 0 else b"", *divmod(abs(stamp_ns), NS_PER_S), *row)
            self._file.write(ROW * (len(cells) // CELLS) % tuple(cells))
            self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
