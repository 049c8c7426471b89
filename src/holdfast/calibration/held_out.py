"""Whether a configuration is better than another one, by fixes that neither has seen."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from holdfast.calibration.evidence import Evidence
from holdfast.config.model import Config
from holdfast.config.sensors import GnssConfig, GnssVelocityConfig, HeadingConfig, PositionConfig
from holdfast.messages import Array
from holdfast.replay.held_out import HoldOut

FIRST_CUT_S, CUT_EVERY_S, CUT_S, MAX_CUTS = 60.0, 100.0, 20.0, 5  # outages that are cut into a recording
CLUSTER_S = 5.0  # errors further apart are independent
BEYOND_NOISE, WORSE, WORSE_M = 2.0, 1.05, 1e-3  # sigmas, ratio and difference that make it worse with GNSS
OUTAGE_WORSE, OUTAGE_WORSE_M = 1.3, 0.01  # the same in outages, each of which is one draw of a random walk


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Horizontal errors at held-out positions of all recordings.

    Attributes:
        label: what the configuration has.
        keys: (N,) of a position: the same in every run.
        clusters: (N,) numbers of stretches that are independent.
        errors: (N,) [m].
        in_outage: (N,).
    """

    label: str
    keys: Sequence[tuple[int, str, int]]
    clusters: NDArray[np.int64]
    errors: Array
    in_outage: NDArray[np.bool_]

    def rms(self, *, in_outage: bool) -> float:
        """Return the horizontal RMS with GNSS, or in the outages [m]; NaN where there is none."""
        errors = self.errors[self.in_outage == in_outage]
        return float(np.sqrt((errors**2).mean())) if len(errors) else float("nan")


def rules_of(config: Config, every: int, duration_s: float | None) -> list[HoldOut]:
    """Return what is held back: every n-th position, and outages of GNSS if a duration [s] says where they fit."""
    rules = [HoldOut(name, every) for name in config.sensors_of(PositionConfig)]
    if duration_s is None:
        return rules
    kinds = GnssConfig, HeadingConfig, GnssVelocityConfig
    cut = [name for name, section in config.sensors.items() if isinstance(section, kinds)]
    starts = np.arange(FIRST_CUT_S, duration_s - CUT_S - 5.0, CUT_EVERY_S)[:MAX_CUTS]
    return rules + [HoldOut(name, None, float(at), float(at) + CUT_S) for at in starts for name in cut]


def held_out(label: str, evidence: Sequence[Evidence]) -> HeldOut:
    """Return the errors of the causal track in some runs."""
    keys: list[tuple[int, str, int]] = []
    clusters: list[int] = []
    errors: list[float] = []
    outages: list[bool] = []
    for number, run in enumerate(evidence):
        for one in run.judged:
            stamp = one.stamp_ns - round(run.config.sensors[one.sensor].time_offset_s * 1e9)
            keys.append((number, one.sensor, stamp))
            clusters.append(number * 10_000_000 + int(stamp * 1e-9 / CLUSTER_S) % 10_000_000)
            errors.append(float(np.hypot(*one.error[:2])))
            outages.append(one.in_outage)
    return HeldOut(label, keys, np.array(clusters, np.int64), np.array(errors), np.array(outages, np.bool_))


def is_worse(before: HeldOut, after: HeldOut) -> str:
    """Return in words by how much it got worse beyond noise; empty if it did not."""
    nominal = before.rms(in_outage=False), after.rms(in_outage=False)
    if after.rms(in_outage=False) > WORSE * nominal[0] + WORSE_M and _is_sure(before, after):
        return f"held-out fixes say no: {nominal[0] * 1e3:.1f} mm before, {nominal[1] * 1e3:.1f} mm with it"
    outage = before.rms(in_outage=True), after.rms(in_outage=True)
    if outage[1] > OUTAGE_WORSE * outage[0] + OUTAGE_WORSE_M:
        return f"cut outages say no: {outage[0] * 1e3:.0f} mm before, {outage[1] * 1e3:.0f} mm with it"
    return ""


def _is_sure(before: HeldOut, after: HeldOut) -> bool:
    """Whether squared errors with GNSS grew by more than their scatter over independent stretches."""
    known = {
        key: error for key, error, lost in zip(before.keys, before.errors, before.in_outage, strict=True) if not lost
    }
    rows: dict[int, list[float]] = {}
    for key, cluster, error, lost in zip(after.keys, after.clusters, after.errors, after.in_outage, strict=True):
        if key in known and not lost:
            rows.setdefault(int(cluster), []).append(float(error) ** 2 - float(known[key]) ** 2)
    means = np.array([np.mean(one) for one in rows.values()])
    return len(means) > 2 and bool(means.mean() > BEYOND_NOISE * means.std(ddof=1) / np.sqrt(len(means)))
