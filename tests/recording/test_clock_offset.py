"""The clock of a receiver is measured by accelerations: neither lever arm, mount, biases nor noise make an offset."""

import numpy as np
import pytest
from driven import POSITIONS, VELOCITIES, driven, received, standing, straight, turning

from holdfast.recording.clock_offset import ClockOffset, clock_offset, pooled

RTK, CONSUMER, DOPPLER = 0.01, 0.3, 0.05


@pytest.mark.parametrize("motion", [turning, straight])
@pytest.mark.parametrize(("order", "sigma", "rate_hz"), [(POSITIONS, RTK, 5), (VELOCITIES, DOPPLER, 2)])
@pytest.mark.parametrize("early_s", [-0.1, 0.0, 0.1, 0.3])
def test_an_offset_is_found_and_a_lever_arm_makes_none(motion, order, sigma, rate_hz, early_s):
    found = clock_offset(*driven(motion), *received(motion, order, sigma, early_s, rate_hz), order)
    assert found is not None
    assert abs(found.offset_s - early_s) < 3.0 * found.sigma_s
    assert 0.01 <= found.sigma_s < 0.03
    assert found.is_clear() == (early_s != 0.0)


@pytest.mark.parametrize("seed", range(6))
def test_the_sigma_is_honest_and_noise_makes_no_clear_offset(seed):
    for order, sigma in ((POSITIONS, CONSUMER), (VELOCITIES, DOPPLER)):
        found = clock_offset(*driven(turning, seed), *received(turning, order, sigma, 0.0, 2, seed), order)
        assert found is None or (abs(found.offset_s) < 3.0 * found.sigma_s and not found.is_clear())


def test_the_outliers_of_a_receiver_move_nothing():
    stamps, fixes = received(turning, POSITIONS, RTK, 0.1, 5)
    fixes[::37] += [4.0, -7.0, 9.0]
    found = clock_offset(*driven(turning), stamps, fixes, POSITIONS)
    assert found is not None
    assert found.offset_s == pytest.approx(0.1, abs=0.02)


def test_without_motion_or_with_too_few_fixes_nothing_is_found():
    assert clock_offset(*driven(standing), *received(standing, VELOCITIES, 0.05, 0.2, 5), VELOCITIES) is None
    few = received(turning, POSITIONS, RTK, 0.2, 0.2)
    assert clock_offset(*driven(turning), *few, POSITIONS) is None
    assert clock_offset(np.empty(0), np.empty((0, 6)), *few, POSITIONS) is None


def test_an_offset_beyond_the_grid_is_not_guessed():
    assert clock_offset(*driven(turning), *received(turning, POSITIONS, RTK, 2.0, 5), POSITIONS) is None


def test_stretches_with_a_gap_of_the_imu_are_left_out():
    t, readings = driven(turning)
    kept = (t < 30.0) | (t > 31.0)
    receiver = received(turning, POSITIONS, RTK, 0.1, 5)
    whole, cut = (
        clock_offset(t, readings, *receiver, POSITIONS),
        clock_offset(t[kept], readings[kept], *receiver, POSITIONS),
    )
    assert whole is not None and cut is not None
    assert cut.stretches == whole.stretches - 1


def test_clear_is_beyond_thirty_milliseconds_and_three_sigma():
    assert ClockOffset(-0.05, 0.016, 5).is_clear()
    assert not ClockOffset(-0.05, 0.017, 5).is_clear()
    assert not ClockOffset(0.029, 0.005, 5).is_clear()


def test_fixes_and_velocities_are_pooled_unless_they_contradict_each_other():
    one, other = ClockOffset(0.08, 0.02, 4), ClockOffset(0.1, 0.02, 5)
    mean, same = pooled(one, other)
    assert mean == same
    assert mean is not None
    assert (mean.offset_s, mean.sigma_s, mean.stretches) == pytest.approx((0.09, 0.02 / np.sqrt(2.0), 9))
    late = ClockOffset(0.2, 0.02, 5)
    assert pooled(one, late) == (one, late)
    assert pooled(one, None) == (one, one)
    assert pooled(None, None) == (None, None)
