"""An IMU whose axes or units are not those of ROS is found by how an antenna beside it moves, and no other one."""

import pytest
from driven import POSITIONS, VELOCITIES, driven, received, standing, straight, turning

from holdfast.recording.imu_convention import MISTAKES, SPAN_S, mistake
from holdfast.recording.stretch import stretches

RECEIVERS = [(POSITIONS, 0.01, 5), (POSITIONS, 0.3, 2), (VELOCITIES, 0.05, 2)]
SEEN_BY_TURNS = [name for name in MISTAKES if not name.startswith(("the x axis of the gyro", "the y axis of the gyro"))]


def compared(motion, scale=1.0, receivers=RECEIVERS, seed=0, early_s=0.0):
    """Stretches of an IMU whose readings come out divided by `scale`, beside some receivers."""
    t, readings = driven(motion, seed)
    return [
        stretch
        for order, sigma, rate_hz in receivers
        for stretch in stretches(
            t, readings / scale, *received(motion, order, sigma, early_s, rate_hz, seed), order, span_s=SPAN_S
        )
    ]


@pytest.mark.parametrize("name", SEEN_BY_TURNS)
@pytest.mark.parametrize(("receiver", "early_s"), [(RECEIVERS[0], 0.15), (RECEIVERS[2], 0.0)], ids=["rtk", "doppler"])
def test_every_mistake_is_named(name, receiver, early_s):
    found = mistake(compared(turning, MISTAKES[name], [receiver], early_s=early_s))
    assert found is not None
    assert found[0] == name
    assert found[1] > 1.4


@pytest.mark.parametrize("motion", [turning, straight, standing])
@pytest.mark.parametrize("seed", range(2))
def test_what_is_right_is_not_accused(motion, seed):
    assert mistake(compared(motion, seed=seed)) is None


@pytest.mark.parametrize("scale", [MISTAKES["the gyroscope gave deg/s"], MISTAKES["its axes were left-handed"]])
def test_standing_tells_nothing(scale):
    assert mistake(compared(standing, scale)) is None


def test_where_the_readings_explain_most_stretches_nothing_is_said():
    wrong = compared(turning, MISTAKES["the gyroscope gave deg/s"], RECEIVERS[:1])
    right = compared(turning, 1.0, RECEIVERS[:1])
    assert mistake([*wrong, *right]) is not None
    assert mistake([*wrong[:4], *right]) is None


def test_three_stretches_are_needed():
    scale = MISTAKES["the accelerometer gave multiples of g"]
    few = compared(turning, scale, RECEIVERS[:1])
    assert mistake([]) is None
    assert len(few) >= 4
    assert mistake(few[:2]) is None
    assert mistake(few[:3]) is not None
