"""The rows in the shared memory: every bit of every kind of message, whatever the sensors and however many."""

import struct
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.config.model import Config
from holdfast.estimator.health import HealthMonitor
from holdfast.geometry.earth import Geodetic
from holdfast.messages import (
    FixStatus,
    GnssFix,
    GnssVelocity,
    Heading,
    Height,
    ImuSample,
    JointAngle,
    PointPosition,
    SensorPose,
    Twist,
)
from holdfast.realtime.records import PackedState, Published, Records, pack_nav, unpack_nav
from holdfast.state import OptimisedState

AT_IMU = {"frame": "imu"}
KINDS = {
    "body": {"kind": "imu", "frame": "imu"},
    "mast": {"kind": "gnss", **AT_IMU},
    "doppler": {"kind": "gnss_velocity", **AT_IMU},
    "heading": {"kind": "heading"},
    "camera": {"kind": "odometry", **AT_IMU},
    "wheels": {"kind": "twist", "frame": "base_link"},
    "marker": {"kind": "pose", **AT_IMU},
    "prism": {"kind": "prism", **AT_IMU},
    "laser": {"kind": "height", **AT_IMU},
    "swing": {"kind": "joint"},
}
MANY = {f"height{k}": {"kind": "height", **AT_IMU} for k in range(40)}


def config_of(sections):
    """A machine whose wheels are beyond the turn joint, so that the optimiser needs the encoder."""
    return Config.model_validate(
        {
            "sensors": {name: {"topic": f"/{name}", **section} for name, section in sections.items()},
            "turn_joint": {"parent": "base_link", "child": "imu", "translation_m": [0.0, 0.0, 1.0]},
            "frames": {"datum": {"latitude_deg": 47.0, "longitude_deg": 8.0, "altitude_m": 400.0}},
        }
    )


CONFIG = config_of(KINDS | MANY)
RECORDS, OTHER_END = Records(CONFIG), Records(CONFIG)

floats = st.floats(width=64)  # NaN and infinity travel, too
stamps = st.integers(-(2**63), 2**63 - 1)


def vector(length):
    return st.lists(floats, min_size=length, max_size=length).map(np.array)


def matrix(size):
    return st.none() | vector(size * size).map(lambda values: values.reshape(size, size))


def of(kind, sensor, *fields):
    return st.builds(kind, stamps, stamps, st.just(sensor), *fields)


messages = st.one_of(
    of(GnssFix, "mast", floats, floats, floats, matrix(3), st.sampled_from(FixStatus)),
    of(GnssVelocity, "doppler", vector(3), matrix(3)),
    of(Heading, "heading", floats, st.none() | floats),
    of(SensorPose, "camera", vector(3), vector(4), matrix(6)),
    of(SensorPose, "marker", vector(3), vector(4), matrix(6)),
    of(Twist, "wheels", vector(3), vector(3), matrix(6)),
    of(PointPosition, "prism", vector(3), matrix(3)),
    of(Height, "height39", floats, st.none() | floats),
    of(JointAngle, "swing", floats),
)


def bits(message):
    """Everything that a message holds; -0.0 is not 0.0, and a NaN is itself."""
    row = message.values()
    assert len(row) == type(message).WIDTH
    return type(message), message.stamp_ns, message.arrival_ns, message.sensor, struct.pack(f"{len(row)}d", *row)


@given(epoch=st.integers(0, 2**40), samples=st.integers(0, 2**40), message=messages)
def test_a_measurement_comes_out_as_it_went_in(epoch, samples, message):
    row = RECORDS.pack_request(epoch, samples, message)
    assert len(row) == RECORDS.request_size
    *counted, unpacked = OTHER_END.unpack_request(row)
    assert counted == [epoch, samples]
    assert bits(unpacked) == bits(message)


@given(sample=of(ImuSample, "body", vector(3), vector(3)))
def test_a_sample_comes_out_as_it_went_in_under_the_name_of_the_primary_imu(sample):
    row = RECORDS.pack_sample(7, sample)
    assert len(row) == RECORDS.sample_size
    epoch, unpacked = OTHER_END.unpack_sample(row)
    assert epoch == 7
    assert bits(unpacked) == bits(sample)


