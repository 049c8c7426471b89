"""A velocity whose axes or unit are wrong is found by the fixes of the same receiver, and no other one."""

import numpy as np
import pytest
from driven import POSITIONS, VELOCITIES, received, standing, straight, turning

from holdfast.recording.velocity_convention import KNOT_M_S, MISTAKES, mistake

NED, KM_H, KNOTS, VEHICLE, SIGNS = MISTAKES


def told(motion, why=None, sigma_m=0.3, late_s=0.1):
    """Fixes of a consumer receiver, and its Doppler velocities as a driver with a mistake gives them."""
    fixes = received(motion, POSITIONS, sigma_m, 0.0, 2)
    stamps, velocities = received(motion, VELOCITIES, 0.05, -late_s, 4)
    wrong = {
        None: velocities,
        NED: velocities[:, [1, 0, 2]] * [1.0, 1.0, -1.0],
        KM_H: velocities * 3.6,
        KNOTS: velocities / KNOT_M_S,
        VEHICLE: np.linalg.norm(velocities, axis=1)[:, None] * [1.0, 0.0, 0.0],
        SIGNS: -velocities,
    }
    return *fixes, stamps, wrong[why]


@pytest.mark.parametrize(
    ("why", "motion"),
    [*((why, turning) for why in MISTAKES), *((why, straight) for why in (NED, KM_H, KNOTS, SIGNS))],  # it goes east
)
def test_every_mistake_is_named(why, motion):
    found = mistake(*told(motion, why))
    assert found is not None
    assert found[0] == why
    assert found[1] > 2.0


@pytest.mark.parametrize("motion", [turning, straight, standing])
@pytest.mark.parametrize("late_s", [0.0, 0.3])
def test_what_is_right_is_not_accused(motion, late_s):
    assert mistake(*told(motion, late_s=late_s)) is None


@pytest.mark.parametrize("why", MISTAKES)
def test_standing_and_little_data_tell_nothing(why):
    assert mistake(*told(standing, why)) is None
    fix_s, positions, velocity_s, velocities = told(turning, why)
    assert mistake(fix_s[:10], positions[:10], velocity_s, velocities) is None
    assert mistake(fix_s, positions, velocity_s[:3], velocities[:3]) is None
