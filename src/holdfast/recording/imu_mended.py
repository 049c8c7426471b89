"""An IMU beside GNSS receivers: what its readings are to be multiplied by, and the clocks that are seen with that."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from holdfast.config.sensors import MOST_OFFSET_S
from holdfast.messages import Array
from holdfast.recording.clock_offset import ClockOffset, clock_offset
from holdfast.recording.imu_at_rest import UNITS_OF_GRAVITY, force_unit_m_s2
from holdfast.recording.imu_convention import MISTAKES, SPAN_S, mistake
from holdfast.recording.stretch import Stretch, stretches

FAR_S = 1.0  # a delay that may be a clock: leap seconds, a machine that was set by hand
FACTORS = "gyroscope_factors", "accelerometer_factors"  # keys of an IMU
MOST_MISTAKES = 3  # at once: both sensors in other units, and a sign


class Received(NamedTuple):
    """What one topic of a receiver says.

    Attributes:
        times_s: (M,) stamps, increasing.
        values: (M, 3) velocities [m/s] or positions [m] in a frame whose z axis is up.
        order: 1 for velocities, 2 for positions.
        behind_s: by how much its messages arrive later after their stamps than those of the IMU.
    """

    times_s: Array
    values: Array
    order: int
    behind_s: float


class Mended(NamedTuple):
    """An IMU whose readings are as they should be, as far as receivers beside it tell.

    Attributes:
        times_s: (N,) stamps, increasing.
        readings: (N, 6) angular velocity [rad/s] and specific force [m/s^2].
        factors: (6,) by which what the driver said was multiplied.
        mistakes: of the driver, in words.
        offsets: of the receivers' clocks, by topic; None where too little moved.
    """

    times_s: Array
    readings: Array
    factors: Array
    mistakes: tuple[str, ...]
    offsets: dict[str, ClockOffset | None]

    @property
    def needed(self) -> dict[str, Array]:
        """The factors (3,) by key, of those that are not one."""
        parts = dict(zip(FACTORS, np.split(self.factors, 2), strict=True))
        return {key: factors for key, factors in parts.items() if (factors != 1.0).any()}


def mended(times_s: Array, readings: Array, received: Mapping[str, Received]) -> Mended:
    """Return an IMU with the factors that let it go with the receivers.

    Args:
        times_s: (N,) stamps, increasing.
        readings: (N, 6) of gyroscope and accelerometer, as their driver says them.
        received: topics of receivers whose velocities are what they should be.
    """
    unit_m_s2 = force_unit_m_s2(times_s, readings)
    factors, mistakes = np.repeat([1.0, unit_m_s2], 3), list[str]()
    if unit_m_s2 != 1.0:
        mistakes.append(f"gravity shows that its accelerometer gives {UNITS_OF_GRAVITY[unit_m_s2]}")
    while True:
        offsets, compared = _compared(times_s, readings * factors, received)
        found = mistake(compared) if len(mistakes) < MOST_MISTAKES else None
        if found is None:
            return Mended(times_s, readings * factors, factors, tuple(mistakes), offsets)
        explanation, times = found
        factors = factors * MISTAKES[explanation]
        mistakes.append(
            f"it goes with the motion of the antennas as if {explanation} (residuals {times:.1f} times smaller)"
        )


def _compared(
    times_s: Array, readings: Array, received: Mapping[str, Received]
) -> tuple[dict[str, ClockOffset | None], list[Stretch]]:
    """Return the offsets of the receivers' clocks, and the stretches in which they and the IMU are compared."""
    offsets, compared = dict[str, ClockOffset | None](), list[Stretch]()
    for topic, one in received.items():
        offsets[topic], apart_s = _offset(times_s, readings, one)
        compared += stretches(times_s, readings, one.times_s + apart_s, one.values, one.order, span_s=SPAN_S)
    return offsets, compared


def _offset(times_s: Array, readings: Array, one: Received) -> tuple[ClockOffset | None, float]:
    """Return the offset of a clock, and by how much (0 else) its stamps go with the IMU as late as they arrive."""
    as_stamped = clock_offset(times_s, readings, one.times_s, one.values, one.order)
    if FAR_S < abs(one.behind_s) <= MOST_OFFSET_S:
        as_arrived = clock_offset(times_s, readings, one.times_s + one.behind_s, one.values, one.order)
        if as_arrived is not None and (as_stamped is None or as_stamped.stretches < as_arrived.stretches):
            return replace(as_arrived, offset_s=as_arrived.offset_s + one.behind_s), one.behind_s
    return as_stamped, 0.0
