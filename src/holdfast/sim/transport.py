"""When a sensor measures, what its clock shows then, and when its messages reach the recording, if they do.

True time is the clock of the recording computer, so that log times are true times. One ROS topic over one connection
keeps its order in reality; here every message is delayed on its own, and jitter of more than a period reorders them:
harder than reality, for whoever has to read the recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array
from holdfast.sim.datasheets import Clock, SimulatedSensor
from holdfast.sim.fault import Fault
from holdfast.sim.readings import Readings


@dataclass(frozen=True, slots=True, eq=False)
class Delivered:
    """Messages of one sensor that arrived, in the order of measurement; a copy follows its original.

    Attributes:
        readings: what they report, with the true times; N rows, those of messages that arrived twice repeated.
        stamps_ns: (N,) of their headers: since the epoch, on the sensor's clock.
        arrivals_ns: (N,) log times: since the epoch, on the clock of the recording computer.
    """

    readings: Readings
    stamps_ns: NDArray[np.int64]
    arrivals_ns: NDArray[np.int64]


def sample_times_s(rate_hz: float, duration_s: float, phase_s: float = 0.0) -> Array:
    """Return the true times k / rate + phase before `duration_s`, k = 0, 1, ...; no rounding adds up."""
    count = max(0, int(np.ceil((duration_s - phase_s) * rate_hz)) + 1)
    times = np.arange(count) / rate_hz + phase_s
    return times[times < duration_s]


def deliver(
    readings: Readings,
    sensor: SimulatedSensor,
    faults: Sequence[Fault],
    start_ns: int,
    rng: np.random.Generator,
) -> Delivered:
    """Return the messages of a sensor that arrive, with their stamps and log times.

    stamp = start + t + offset + drift t + jitter + steps of the clock at t; arrival = start + t + ready + latency +
    exponential jitter. A copy of a message sets off when the original arrives, with a fresh delay; so does the message
    of a twin, whose stamp and content are its own.

    Args:
        readings: one row per message.
        sensor: its clock and transport.
        faults: of this sensor; a `clock_step` and a `twin` are active from their start until before their end.
        start_ns: time of the scenario's start since the epoch.
        rng: random numbers of this sensor's transport alone.
    """
    times_s, transport = readings.times_s, sensor.transport
    count = len(times_s)
    # all numbers are drawn whatever the settings: losing messages does not change the delays of the others
    stamp_noise = rng.standard_normal(count)
    jitters_s = transport.jitter_s * rng.standard_exponential((2, count))
    lost, twice = rng.random((2, count)) < [[transport.loss_ratio], [transport.duplicate_ratio]]

    is_twin, twin_step_s, behind = _twins(faults, times_s)
    stamps_s = _clock_s(sensor.clock, faults, times_s) + sensor.clock.jitter_s * stamp_noise
    first_s = times_s + sensor.ready_s + transport.latency_s + jitters_s[0]
    copy_s = first_s + transport.latency_s + jitters_s[1]
    rows = np.repeat(np.arange(count), np.where(lost, 0, 1 + (twice | is_twin)))
    is_copy = np.diff(rows, prepend=-1) == 0
    arrivals_s = np.where(is_copy, copy_s[rows], first_s[rows])
    of_twin = is_copy & is_twin[rows]
    stamps_s = stamps_s[rows] + np.where(of_twin, twin_step_s[rows], 0.0)
    content = readings.taken(np.maximum(rows - np.where(of_twin, behind[rows], 0), 0))
    return Delivered(content, _since_epoch(start_ns, stamps_s), _since_epoch(start_ns, arrivals_s))


def _active(fault: Fault, times_s: Array) -> NDArray[np.bool_]:
    return (fault.start_s <= times_s) & (times_s < fault.end_s)


def _twins(faults: Sequence[Fault], times_s: Array) -> tuple[NDArray[np.bool_], Array, NDArray[np.int64]]:
    """Return (N,) whether a twin sends a message too, how far its stamp is off [s], and how many it is behind."""
    is_twin, step_s, behind = np.zeros(len(times_s), np.bool_), np.zeros(len(times_s)), np.zeros(len(times_s), np.int64)
    for fault in faults:
        if fault.kind == "twin":
            rows = _active(fault, times_s)
            is_twin[rows], step_s[rows], behind[rows] = True, fault.step_s, fault.behind
    return is_twin, step_s, behind


def _clock_s(clock: Clock, faults: Sequence[Fault], times_s: Array) -> Array:
    """Return what the sensor's clock shows at true times (N,), both since the start of the scenario."""
    shown_s = times_s + clock.offset_s + clock.drift_ppm * 1e-6 * times_s
    for step in faults:
        if step.kind == "clock_step":
            shown_s = shown_s + step.step_s * _active(step, times_s)
    return shown_s


def _since_epoch(start_ns: int, times_s: Array) -> NDArray[np.int64]:
    """Return whole nanoseconds; the epoch is added as an integer because a double resolves it to 240 ns only."""
    return start_ns + np.rint(times_s * 1e9).astype(np.int64)
