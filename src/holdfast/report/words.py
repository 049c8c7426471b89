"""Events of a replay in words: what happened, what the estimator did about it, and why."""

from collections.abc import Mapping
from typing import Any

ROUTINE = frozenset({"rejected", "late", "waiting"})
"""Kinds of events that are counted, not told one by one: they concern single measurements, or come before the start."""

TOLD = {
    "initialised": "The estimator started ({reason}).",
    "imu_gap": "The IMU drops out: {reason}. No IMU factor spans it; the motion model and the other sensors do.",
    "clock_step": "The clock of {sensor} went back for good: {reason}.",
    "estimate_suspect": "The estimate itself is doubted: {sensor} says it is {reason}. The fixes are believed.",
    "gnss_lost": "GNSS is lost: {reason}. The fallback graph takes over in the same IMU tick.",
    "gnss_regained": "GNSS is back: {reason}. The main graph takes over; the odometry frame takes the jump.",
    "antenna_lost": "{sensor} is no longer trusted: {reason}. Its fixes wait in quarantine.",
    "antenna_regained": "{sensor} is trusted again: {reason}.",
    "recovery_refused": "{sensor} asked to come back and was refused: {reason}.",
    "lidar_jump": "The track of {sensor} jumped: {reason}. It goes on as a new track.",
    "lidar_slip": "The track of {sensor} slipped: {reason}. Its factors in the window were dropped.",
    "health": "Health: {reason}.",
    "optimiser_fault": "An optimisation failed: {reason}. The window was anchored anew at the last good state.",
    "encoder": "The encoder of the turn joint is {reason}.",
}
SENSORS = {
    "gnss": "antenna gnss",
    "gnss_right": "antenna gnss_right",
    "gnss, gnss_right": "both antennas",
    "gnss_right, gnss": "both antennas",
    "imu": "the IMU",
    "lidar": "the lidar odometry",
}
REASONS = {
    "ok": "sound",
    "silent": "it is silent",
    "standstill": "at standstill",
    "optimiser_reset": "anchored anew after a fault",
    "imu_gap": "the IMU is silent",
    "fallback": "fallback, GNSS is not trusted",
    "recovering": "recovering, GNSS is being taken in",
    "lidar_lost": "no lidar odometry",
    "gnss_degraded": "one antenna is not trusted",
    "nominal": "nominal, all that is expected is fused",
}
FIXES = {
    "innovation": "contradicting the estimate",
    "contradicted": "contradicted by later ones",
    "walking": "walking away from the lidar's track",
    "too_fast": "faster than the machine can move",
    "baseline": "with a wrong distance between the antennas",
    "low_status": "of too low a status",
    "no_covariance": "without a covariance",
    "large_covariance": "with too large a covariance",
    "not_finite": "that are no numbers",
    "out_of_range": "out of range",
    "duplicate": "sent twice",
    "clock_jump": "with a stamp from the future",
    "late": "that came too late",
}


def in_words(event: Mapping[str, Any]) -> str:
    """Return an event of events.jsonl (kind, sensor, reason) in one or two sentences."""
    text = TOLD.get(event["kind"], "{kind} {sensor}: {reason}.")
    reason = "; ".join(_reason(part.strip()) for part in str(event["reason"]).split(";"))
    sensor = event["sensor"]
    named = SENSORS.get(sensor, sensor) or "the estimator"
    said = text.format(kind=event["kind"], sensor=named, reason=reason)
    return said[0].upper() + said[1:]


def _reason(part: str) -> str:
    """Put codes into words, such as `12 innovation` or `gate power 0.13 m`; what is none stays as it is."""
    if part.startswith("gate power "):
        return f"at that time the gate would have seen any jump beyond {part.removeprefix('gate power ')}"
    return ", ".join(_code(piece) for piece in part.split(", "))


def _code(piece: str) -> str:
    count, _, code = piece.partition(" ")
    if count.isdecimal() and code in FIXES:
        return f"{count} fix{'es' if count != '1' else ''} {FIXES[code]}"
    return REASONS.get(piece, piece)