@pytest.mark.parametrize("request_", [None, Geodetic(47.0, 8.0, 400.0)])
def test_a_request_comes_out_as_it_went_in(request_):
    assert OTHER_END.unpack_request(RECORDS.pack_request(1, 2, request_)) == (1, 2, request_)


def test_a_row_is_no_wider_than_the_widest_message_of_the_configuration():
    narrow = Records(config_of({"body": KINDS["body"], "swing": KINDS["swing"], "heading": KINDS["heading"]}))
    assert narrow.request_size < RECORDS.request_size
    datum = Geodetic(1.0, 2.0, 3.0)
    assert narrow.unpack_request(narrow.pack_request(0, 0, datum))[2] == datum


# --- what is published ------------------------------------------------------------------------------------------------


def state(seed, order="C"):
    rng = np.random.default_rng(seed)
    nav = gtsam.NavState(gtsam.Rot3.Expmap(rng.normal(size=3)), rng.normal(size=3), rng.normal(size=3))
    bias = gtsam.imuBias.ConstantBias(rng.normal(size=3), rng.normal(size=3))
    covariance = np.asarray(rng.normal(size=(15, 15)), order=order)
    return OptimisedState(123456789, nav, bias, covariance, rng.normal(size=3))


def published(**changes):
    health = HealthMonitor(CONFIG).snapshot()
    fields = {
        "epoch": 1,
        "life": 2,
        "updates": 3,
        "recoveries": 4,
        "is_lost": False,
        "lost": (),
        "health": health,
        "gravity": 9.81,
        "datum": None,
        "state": None,
    }
    return Published(**(fields | changes))


def through(record):
    packed = RECORDS.pack_published(record)
    assert len(packed) == RECORDS.published_size
    return OTHER_END.unpack_published(packed)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"is_lost": True, "lost": ("mast", "prism")},
        {"lost": ("wheels", "height0", "height39")},
        {"datum": Geodetic(47.0, 8.0, 400.0), "gravity": 9.8},
        {"health": tuple(range(len(HealthMonitor(CONFIG).snapshot())))},
    ],
)
def test_what_is_published_comes_out_as_it_went_in(changes):
    record = published(**changes)
    found = through(record)
    for field in ("epoch", "life", "updates", "recoveries", "is_lost", "health", "gravity", "datum", "state"):
        assert getattr(found, field) == getattr(record, field)
    assert set(found.lost) == set(record.lost)


@pytest.mark.parametrize("lost", [(f"height{k}",) for k in range(0, 40, 13)])
def test_each_of_many_sensors_can_be_lost(lost):
    assert through(published(lost=lost)).lost == lost


def test_every_sensor_that_can_be_lost_at_once_can_be_published():
    everyone = tuple(HealthMonitor(CONFIG).names)
    assert through(published(lost=everyone)).lost == everyone


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_state_keeps_every_bit_and_how_its_covariance_lies(order):
    """numpy multiplies a matrix otherwise if it lies otherwise, and then the last bit differs."""
    for seed in range(5):
        before = state(seed, order)
        after = through(published(state=before)).state
        assert after.stamp_ns == before.stamp_ns
        assert after.covariance.tobytes("A") == before.covariance.tobytes("A")
        assert after.covariance.flags.f_contiguous == before.covariance.flags.f_contiguous
        assert pack_nav(after.nav) == pack_nav(before.nav)
        assert after.bias.vector().tobytes() == before.bias.vector().tobytes()
        assert after.angular_velocity.tobytes() == before.angular_velocity.tobytes()


def test_a_smoothed_node_keeps_every_bit():
    for seed in range(20):
        packed = pack_nav(state(seed).nav)
        assert pack_nav(unpack_nav(packed)) == packed


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_packed_state_is_the_state_and_keeps_its_stamp_before_it_is_unpacked(order):
    known = state(3, order)
    packed = PackedState.of(known.stamp_ns, RECORDS.pack_published(published(state=known)), OTHER_END)
    assert isinstance(packed, OptimisedState) and packed.stamp_ns == known.stamp_ns
    later = replace(packed, stamp_ns=7)
    for found in (packed, later):
        assert found.nav.equals(known.nav, 0.0) and found.bias.equals(known.bias, 0.0)
        assert (found.covariance == known.covariance).all()
        assert (found.angular_velocity == known.angular_velocity).all()
    assert later.stamp_ns == 7
    with pytest.raises(AttributeError, match="speed"):
        packed.speed  # noqa: B018
