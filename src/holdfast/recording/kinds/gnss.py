"""Fixes of a GNSS receiver, and the quality that it claims."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from holdfast.config.assignment import Measured, Rule
from holdfast.config.sensors import GnssConfig
from holdfast.messages import Array, FixStatus, GnssFix
from holdfast.recording.columns import Columns, diagonal
from holdfast.recording.decode import STAMP, Decoder, FieldDecoder, UndecodableError, known_covariance
from holdfast.recording.kinds import DERIVED, Kind, register
from holdfast.recording.source import Subscription

FIX = "sensor_msgs/msg/NavSatFix"
FIELDS = (
    *STAMP, "latitude", "longitude", "altitude", "position_covariance", "position_covariance_type", "status.status",
)  # fmt: skip
LEFT = ("left", "main", "master", "primary", "front", "l")
RIGHT = ("right", "aux", "slave", "secondary", "rover", "rear", "r")
LARGEST_SIGMA_M = 10.0  # a receiver that usually claims more is not believed
STATUSES = {int(status): status for status in FixStatus}
ALLOWED = ", ".join(f"{status.value} {status.name}" for status in FixStatus)


def _status(number: float) -> FixStatus:
    return STATUSES.get(int(number), FixStatus.UNKNOWN) if isfinite(number) else FixStatus.UNKNOWN


def fix_decoder(subscription: Subscription) -> Decoder:
    """Decode sensor_msgs/NavSatFix: a covariance of unknown type, not finite or without variance is None."""

    def build(arrival_ns: int, sec: int, nanosec: int, *fields: Any) -> GnssFix:
        latitude, longitude, altitude, covariance, covariance_type, status = fields
        known = known_covariance(covariance, 3) if covariance_type != 0 else None
        stamp_ns = sec * 1_000_000_000 + nanosec
        point = latitude, longitude, altitude
        return GnssFix(stamp_ns, arrival_ns, subscription.sensor, *point, known, _status(status))

    return FieldDecoder(FIELDS, build)


def _of_line(stamp_ns: int, arrival_ns: int, sensor: str, v: list[float]) -> GnssFix:
    if isfinite(v[3]) and v[3] not in STATUSES:
        raise UndecodableError(f"status is {v[3]:g} (allowed: {ALLOWED}, or nan)")
    return GnssFix(stamp_ns, arrival_ns, sensor, v[0], v[1], v[2], diagonal(v[4:]), _status(v[3]))


@dataclass(frozen=True, slots=True)
class GnssFindings:
    """Quality that the receiver claims; sigmas are horizontal, the worse of east and north [m], None if all unknown.

    `usual_sigma_m` is what 95 % of the fixes stay within.
    """

    statuses: dict[str, int]
    not_finite: int
    unknown_covariances: int
    smallest_sigma_m: float | None
    usual_sigma_m: float | None
    largest_sigma_m: float | None

    def summary(self) -> str:
        """Return it in one line."""
        statuses = ", ".join(f"{count} {name}" for name, count in self.statuses.items())
        sigmas = "unknown"
        if self.smallest_sigma_m is not None and self.largest_sigma_m is not None:
            sigmas = f"{self.smallest_sigma_m:.3g} to {self.largest_sigma_m:.3g} m"
        return f"status {statuses}; horizontal sigma {sigmas}"

    def problems(self, count: int) -> Iterator[str]:
        """Yield what is wrong; see `Findings`."""
        if self.unknown_covariances:
            yield (
                f"{self.unknown_covariances} of {count} fixes have no covariance; "
                "they are weighed by their status unless default_sigma_m is given"
            )
        if self.not_finite:
            yield f"{self.not_finite} of {count} fixes have no finite position; they are counted and not used"
        if "gbas" not in self.statuses:
            statuses = ", ".join(self.statuses)
            yield f"no fix has the status gbas (only {statuses}); RTK was never fixed, or the driver does not report it"

    def measured(self) -> Measured:
        """Return what a configuration can say of the receiver; see `Findings`."""
        usual, limit = self.usual_sigma_m, GnssConfig.model_fields["max_sigma_m"].default
        if usual is None or usual <= limit:
            return Measured((self.summary(),))
        largest = float(f"{min(2.0 * usual, LARGEST_SIGMA_M):.2g}")
        return Measured((self.summary(),), {"max_sigma_m": f"95 % claim up to {usual:.2g}"}, {"max_sigma_m": largest})


def check(stamps_ns: NDArray[np.int64], values: Array, start_ns: int) -> GnssFindings | None:  # noqa: ARG001
    """Return what was found; None without a fix."""
    fixes = [GnssFix.of(0, 0, "", row) for row in values.tolist()]
    if not fixes:
        return None
    variances = [fix.covariance.diagonal()[:2].max() for fix in fixes if fix.covariance is not None]
    return GnssFindings(
        statuses=dict(sorted(Counter(fix.status.name.lower() for fix in fixes).items())),
        not_finite=int((~np.isfinite(values[:, :3]).all(axis=1)).sum()),
        unknown_covariances=len(fixes) - len(variances),
        smallest_sigma_m=float(np.sqrt(min(variances))) if variances else None,
        usual_sigma_m=float(np.sqrt(np.percentile(variances, 95.0))) if variances else None,
        largest_sigma_m=float(np.sqrt(max(variances))) if variances else None,
    )


register(
    Kind(
        "gnss",
        GnssFix,
        {FIX: fix_decoder},
        Columns(
            ("latitude_deg", "longitude_deg", "altitude_m", "status"),
            _of_line,
            (("sigma_east_m", "sigma_north_m", "sigma_up_m"),),
        ),
        rules=(
            Rule("gnss", LEFT, (*RIGHT, *DERIVED), last_resort=True),
            Rule("gnss_right", RIGHT, DERIVED, named=True),
            Rule("gnss", avoid=DERIVED, every=True),
        ),
        gap="the position drifts with odometry and IMU meanwhile",
        check=check,
        rank=10,
    )
)
