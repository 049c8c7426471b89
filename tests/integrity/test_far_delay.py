"""What is of the machine seconds before or after its stamps is told from all else: headings, and rates of turning."""

import numpy as np
import pytest

from holdfast.integrity.far_delay import FarDelay, Seen

SIGMA_RAD = 0.01


def swung(t):
    """An excavator that slews to and fro."""
    return 3.0 + 1.2 * np.sin(0.35 * t) + 0.4 * np.sin(0.9 * t)


def round_and_round(t):
    """A machine on a circle."""
    return 0.3 * t


def found(measured, *, yaw=swung, hz=5.0, until_s=45.0):
    """Return the first delay that is found, of headings that an estimate whose own is right compares with it."""
    rng, late = np.random.default_rng(0), FarDelay(np.radians(1.0), is_angle=True)
    for t in np.arange(0.0, until_s, 1.0 / hz):
        seen = measured(t) + SIGMA_RAD * rng.standard_normal()
        wrapped = np.angle(np.exp(1j * seen))
        late.note(Seen(round(t * 1e9), wrapped, SIGMA_RAD, np.angle(np.exp(1j * yaw(t)))))
        if (delay_s := late.delay_s()) is not None:
            return delay_s
    return None


@pytest.mark.parametrize("hz", [1.0, 5.0, 20.0])
@pytest.mark.parametrize("late_s", [-2.5, -0.4, 0.4, 1.0, 2.5])
def test_a_delay_is_found_whatever_the_mounting(hz, late_s):
    assert found(lambda t: swung(t - late_s) + 2.0, hz=hz) == pytest.approx(late_s, abs=0.05)


@pytest.mark.parametrize(
    "measured",
    [
        swung,
        lambda t: swung(t) + 2.0,  # mounted otherwise
        lambda t: -swung(t),  # clockwise
        lambda t: swung(t - 0.2),  # the graph finds that
        lambda t: swung(t - 5.0),  # more than is tried
        lambda t: swung(t) + 0.5 * np.sin(3.0 * swung(t)),  # beside iron
        lambda _: 1.0,  # stuck
        lambda t: 0.8 * swung(t),
    ],
)
def test_nothing_else_is_taken_for_it(measured):
    assert found(measured) is None


def test_on_a_circle_a_delay_is_a_mounting():
    assert found(lambda t: round_and_round(t - 1.0), yaw=round_and_round) is None


def test_what_stands_tells_nothing():
    assert found(lambda _: 1.0, yaw=lambda t: 1.0 + 0.01 * np.sin(t)) is None


@pytest.mark.parametrize("late_s", [-2.0, 0.5, 1.3])
def test_numbers_that_are_late_are_found_though_they_are_beside_by_a_constant(late_s):
    rng, late, delays = np.random.default_rng(0), FarDelay(0.03, is_angle=False), []
    for t in np.arange(0.0, 40.0, 0.4):
        measured = abs(0.4 * np.sin(0.6 * (t - late_s))) + 0.1 + 0.01 * rng.standard_normal()
        late.note(Seen(round(t * 1e9), measured, 0.0, abs(0.4 * np.sin(0.6 * t))))
        delays.append(late.delay_s())
    assert next(one for one in delays if one is not None) == pytest.approx(late_s, abs=0.05)
