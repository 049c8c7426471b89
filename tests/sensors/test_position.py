"""Where points of the machine are, of one or of many."""

import gtsam
import numpy as np

from holdfast.sensors.position import Motion, predicted_position

NAV = gtsam.NavState(gtsam.Rot3.RzRyRx(0.1, -0.2, 0.7), np.array([1.0, 2.0, 3.0]), np.array([2.0, -1.0, 0.1]))
RATE, ARM, LATER_S = np.array([0.1, -0.3, 0.8]), np.array([-1.0, 0.8, 2.0]), 1e-3


def test_a_point_is_carried_along_by_velocity_and_turn():
    later = gtsam.Pose3(NAV.attitude() * gtsam.Rot3.Expmap(RATE * LATER_S), NAV.position() + NAV.velocity() * LATER_S)
    found = predicted_position(Motion.of(NAV, RATE), ARM, LATER_S)
    np.testing.assert_allclose(found, later.transformFrom(ARM), rtol=0, atol=2.0 * LATER_S**2)  # linear in time


def test_many_at_once_are_one_after_the_other():
    navs = [NAV.retract(np.full(9, 0.1 * k)) for k in range(3)]
    arms, offsets_s = ARM * np.array([[1.0], [0.5], [-2.0]]), np.array([0.0, 0.01, -0.02])
    motion = Motion(*(np.array(part) for part in zip(*(Motion.of(nav, RATE) for nav in navs), strict=True)))
    one_by_one = [
        predicted_position(Motion.of(nav, RATE), arm, offset_s)
        for nav, arm, offset_s in zip(navs, arms, offsets_s, strict=True)
    ]
    np.testing.assert_allclose(predicted_position(motion, arms, offsets_s), one_by_one, rtol=0, atol=1e-15)
