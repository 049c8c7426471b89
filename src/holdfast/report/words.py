"""Events of a replay in words: what happened, what the estimator did about it, and why."""

from collections.abc import Mapping
from typing import Any

ROUTINE = frozenset({"rejected", "late", "waiting"})
"""Kinds of events that are counted, not listed: they are about single measurements, or come before the start."""

SENTENCES = {
    "initialised": "The estimator started ({reason}).",
    "covariance_assumed": "Of {sensor}, {reason}.",
    "imu_gap": "The IMU drops out: {reason}. No IMU factor spans it; the motion model and the other sensors do.",
    "clock_step": "The clock of {sensor} went back for good: {reason}.",
    "estimate_suspect": "The estimate itself is doubted: {sensor} finds it {reason}. Its measurements are accepted.",
    "begun_anew": "The estimate was wrong and is begun anew from what agrees without it: {reason}.",
    "lever_arm": "The lever arms of {sensor}: {reason}.",
    "calibration": "{sensor} is otherwise than configured: {reason}.",
    "noise": "{sensor} measures otherwise than it claims: {reason}.",
    "gnss_lost": "GNSS is lost: {reason}. The fallback graph takes over in the same IMU tick.",
    "gnss_regained": "GNSS is back: {reason}. The main graph takes over; the odometry frame takes the jump.",
    "receiver_lost": "{sensor} is no longer trusted: {reason}. Its measurements wait in quarantine.",
    "receiver_regained": "{sensor} is trusted again: {reason}.",
    "recovery_refused": "{sensor} agreed with itself again and was refused: {reason}.",
    "sensor_lost": "{sensor} is no longer used: {reason}.",
    "sensor_regained": "{sensor} is used again: {reason}.",
    "odometry_jump": "The track of {sensor} jumped: {reason}. It continues as a new track.",
    "odometry_slip": "The track of {sensor} slipped: {reason}. Its factors in the window were removed.",
    "health": "Health: {reason}.",
    "optimiser_fault": "An optimisation failed: {reason}. The window was anchored anew at the last good state.",
    "encoder": "The encoder of the turn joint is {reason}.",
}
REASONS = {
    "ok": "sound",
    "silent": "it is silent",
    "standstill": "at standstill",
    "optimiser_reset": "anchored anew after a fault",
    "imu_gap": "the IMU is silent",
    "fallback": "fallback, GNSS is not trusted",
    "recovering": "recovering, GNSS is being taken in",
    "odometry_lost": "no odometry",
    "sensor_lost": "a sensor is not used",
    "gnss_degraded": "not every receiver is trusted",
    "lever_arm": "the antennas are not as far apart as configured",
    "nominal": "nominal, all that is expected is fused",
}
MEASUREMENTS = {
    "innovation": "contradicting the estimate",
    "contradicted": "contradicted by later ones",
    "walking": "walking away from the track of an odometry",
    "too_fast": "faster than the machine can move",
    "baseline": "with a wrong distance between the antennas",
    "low_status": "of too low a status",
    "no_covariance": "without a covariance",
    "large_covariance": "with too large a covariance",
    "not_finite": "that are not finite",
    "out_of_range": "out of range",
    "duplicate": "sent twice",
    "clock_jump": "with a stamp from the future",
    "late": "that came too late",
    "overload": "beyond what can be taken in",
    "no_joint_angle": "without an angle of the turn joint",
}


def in_words(event: Mapping[str, Any]) -> str:
    """Return an event of events.jsonl (kind, sensor, reason) in one or two sentences."""
    text = SENTENCES.get(event["kind"], "{kind} {sensor}: {reason}.")
    reason = "; ".join(_reason(part.strip()) for part in str(event["reason"]).split(";"))
    sentences = text.format(kind=event["kind"], sensor=event["sensor"] or "the estimator", reason=reason)
    # a name of a sensor stays as the user has written it
    return sentences if sentences.startswith(event["sensor"] or "\0") else sentences[0].upper() + sentences[1:]


def _reason(part: str) -> str:
    """Put codes into words, such as `12 innovation` or `gate power 0.13 m`; anything else stays as it is."""
    if part.startswith("gate power "):
        return f"at that time the gate would have detected any jump beyond {part.removeprefix('gate power ')}"
    return ", ".join(_code(piece) for piece in part.split(", "))


def _code(piece: str) -> str:
    count, _, code = piece.partition(" ")
    if count.isdecimal() and code in MEASUREMENTS:
        return f"{count} measurement{'s' * (count != '1')} {MEASUREMENTS[code]}"
    return REASONS.get(piece, piece)
