"""Messages whose numbers mean nothing: what a driver publishes that has lost its mind."""

from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from holdfast.messages import Array
from holdfast.sim.fault import Fault
from holdfast.sim.readings import generator
from holdfast.sim.ros import Encode

NUMBERS = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e18, 5e-324, 0.0)
"""What stands in place of measurements."""
VARIANCES = (0.0, -1.0, np.nan, np.inf, 1e300, 5e-324)
"""What stands in place of covariances."""
SECONDS = (0, 1, -1, -(2**31), 2**31 - 1)
NANOSECONDS = (0, 999_999_999, 2**32 - 1)
"""What stands in place of the parts of a stamp; a ROS message holds any 32 bits."""


class Garbage:
    """What the faults of kind `garbage` leave of the messages of one sensor.

    Args:
        faults: of the scenario.
        name: of the sensor.
        times_s: (N,) true times of its messages.
        seed: of the simulation.
    """

    def __init__(self, faults: Sequence[Fault], name: str, times_s: Array, seed: int) -> None:
        rng = generator(seed, name, "garbage")
        chance = np.zeros(len(times_s))
        for fault in faults:
            if fault.kind == "garbage" and name in fault.sensors:
                inside = fault.holds(times_s)
                chance[inside] = np.maximum(chance[inside], fault.garbage_ratio)
        self._struck = rng.random(len(times_s)) < chance
        self._seeds = rng.integers(2**32, size=len(times_s))

    def in_place_of(self, encode: Encode) -> Encode:
        """Return what makes the messages of rows and stamps, those that were struck among them."""

        def garbled(row: int, stamp_ns: int) -> Any:
            message = encode(row, stamp_ns)
            if self._struck[row]:
                spoil(message, np.random.default_rng(self._seeds[row]))
            return message

        return garbled if self._struck.any() else encode


def spoil(message: Any, rng: np.random.Generator) -> None:
    """Replace the stamp, the covariances, some of the numbers or all of them, in place."""
    what = rng.choice(["stamp", "covariances", "some", "all"])
    if what == "stamp":
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = int(rng.choice(SECONDS)), int(rng.choice(NANOSECONDS))
        return
    for owner, name in list(_numbers(message)):
        is_covariance = "covariance" in name
        if is_covariance is (what == "covariances") and (what != "some" or rng.random() < 0.5):
            value = float(rng.choice(VARIANCES if is_covariance else NUMBERS))
            before = getattr(owner, name)
            setattr(owner, name, np.full_like(before, value) if isinstance(before, np.ndarray) else value)


def _numbers(message: Any) -> Iterator[tuple[Any, str]]:
    """Yield every field that holds floating-point numbers, with the part of the message that has it."""
    for one in fields(message):
        value = getattr(message, one.name)
        if is_dataclass(value):
            yield from _numbers(value)
        elif isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype.kind == "f"):
            yield message, one.name
