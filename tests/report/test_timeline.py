"""Intervals of health and trust, from the events of a replay."""

from holdfast.report.timeline import health_intervals, lost_intervals, trust_intervals


def test_intervals_follow_the_events():
    def event(at_s: float, kind: str, sensor: str = "", reason: str = "") -> dict:
        return {"stamp_ns": round(at_s * 1e9), "kind": kind, "sensor": sensor, "reason": reason}

    events = [
        event(1.0, "initialised"),
        event(1.0, "health", reason="nominal"),
        event(5.0, "receiver_lost", "gnss", "silent"),
        event(5.0, "gnss_lost", "", "no receiver is trusted"),
        event(5.0, "health", reason="fallback"),
        event(8.0, "receiver_regained", "gnss", "5 good fixes in a row"),
        event(8.0, "gnss_regained", "", "5 fixes agree"),
        event(8.0, "health", reason="nominal"),
        event(9.0, "gnss_lost", "", "no receiver is trusted"),
    ]
    assert [s[:3] for s in health_intervals(events, 0, 10.0)] == [
        (0.0, 1.0, "initialising"), (1.0, 5.0, "nominal"), (5.0, 8.0, "fallback"), (8.0, 10.0, "nominal"),
    ]  # fmt: skip
    assert [s[:3] for s in trust_intervals(events, 0, 10.0, ["gnss"])["gnss"]] == [
        (1.0, 5.0, "trusted"), (5.0, 8.0, "lost"), (8.0, 10.0, "trusted"),
    ]  # fmt: skip
    assert [s[:2] for s in lost_intervals(events, 0, 10.0)] == [(5.0, 8.0), (9.0, 10.0)]


def test_every_tested_sensor_has_its_own_trust():
    def event(at_s: float, kind: str, sensor: str = "") -> dict:
        return {"stamp_ns": round(at_s * 1e9), "kind": kind, "sensor": sensor, "reason": ""}

    events = [event(0.0, "initialised"), event(2.0, "sensor_lost", "tracks"), event(3.0, "sensor_regained", "tracks")]
    found = trust_intervals(events, 0, 5.0, ["tracks", "mast"])
    assert [i[:3] for i in found["tracks"]] == [(0.0, 2.0, "trusted"), (2.0, 3.0, "lost"), (3.0, 5.0, "trusted")]
    assert [i[:3] for i in found["mast"]] == [(0.0, 5.0, "trusted")]
    assert trust_intervals(events[1:], 0, 5.0, ["tracks"]) == {}  # it never started
