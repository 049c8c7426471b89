"""Whether fixes and headings are as good as they claim, from their residuals against the track of all sensors."""

from collections.abc import Sequence
from math import degrees, remainder, tau

import numpy as np

from holdfast.calibration.estimated import Estimated, Family, Found
from holdfast.calibration.evidence import Evidence
from holdfast.config.edit import Change
from holdfast.config.model import Config
from holdfast.config.sensors import GnssConfig, HeadingConfig
from holdfast.messages import Array
from holdfast.sensors.heading import AxisYaw, HeadingModel, yaw_of
from holdfast.sensors.registry import sensors_of
from holdfast.sensors.sensor import Position

FEW = 30  # residuals, below which nothing is said
CLEAR = 1.5  # times the claim: less is no boast
INDEPENDENT_S = 1.0  # residuals closer together count as one


def fix_noise(evidence: Sequence[Evidence], original: Config) -> Found:
    """Return the noise of fixes and headings beside the floor of their claims, which rises if they claim too little.

    Held-out fixes are compared with the nodes, headings with the attitude between them. What changes more slowly than
    the window of the smoother is in the track, too, and is not seen.

    Args:
        evidence: of runs, with fixes held out.
        original: the configuration.
    """
    estimates: list[Estimated] = []
    changes: list[Change] = []
    for name, gnss in original.sensors_of(GnssConfig).items():
        errors, claims = _of_fixes(evidence, name)
        path = "sensors", name, "min_sigma_m"
        row, change = _row(path, name, "m", gnss.min_sigma_m, errors, claims, _count(evidence, name), 4)
        estimates.append(row)
        changes += change
    for name, heading in original.sensors_of(HeadingConfig).items():
        errors, claims = _of_headings(evidence, name)
        path = "sensors", name, "min_sigma_deg"
        row, change = _row(path, name, "deg", heading.min_sigma_deg, errors, claims, _count(evidence, name), 3)
        estimates.append(row)
        changes += change
    return Found(estimates, changes)


def _row(  # noqa: PLR0917 (what a row is made of)
    path: tuple[str, ...], name: str, unit: str, before: float, errors: Array, claims: Array, count: int, digits: int
) -> tuple[Estimated, list[Change]]:
    """Return the row of a sensor: what its residuals (N,) show, beside its claims (N,)."""
    if len(errors) < FEW:
        row = Estimated(Family.FIX_NOISE, path, name, unit, before, before, before, before)
        return row.kept(f"not observable: {len(errors)} residuals with good GNSS"), []
    after = 1.4826 * float(np.median(np.abs(errors)))
    claim = float(np.median(claims))
    sigma = after / np.sqrt(2.0 * max(1, min(count, len(errors))))
    row = Estimated(Family.FIX_NOISE, path, name, unit, before, after, float(sigma), max(claim, before))
    if after < max(CLEAR, 1.0 + 2.0 * sigma / after) * max(claim, before):
        return row.kept(f"as good as claimed ({claim:.2g} {unit})"), []
    return row, [Change(path, round(after, digits))]


def _count(evidence: Sequence[Evidence], name: str) -> int:
    """Return how many residuals are independent."""
    return sum(round(one.duration_s / INDEPENDENT_S) for one in evidence if one.fixes.get(name))


def _of_fixes(evidence: Sequence[Evidence], name: str) -> tuple[Array, Array]:
    """Return horizontal residuals and claims, each (N,) [m], of held-out fixes; east and north apart."""
    errors: list[float] = []
    claims: list[float] = []
    for run in evidence:
        for one in run.smoothed:
            fix = run.fixes.get(name, {}).get(one.stamp_ns)
            if one.sensor == name and isinstance(fix, Position) and not (one.in_outage or one.imu_silent):
                errors += one.error[:2].tolist()
                claims += np.sqrt(fix.covariance.diagonal()[:2]).tolist()
    return np.array(errors), np.array(claims)


def _of_headings(evidence: Sequence[Evidence], name: str) -> tuple[Array, Array]:
    """Return residuals and claims, each (N,) [deg], of headings at nodes."""
    errors: list[float] = []
    claims: list[float] = []
    for run in evidence:
        sensor = sensors_of(run.config)[name]
        if not isinstance(sensor, HeadingModel) or sensor.axis is None:
            continue
        index = {stamp: k for k, stamp in enumerate(run.nodes.times_ns.tolist())}
        for stamp, measured in run.fixes.get(name, {}).items():
            k = index.get(round(stamp, -5))
            if k is None or not isinstance(measured, AxisYaw):
                continue
            yaw = yaw_of(run.nodes.rotations[k] @ sensor.axis)
            if yaw is not None:
                errors.append(degrees(remainder(measured.yaw_rad - yaw, tau)))
                claims.append(degrees(measured.sigma_rad))
    return np.array(errors), np.array(claims)
