"""The results, as frozen values; `load` reads what `holdfast paper` wrote."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from math import isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.errors import ConfigError
from holdfast.evaluation.absolute import Statistics
from holdfast.messages import Array
from holdfast.whole_file import whole, write_whole

RESULTS, CURVES = "results.json", "curves.npz"
FORMAT = 2


@dataclass(frozen=True, slots=True)
class Growth:
    """The errors of a system `after_s` into an outage of GNSS."""

    after_s: float
    horizontal_m: float
    vertical_m: float
    heading_deg: float


@dataclass(frozen=True, slots=True)
class OutageScore:
    """One outage: RMS within it, and the recovery; as in `holdfast.evaluation.outages.Outage`."""

    start_s: float
    end_s: float
    horizontal_rms_m: float
    vertical_rms_m: float
    heading_rms_deg: float
    alone_horizontal_rms_m: float
    settled_s: float
    regained_s: float


@dataclass(frozen=True, slots=True)
class Run:
    """One system on one recording.

    Attributes:
        study: accuracy, ablation, sensitivity or growth.
        scenario: of the simulator, shortened if the results are quick.
        variation: name of the change of the configuration; empty for none.
        sensor: kind of sensor whose messages were disturbed by `delay_s` and `clock_s`; empty for none.
        failure: why there is no verdict; empty if there is one.
        scores: of `holdfast.evaluation.scenario.judge`.
        errors: statistics by part and quantity, such as `good/horizontal_m`: parts are good (GNSS is), outage and all;
            quantities position_m, horizontal_m, velocity_m_s (lengths), vertical_m, heading_deg (signed), all against
            truth, and of `good` also rtk_m (length) and rtk_axes_m (signed, all axes): against the fixes.
        corrections_m: |propagated - optimised| (paper, Fig. 6); None for a system without updates.
        imu_us: time per IMU sample that no update follows.
        update_ms: time per IMU sample or message with an update.
        outcomes: number of measurements by sensor and outcome.
        events: (seconds, kind, sensor, reason), but for single rejected measurements.
    """

    study: str
    scenario: str
    seed: int
    system: str
    variation: str = ""
    sensor: str = ""
    delay_s: float = 0.0
    clock_s: float = 0.0
    failure: str = ""
    duration_s: float = 0.0
    real_time_factor: float = nan
    scores: Mapping[str, float] = field(default_factory=dict)
    errors: Mapping[str, Statistics] = field(default_factory=dict)
    corrections_m: Statistics | None = None
    imu_us: Mapping[str, float] | None = None
    update_ms: Mapping[str, float] | None = None
    outages: tuple[OutageScore, ...] = ()
    growth: tuple[Growth, ...] = ()
    outcomes: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    events: tuple[tuple[float, str, str, str], ...] = ()

    @property
    def name(self) -> str:
        """Name of its curves: scenario, seed and system."""
        return f"{self.scenario}-{self.seed}-{self.system}"


@dataclass(frozen=True, slots=True)
class Latency:
    """Times of one system, all systems fed in turn with the same messages in one process.

    Attributes:
        imu_us: from an IMU sample to the propagated state: count, mean, std, median, p99, max. None if there is none.
        imu_cpu_us: the same, but without the time that other programs took meanwhile.
        every_cpu_us: the same of every IMU sample, also of those on which measurements are taken in.
        update_ms: of a call that takes in measurements as well.
        quantiles_us: (quantile, time per IMU sample) for a figure.
    """

    system: str
    imu_us: Mapping[str, float] | None
    imu_cpu_us: Mapping[str, float] | None
    every_cpu_us: Mapping[str, float] | None
    update_ms: Mapping[str, float] | None
    quantiles_us: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """Everything that `holdfast paper` found.

    Attributes:
        command: that made it.
        quick: short recordings.
        seeds: of each of the paper's tasks.
        machine: what the times depend on.
        versions: of the packages that the numbers depend on.
        scenarios: the resolved scenarios as YAML, by name.
        tunings: of the baselines.
        latency_scenario: what the latency was measured on, and for how long.
        curves: by name of the run, then by name of the column; `time_s` and the like have up to 2000 rows.
    """

    command: str
    quick: bool
    seeds: int
    machine: Mapping[str, Any]
    versions: Mapping[str, str]
    scenarios: Mapping[str, str]
    tunings: Mapping[str, Mapping[str, Any]]
    runs: tuple[Run, ...]
    latency: tuple[Latency, ...] = ()
    latency_scenario: str = ""
    curves: Mapping[str, Mapping[str, Array]] = field(default_factory=dict)

    def of(self, study: str, scenario: str = "", system: str = "", variation: str | None = None) -> list[Run]:
        """Return the runs of a study that have a verdict, by seed."""
        return [
            run
            for run in self.runs
            if run.study == study
            and not run.failure
            and scenario in ("", run.scenario)
            and system in ("", run.system)
            and variation in (None, run.variation)
        ]


def save(results: Results, folder: Path) -> None:
    """Write results.json and curves.npz.

    Raises:
        ConfigError: a file cannot be written.
    """
    plain = {"format": FORMAT} | {f.name: to_json(getattr(results, f.name)) for f in fields(Results)}
    del plain["curves"]
    write_whole(folder / RESULTS, json.dumps(plain, indent=1))
    columns = {f"{run}/{name}": values for run, table in results.curves.items() for name, values in table.items()}
    write_columns(folder / CURVES, columns)


def write_columns(path: Path, columns: Mapping[str, Array]) -> None:
    """Write arrays by name, whole or not at all.

    Raises:
        ConfigError: the file cannot be written.
    """
    with whole(path) as part, part.open("wb") as file:
        np.savez_compressed(file, **columns)  # type: ignore[arg-type]  # the stubs take the names for keywords


def load(folder: str | Path) -> Results:
    """Read what `holdfast paper -o FOLDER` wrote.

    Raises:
        ConfigError: there are no results, or they are of another version.
    """
    path = Path(folder) / RESULTS
    try:
        plain = json.loads(path.read_text(encoding="utf-8"))
        with np.load(Path(folder) / CURVES) as archive:
            columns = {name: archive[name] for name in archive.files}
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: holds no results of `holdfast paper` ({error})") from None
    if not isinstance(plain, dict) or plain.pop("format", None) != FORMAT:
        raise ConfigError(f"{path}: was written by another version of Holdfast; run `holdfast paper` again")
    curves: dict[str, dict[str, Array]] = {}
    for name, values in columns.items():
        run, _, column = name.rpartition("/")
        curves.setdefault(run, {})[column] = values
    runs = tuple(run_from_json(run) for run in plain.pop("runs"))
    latency = tuple(latency_from_json(one) for one in plain.pop("latency"))
    return Results(**plain, runs=runs, latency=latency, curves=curves)


def run_from_json(plain: Mapping[str, Any]) -> Run:
    """Return a run from its JSON; numbers that JSON does not have come back as NaN or infinity."""
    known = dict(plain)
    known["scores"] = {name: _number(value) for name, value in plain["scores"].items()}
    known["errors"] = {name: Statistics(**value) for name, value in plain["errors"].items()}
    known["corrections_m"] = None if plain["corrections_m"] is None else Statistics(**plain["corrections_m"])
    known["outages"] = tuple(OutageScore(**_numbers(one)) for one in plain["outages"])
    known["growth"] = tuple(Growth(**_numbers(one)) for one in plain["growth"])
    known["events"] = tuple((float(t), str(kind), str(sensor), str(why)) for t, kind, sensor, why in plain["events"])
    known["real_time_factor"] = _number(plain["real_time_factor"])
    return Run(**known)


def latency_from_json(plain: Mapping[str, Any]) -> Latency:
    """Return a latency from its JSON."""
    quantiles = tuple((float(quantile), float(value)) for quantile, value in plain["quantiles_us"])
    return Latency(**{**plain, "quantiles_us": quantiles})


def to_json(value: Any) -> Any:
    """Return plain data; NaN becomes null and infinity the text `inf`, which JSON would not have."""
    if isinstance(value, float):
        return value if isfinite(value) else None if value != value else "inf"  # noqa: PLR0124 (only NaN differs)
    if hasattr(value, "__dataclass_fields__"):
        return to_json(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): to_json(one) for key, one in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [to_json(one) for one in value]
    return value


def _number(value: Any) -> float:
    return nan if value is None else float(value)


def _numbers(plain: Mapping[str, Any]) -> dict[str, float]:
    return {name: _number(value) for name, value in plain.items()}


def by_system(runs: Sequence[Run]) -> Iterator[tuple[str, list[Run]]]:
    """Yield each system with its runs, in the order in which they first come."""
    for system in dict.fromkeys(run.system for run in runs):
        yield system, [run for run in runs if run.system == system]
