"""The parts of the compiled turn joint under names of their own, so that each can be tested alone."""

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from alone import alone
from slewing import AT_REST, machine

from holdfast.chassis.encoder import JointModel
from holdfast.chassis.kinematics import BaseGeometry
from holdfast.chassis.turn_joint import OUTCOMES, ROTATIONS, TurnJoint, joint_record
from holdfast.kernel import joint_filter, layout, turn_joint

predict, add_rate = alone(joint_filter.predict), alone(joint_filter.add_rate)
rotation_until, add_angle = alone(joint_filter.rotation_until), alone(joint_filter.add_angle)
hidden_rotation, advance = alone(turn_joint.hidden_rotation), alone(turn_joint.advance)

NO_GYRO_GAP_NS = 10**9
MOUNT = BaseGeometry(machine()).record(has_joint=True)[0]


class JointFilter:
    """The filter, with a base gyroscope of given variances or without one."""

    def __init__(self, gyro, memory_ns, accept_after_ns):
        config = machine()
        if gyro is not None:
            gyro = SimpleNamespace(**vars(gyro), max_gap_ns=NO_GYRO_GAP_NS)
        self.record = joint_record(JointModel(config.joint[1]), gyro, config)
        self.one, self.rotations = self.record[0], np.zeros(ROTATIONS, layout.ROTATION)
        self.one["memory_ns"] = memory_ns + round(joint_filter.MAX_LAG_S * 1e9)
        self.one["accept_after_ns"] = accept_after_ns

    def __getattr__(self, name):
        return self.one[name].item()

    @property
    def angle_variance(self):
        return self.one["P"][0]

    @property
    def bias_variance(self):
        return self.one["P"][7]

    def predict(self, stamp_ns, cabin_rate_rad_s, cabin_density2):
        predict(self.one, self.rotations, stamp_ns, cabin_rate_rad_s, cabin_density2)

    def add_rate(self, stamp_ns, rate_rad_s, variance):
        add_rate(self.one, stamp_ns, rate_rad_s, variance)

    def rotation_until(self, stamp_ns):
        return rotation_until(self.one, self.rotations, stamp_ns)

    def add_angle(self, stamp_ns, angle_rad, variance, rotation_rad):
        row = add_angle(self.one, self.rotations, stamp_ns, float(angle_rad), variance, rotation_rad)
        return OUTCOMES[row]


class RepeatMonitor:
    """Whether the encoder repeats itself, with readings of a variance."""

    def __init__(self, variance):
        self.one = np.zeros(1, layout.REPEATS)[0]
        self.one["step_rad"], self.one["least_rad"] = np.inf, 10.0 * np.sqrt(variance)

    @property
    def is_frozen(self):
        return bool(self.one["is_frozen"])

    def hidden_rotation(self, stamp_ns, reading_rad, rotation_rad, noise):
        known = (-1.0, -1.0) if noise is None else noise
        return hidden_rotation(self.one, stamp_ns, reading_rad, rotation_rad, *known)


class Motion(NamedTuple):
    angle_rad: float
    angle_sigma_rad: float
    rate_rad_s: float
    rate_sigma_rad_s: float


class JointOverTime(TurnJoint):
    """`TurnJoint`, advanced without a cabin."""

    def advance(self, stamp_ns, cabin_rate_rad_s, *, from_imu):
        one, rates = self.record[0], (float(cabin_rate_rad_s), np.array([0.0, 0.0, cabin_rate_rad_s]))
        known = one, self.rotations, self.waiting, MOUNT, stamp_ns
        is_known = advance(*known, *rates, AT_REST, from_imu)
        self.count()
        return Motion(*one["motion"].tolist()) if is_known else None
