"""The measures by which a run of a scenario is judged: their names, units and targets."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isfinite, isnan, log, nan
from typing import Literal

Kind = Literal["error", "time", "ratio"]


@dataclass(frozen=True, slots=True)
class Measure:
    """One score of `holdfast.evaluation.scenario`.

    Attributes:
        key: its name among the scores.
        factor: from the unit of the score to the unit that is shown.
        most: the target, in the unit that is shown; None without one.
        least: of a ratio that should be near one; None where smaller is better.
        only: the scenarios to which the target applies; empty for all.
    """

    key: str
    label: str
    unit: str
    factor: float = 1.0
    digits: int = 1
    most: float | None = None
    least: float | None = None
    only: tuple[str, ...] = ()

    @property
    def target(self) -> str:
        """The target in words; empty without one."""
        if self.most is None:
            return ""
        text = f"<= {self.most:g}" if self.least is None else f"{self.least:g} to {self.most:g}"
        return f"{text} ({', '.join(self.only)})" if self.only else text

    def shown(self, score: float) -> float:
        """Return a score in the unit that is shown."""
        return score * self.factor

    def text(self, score: float) -> str:
        """Return a score as it is shown: a dash where there was no occasion for it."""
        if isnan(score):
            return "-"
        return f"{self.shown(score):.{self.digits}f}" if isfinite(score) else "never" if self.unit == "s" else "inf"

    def is_reached(self, score: float, scenario: str) -> bool:
        """Return whether a score reaches the target, or none applies."""
        if self.most is None or isnan(score) or (self.only and scenario not in self.only):
            return True
        return (self.least is None or self.shown(score) >= self.least) and self.shown(score) <= self.most

    def mean(self, scores: Sequence[float]) -> float:
        """Return the mean over runs in which there was an occasion for it."""
        known = [score for score in scores if not isnan(score)]
        return sum(known) / len(known) if known else nan

    def worst(self, scores: Sequence[float]) -> float:
        """Return the worst of all runs: the largest, or of a ratio that which is farthest from one."""
        known = [score for score in scores if not isnan(score)]
        if self.least is None:
            return max(known, default=nan)
        return max(known, key=lambda score: abs(log(score)) if 0.0 < score < inf else inf, default=nan)


def _nees(prefix: str, when: str) -> tuple[Measure, ...]:
    return tuple(
        Measure(f"{prefix}_{block}", f"NEES of {block}, {when}", "1", digits=2, least=0.7, most=1.5)
        for block in ("attitude", "position", "velocity")
    )


MEASURES = (
    Measure("horizontal_rms_m", "GNSS good: horizontal RMS", "mm", 1e3, most=10.0),
    Measure("vertical_rms_m", "GNSS good: vertical RMS", "mm", 1e3, most=10.0),
    Measure("horizontal_ratio", "GNSS good: horizontal RMS / that of the fixes", "1", digits=2, most=0.5),
    Measure("vertical_ratio", "GNSS good: vertical RMS / that of the fixes", "1", digits=2, most=0.5),
    Measure("rtk_mean_m", "GNSS good: against RTK as in the paper, mean", "mm", 1e3, digits=2, most=1.8),
    Measure("rtk_std_m", "GNSS good: against RTK as in the paper, standard deviation", "mm", 1e3, most=12.8),
    Measure("heading_rms_deg", "GNSS good: heading RMS", "deg", digits=3, most=0.1),
    Measure("roll_pitch_rms_deg", "GNSS good: roll and pitch RMS", "deg", digits=3, most=0.02),
    Measure("outage_horizontal_rms_m", "outages: horizontal RMS", "mm", 1e3),
    Measure("outage_vertical_rms_m", "outages: vertical RMS", "mm", 1e3),
    Measure("outage_alone_horizontal_rms_m", "outages: horizontal RMS of the odometry alone", "mm", 1e3),
    Measure(
        "outage_horizontal_excess_m",
        "worst outage: horizontal RMS beyond that of the odometry alone",
        "mm",
        1e3,
        most=5.0,
    ),
    Measure("outage_heading_rms_deg", "outages: heading RMS", "deg", digits=3),
    Measure("outage_alone_heading_rms_deg", "outages: heading RMS of the odometry alone", "deg", digits=3),
    Measure(
        "outage_heading_excess_deg",
        "worst outage: heading RMS beyond that of the odometry alone",
        "deg",
        digits=3,
        most=0.03,
    ),
    Measure("settled_s", "recovery: world error below 2 cm after", "s", digits=2, most=2.0),
    Measure("regained_s", "recovery: GNSS used again after", "s", digits=2, most=5.0),
    Measure("misled_s", "more than 0.3 m wrong while trusting GNSS, for", "s", digits=2, most=1.0, only=("liar",)),
    Measure("step_m", "O: largest step", "mm", 1e3, digits=2, most=2.0),
    Measure("step_deg", "O: largest rotation step", "deg", digits=4, most=0.02),
    Measure("drift_percent", "O: drift per distance", "%", digits=2, most=0.5, only=("construction",)),
    Measure("base_position_rms_m", "chassis beyond the cabin's error, slewing: position RMS", "mm", 1e3, most=15.0),
    Measure(
        "base_rotation_rms_deg", "chassis beyond the cabin's error, slewing: rotation RMS", "deg", digits=3, most=0.1
    ),
    Measure("base_yaw_rate_rms_rad_s", "chassis: yaw rate RMS", "rad/s", digits=4, most=0.005),
    *_nees("nees", "GNSS good"),
    *_nees("fallback_nees", "in outages"),
    Measure("update_ms", "update, median", "ms", digits=2),
)
