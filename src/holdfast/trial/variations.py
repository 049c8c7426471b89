"""Variations of a configuration by name: parts of the estimator or sensors taken away, to see what each is worth."""

from typing import Any

# name -> what it changes in the configuration; None takes away what is there
VARIATIONS: dict[str, dict[str, Any]] = {
    "default": {},
    "paper": {"preset": "paper"},
    "single-graph": {"graph": {"dual": False}},
    "relative-scans": {"graph": {"dual": False, "main_odometry": "relative"}},
    "frozen-fallback": {"graph": {"fallback_odometry": "frozen"}},
    "imu-nodes": {"graph": {"nodes": "imu"}},
    "lag-1.5s": {"graph": {"lag_s": 1.5}},
    "lag-6s": {"graph": {"lag_s": 6.0}},
    "no-innovation": {"gate": {"innovation": False}},
    "no-drift-monitor": {"gate": {"drift_monitor": False}},
    "no-gyroscope-scale": {"graph": {"gyroscope_scale": False}},
    "no-standstill": {"standstill": {"enabled": False}},
    "frame-at-recovery": {"frames": {"odometry_policy": "at_recovery"}},
    "one-antenna": {"sensors": {"gnss_right": None, "heading": None}},
    "no-heading": {"sensors": {"heading": None}},
    "no-lidar": {"sensors": {"lidar": None}},
}


def changed(given: dict[str, Any], overlay: dict[str, Any]) -> dict[str, Any]:
    """Return configuration data in which the overlay's values replace those given, section by section; None removes."""
    merged = {key: value for key, value in (given | overlay).items() if overlay.get(key, value) is not None}
    for key in given.keys() & overlay.keys():
        if isinstance(given[key], dict) and isinstance(overlay[key], dict):
            merged[key] = changed(given[key], overlay[key])
    return merged
