"""measurements.csv: what became of each measurement, with its innovation; written as a replay goes, and read again.

A row per measurement that one state can explain, but for the IMU and the encoder. A measurement that is decided again
has another row: an empty cell leaves what an earlier one said, the last outcome counts.
"""

import csv
from collections.abc import Iterable
from math import isfinite
from pathlib import Path

import numpy as np

from holdfast.errors import RecordingError
from holdfast.evaluation.consistency import chi_square_quantile
from holdfast.event_log import MeasurementRecord
from holdfast.measured_fields import LIMIT_NS
from holdfast.recording.source import Closing
from holdfast.report.run_record import InnovationScore, Measurements

MEASUREMENTS = "measurements.csv"
COLUMNS = ("stamp_ns", "sensor", "outcome", "nis", "dof", "limit", "east_m", "north_m", "up_m")
HELD_OUT = "held_out"
PROBABILITY = 0.95  # of the bounds on an NIS
MAX_ROWS_PER_S = 50  # of one sensor and one outcome: a minute of a flood is no larger than a minute of a fast sensor


class MeasurementWriter(Closing):
    """Writes records as rows; of one sensor and one outcome at most `MAX_ROWS_PER_S` in each second of stamps."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w", encoding="utf-8", newline="")
        self._rows = csv.writer(self._file, lineterminator="\n")
        self._rows.writerow(COLUMNS)
        self._written: dict[tuple[str, str], tuple[int, int]] = {}  # second, and how many rows in it

    def write(self, records: Iterable[MeasurementRecord], outcome: str = "") -> None:
        """Write records; `outcome` stands in for theirs."""
        rows = [_row(record, outcome or record.outcome) for record in records if self._has_room(record, outcome)]
        self._rows.writerows(rows)

    def flush(self) -> None:
        """Let what was written reach the file."""
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _has_room(self, record: MeasurementRecord, outcome: str) -> bool:
        key, second = (record.sensor, outcome or record.outcome), record.stamp_ns // 1_000_000_000
        newest, count = self._written.get(key, (second - 1, 0))
        count = 1 if second > newest else count + 1
        self._written[key] = max(second, newest), count
        return count <= MAX_ROWS_PER_S


def _row(record: MeasurementRecord, outcome: str) -> list[str | int]:
    position = record.p_W_P
    where = ["", "", ""] if position is None else [f"{p:.4f}" if isfinite(p) else "" for p in position.tolist()]
    tested = [f"{value:.4g}" if isfinite(value) else "" for value in (record.nis, record.limit)]
    return [record.stamp_ns, record.sensor, str(outcome), tested[0], record.dof or "", tested[1], *where]


def read_measurements(file: Path) -> dict[str, Measurements]:
    """Read the measurements by sensor; a row that a killed run left unfinished is left out.

    Raises:
        RecordingError: there is no such file, or a row is none.
    """
    found: dict[str, dict[int, list[str]]] = {}
    try:
        with file.open(encoding="utf-8", newline="") as stream:
            rows = list(csv.reader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{file}: {(getattr(error, 'strerror', '') or str(error)).lower()}") from None
    if not rows or tuple(rows[0]) != COLUMNS:
        raise RecordingError(f"{file}:1: has other columns (allowed: {','.join(COLUMNS)})")
    for number, row in enumerate(rows[1:], start=2):
        try:
            stamp_ns, values = int(row[0]), [float(cell or "nan") for cell in row[3:]]
        except (IndexError, ValueError):
            values, stamp_ns = [], 0
        if len(values) != len(COLUMNS) - 3 or abs(stamp_ns) >= LIMIT_NS:
            if number == len(rows):
                break
            raise RecordingError(f"{file}:{number}: is no measurement")
        before = found.setdefault(row[1], {}).setdefault(stamp_ns, row)
        found[row[1]][stamp_ns] = [new or old for new, old in zip(row, before, strict=True)]
    return {sensor: _table(of) for sensor, of in found.items()}


def _table(rows: dict[int, list[str]]) -> Measurements:
    ordered = [rows[stamp_ns] for stamp_ns in sorted(rows)]
    values = np.array([[float(cell or "nan") for cell in row[3:]] for row in ordered])
    return Measurements(
        stamps_ns=np.array(sorted(rows), dtype=np.int64),
        outcomes=np.array([row[2] for row in ordered]),
        nis=values[:, 0],
        dof=np.nan_to_num(values[:, 1]).astype(np.int64),
        limit=values[:, 2],
        positions=values[:, 3:],
    )


def innovation_scores(sensor: str, of: Measurements) -> list[InnovationScore]:
    """Return how well innovations agree with their covariance: what the estimator tested, and what was held out.

    Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 5.4.
    """
    scores = []
    tested = np.isfinite(of.nis) & (of.dof > 0)
    for name, part in ((sensor, of.outcomes != HELD_OUT), (f"{sensor}, held out", of.outcomes == HELD_OUT)):
        chosen = tested & part
        if not chosen.any():
            continue
        dof = int(np.median(of.dof[chosen]))
        bound = chi_square_quantile(PROBABILITY, dof)
        used = chosen & np.isin(of.outcomes, ("used", HELD_OUT))
        mean, lower, upper = None, None, None
        if total := int(of.dof[used].sum()):
            mean = float(of.nis[used].sum()) / total
            lower, upper = (chi_square_quantile((1.0 + sign * PROBABILITY) / 2.0, total) / total for sign in (-1, 1))
        inside = float((of.nis[chosen] <= bound).mean())
        scores.append(InnovationScore(name, int(chosen.sum()), mean, lower, upper, bound, inside))
    return scores
