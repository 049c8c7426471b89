"""`TurnJoint`: readings wait for their stamp, corrections flow in, and the state of the encoder is known."""

import numpy as np
import pytest
from compiled import JointOverTime
from slewing import AT_REST, machine, ns

from holdfast.chassis.base_gyro import BaseGyro
from holdfast.chassis.encoder import JointModel
from holdfast.event_log import EventLog
from holdfast.events import Outcome
from holdfast.kernel.turn_joint import MAX_STEP_RAD
from holdfast.messages import ImuSample, JointAngle
from holdfast.state import EncoderState


class Standing:
    """A joint at 100 Hz, where nothing turns but what is asked for."""

    def __init__(self, has_gyro=True):
        config, self.log, self.t, self.has_gyro = machine(), EventLog("imu"), 0.0, has_gyro
        gyro = BaseGyro(config.base_imu[1], np.eye(4)) if has_gyro else None
        self.joint = JointOverTime(JointModel(config.joint[1]), gyro, config, self.log)

    @property
    def counts(self):
        self.joint.count()
        return self.log.counts

    def read(self, angle, stamp_s=None):
        t = self.t if stamp_s is None else stamp_s
        self.joint.add(JointAngle(ns(t), ns(self.t), "joint", angle), ns(self.t))

    def go(self, seconds, angle=None, cabin=0.0):
        """Go on; the encoder reads an angle, if one is given."""
        for _ in range(round(seconds * 100)):
            self.t += 0.01
            self.motion = self.joint.advance(ns(self.t), cabin, from_imu=True)
            if self.has_gyro:
                self.joint.add(ImuSample(ns(self.t), ns(self.t), "base_imu", np.zeros(3), AT_REST), ns(self.t))
            if angle is not None:
                self.read(angle)
        return self.motion


def test_before_the_first_reading_no_angle_is_known():
    standing = Standing()
    assert standing.go(1.0) is None
    assert standing.joint.encoder is EncoderState.ABSENT
    assert standing.go(0.1, 0.5).angle_rad == pytest.approx(0.5)
    assert standing.joint.encoder is EncoderState.OK


def test_the_sigma_of_the_angle_has_that_of_the_encoders_zero():
    motion = Standing().go(5.0, 0.5)
    assert motion.angle_sigma_rad == pytest.approx(np.radians(0.1), rel=0.05)


def test_a_reading_that_is_ahead_waits_until_the_estimate_has_reached_it():
    standing = Standing()
    standing.go(1.0, 0.5)
    used = standing.counts["joint", Outcome.USED]
    standing.read(0.5, standing.t + 0.055)
    standing.go(0.05)
    assert standing.counts["joint", Outcome.USED] == used
    standing.go(0.01)
    assert standing.counts["joint", Outcome.USED] == used + 1


@pytest.mark.parametrize(("age_s", "outcome"), [(0.1, Outcome.USED), (0.3, Outcome.LATE)])
def test_a_reading_may_be_as_old_as_configured(age_s, outcome):
    standing = Standing()
    standing.go(1.0, 0.5)
    before = standing.counts["joint", outcome]
    standing.read(0.5, standing.t - age_s - 0.003)
    assert standing.counts["joint", outcome] == before + 1


def test_a_silent_encoder_is_late_and_the_angle_goes_on_by_the_gyroscopes():
    standing = Standing()
    standing.go(5.0, 0.5)
    sigma = standing.motion.angle_sigma_rad
    motion = standing.go(2.0, cabin=0.3)
    assert standing.joint.encoder is EncoderState.LATE
    assert motion.angle_rad == pytest.approx(0.5 + 0.6, abs=5e-3)
    assert motion.angle_sigma_rad > sigma


def test_an_encoder_that_repeats_itself_while_the_cabin_turns_is_frozen_and_counted():
    standing = Standing()
    standing.go(5.0, 0.5)
    motion = standing.go(1.0, 0.5, cabin=0.5)
    assert standing.joint.encoder is EncoderState.FROZEN
    assert standing.counts["joint", Outcome.FROZEN] > 50
    assert motion.angle_rad == pytest.approx(1.0, abs=0.02)


def test_a_correction_flows_in_without_a_step():
    """After a silence of 5 s in which the joint turned unseen by 30 mrad."""
    standing = Standing()
    standing.go(5.0, 0.5)
    before = standing.go(5.0).angle_rad
    angles = [before] + [standing.go(0.01, 0.53).angle_rad for _ in range(1000)]
    assert abs(np.diff(angles)).max() < MAX_STEP_RAD + 0.03 * 0.01 / 0.5 * 1.1
    assert angles[-1] == pytest.approx(0.53, abs=1e-3)


def test_without_a_base_gyroscope_its_samples_are_ignored():
    standing = Standing(has_gyro=False)
    standing.go(1.0, 0.5)
    standing.joint.add(ImuSample(ns(standing.t), ns(standing.t), "base_imu", np.zeros(3), AT_REST), ns(standing.t))
    assert standing.counts["base_imu", Outcome.IGNORED] == 1
