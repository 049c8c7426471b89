"""From the configuration to the models of its sensors, by the names that the user gives them."""

import numpy as np
import pytest
from motion import ARM, ARM_RIGHT, T_I_L, at, machine
from slewing import machine as slewing_machine

from holdfast.config.model import Config
from holdfast.config.sensors import GnssConfig
from holdfast.messages import GnssFix, Heading, JointAngle, SensorPose, Twist
from holdfast.sensors.gnss import GnssModel
from holdfast.sensors.registry import inputs_of, sensors_of
from holdfast.sensors.sensor import MAKERS, Role, register

WHEELS = {"kind": "twist", "mount": at([1.0, 0.0, 0.0])}
NO_SLIP = {"kind": "nonholonomic", "topic": None, "frame": "wheels"}


def test_each_sensor_has_its_name_its_role_and_its_mounting():
    sensors = sensors_of(machine(right=True, heading=True, more={"wheels": WHEELS}))
    roles = {name: sensor.role for name, sensor in sensors.items()}
    assert roles == {
        "gnss": Role.POSITION,
        "gnss_right": Role.POSITION,
        "lidar": Role.ODOMETRY,
        "heading": Role.HEADING,
        "wheels": Role.STATE,
    }
    assert [sensor.name for sensor in sensors.values()] == list(sensors)
    np.testing.assert_allclose(sensors["gnss"].p_I_P, ARM)
    np.testing.assert_allclose(sensors["gnss_right"].p_I_P, ARM_RIGHT)
    np.testing.assert_allclose(sensors["lidar"].adjoint, T_I_L.AdjointMap(), atol=1e-12)


def test_the_messages_that_are_needed_are_those_of_sensors_that_have_any():
    inputs = inputs_of(machine(heading=True, more={"wheels": WHEELS, "no_slip": NO_SLIP}))
    assert inputs == {"gnss": GnssFix, "lidar": SensorPose, "heading": Heading, "wheels": Twist}


@pytest.mark.parametrize(("frame", "needs_joint"), [("base_link", True), ("cabin", False)])
def test_the_encoder_is_needed_where_a_sensor_sits_beyond_the_turn_joint(frame, needs_joint):
    sections = slewing_machine().model_dump(exclude_unset=True)
    sections["sensors"]["wheels"] = {"kind": "twist", "topic": "/wheels", "frame": frame}
    inputs = inputs_of(Config.model_validate(sections))
    assert inputs == {"wheels": Twist} | ({"joint": JointAngle} if needs_joint else {})


def test_a_maker_that_is_registered_makes_the_sensors_of_its_section(monkeypatch):
    monkeypatch.setitem(MAKERS, GnssConfig, MAKERS[GnssConfig])  # as it is now, after the test

    class Better(GnssModel):
        pass

    register(GnssConfig, lambda name, section, _: Better(name, section, np.zeros(3)))
    assert isinstance(sensors_of(machine())["gnss"], Better)
