"""Presets: other defaults for the whole configuration. What a file gives itself always wins.

`paper` makes the estimator follow the rules of the paper: a node per IMU sample, relative poses of odometries in the
main graph and a frozen frame of the odometry in the fallback graph (Eq. 10), a gate that asks only for the receiver's
covariance and the speed between two fixes, with twenty in a row either way, and a T_W_O that moves at recoveries alone
(Eq. 11). Its numbers are those of the authors' code; of its weights, such as 1 m for a fix of 1 cm, none is taken over.
"""

from math import sqrt
from typing import Any

_PAPER: dict[str, Any] = {
    "frames": {"odometry_policy": "at_recovery"},
    "graph": {
        "nodes": "imu",
        "lag_s": 6.0,
        "main_odometry": "relative",
        "fallback_odometry": "frozen",
        "gyroscope_scale": False,
    },
    "gate": {
        "innovation": False,
        "baseline": False,
        "drift_monitor": False,
        "max_speed_m_s": 6.0,  # 0.3 m in the 50 ms between two fixes
        "lose_after": 20,
        "regain_after": 20,
        "regain_s": 1.0,  # of twenty fixes at 20 Hz
        "quarantine_s": 0.0,  # what entered before the loss stays in
    },
    "standstill": {"enabled": False},
}
_PAPER_SENSORS: dict[str, dict[str, Any]] = {
    "gnss": {"max_sigma_m": round(sqrt(0.1), 3), "slow_time_constant_s": 0.0},  # 0.1 m^2
    "heading": {"slow_time_constant_s": 0.0},
}

# name -> (what differs in the sections, what differs for every sensor of a kind that the file has)
PRESETS: dict[str, tuple[dict[str, Any], dict[str, dict[str, Any]]]] = {
    "holdfast": ({}, {}),
    "paper": (_PAPER, _PAPER_SENSORS),
}


def with_preset(given: dict[str, Any]) -> dict[str, Any]:
    """Return a configuration's data on top of the defaults of the preset that it names.

    An unknown name changes nothing: the model refuses it.
    """
    name = given.get("preset", "holdfast")
    sections, of_kinds = PRESETS.get(name, ({}, {})) if isinstance(name, str) else ({}, {})
    merged = _on_top(sections, given)
    sensors = merged.get("sensors")
    if isinstance(sensors, dict):
        merged["sensors"] = {
            name: of_kinds.get(str(one.get("kind")), {}) | one if isinstance(one, dict) else one
            for name, one in sensors.items()
        }
    return merged


def _on_top(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Return the sections of both; a heading of `above` with nothing below it keeps those of `below`."""
    merged = below | above
    for key in below.keys() & above.keys():
        if isinstance(below[key], dict) and isinstance(above[key], dict | None):
            merged[key] = _on_top(below[key], above[key] or {})
    return merged
