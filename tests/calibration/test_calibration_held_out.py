"""Held-out fixes speak against a configuration that makes them worse, beyond noise, and against no other."""

import numpy as np

from holdfast.calibration.held_out import HeldOut, is_worse, rules_of
from holdfast.config.load import config_of

COUNT = 600
RNG = np.random.default_rng(0)
ERRORS = np.abs(0.01 * RNG.standard_normal(COUNT))


def held(errors, outage_m=0.05):
    lost = np.arange(COUNT) >= COUNT - 60
    errors = np.where(lost, outage_m, errors)
    keys = [(0, "gnss", k) for k in range(COUNT)]
    return HeldOut("any", keys, np.arange(COUNT) // 10, errors, lost)


def test_the_same_errors_are_not_worse():
    assert is_worse(held(ERRORS), held(ERRORS)) == ""


def test_noise_is_not_worse():
    other = np.abs(0.0101 * np.random.default_rng(1).standard_normal(COUNT))
    assert is_worse(held(ERRORS), held(other)) == ""


def test_errors_that_grow_everywhere_are_worse():
    assert is_worse(held(ERRORS), held(1.5 * ERRORS)).startswith("held-out fixes say no: ")


def test_one_bad_stretch_is_no_proof_that_a_configuration_is_worse():
    bad = ERRORS.copy()
    bad[:10] = 0.1
    assert is_worse(held(ERRORS), held(bad)) == ""


def test_outages_that_get_much_longer_errors_are_worse():
    assert "cut outages say no: 50 mm before, 120 mm" in is_worse(held(ERRORS), held(ERRORS, outage_m=0.12))
    assert is_worse(held(ERRORS), held(ERRORS, outage_m=0.06)) == ""


def test_outages_are_cut_where_the_recording_is_long_enough():
    sensors = {
        "imu": {"kind": "imu", "topic": "/i"},
        "gnss": {"kind": "gnss", "topic": "/g"},
        "other": {"kind": "gnss", "topic": "/o"},
        "compass": {"kind": "heading", "topic": "/h", "mounting_yaw_deg": 0.0},
    }
    mounts = [
        {"parent": "imu", "child": child, "translation_m": [k, 0.0, 0.0]} for k, child in enumerate(("gnss", "other"))
    ]
    config = config_of({"sensors": sensors, "extrinsics": mounts}, "config")
    cuts = [rule for rule in rules_of(config, 10, 240.0) if rule.every is None]
    assert {(rule.sensor, rule.start_s, rule.end_s) for rule in cuts} == {
        (name, at, at + 20.0) for name in ("gnss", "other", "compass") for at in (60.0, 160.0)
    }
    assert [rule.sensor for rule in rules_of(config, 10, 60.0)] == ["gnss", "other"]
