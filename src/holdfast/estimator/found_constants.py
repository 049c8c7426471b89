"""Constants of sensors that are far from what is configured, as a start finds them."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from holdfast.estimator.batch_clock import Offset
from holdfast.estimator.collected import Collected
from holdfast.estimator.fitting_batch import FittingBatches
from holdfast.messages import Array
from holdfast.sensors.clock import GNSS_CLOCK
from holdfast.sensors.heading import MOUNT
from holdfast.sensors.lever_arm import GNSS_ARM
from holdfast.sensors.sensor import Parameter, part_of


class FoundConstants:
    """Where antennas are, the clock of GNSS and how headings are mounted: believed of all that a start is made of.

    Args:
        batches: what a start is made of.
        collected: and from what.
        clock: of GNSS, before anything is measured; None without GNSS.
        headings: the sensors, by name; they are replaced where they are found to be mounted otherwise.
        before: what was found before.

    Attributes:
        priors: what was found until now, by name, as a graph takes it.
    """

    def __init__(
        self,
        batches: FittingBatches,
        collected: Collected,
        clock: Parameter | None,
        headings: dict[str, Any],
        before: Mapping[str, Parameter] = MappingProxyType({}),
    ) -> None:
        self._batches, self._collected, self._clock, self._before = batches, collected, clock, before
        self._headings, self._mounted = headings, dict(headings)
        self.priors: dict[str, Parameter] = {}
        self.forget()
        self._is_forgotten = False

    def newly_forgotten(self) -> bool:
        """Whether it was forgotten since this was asked last."""
        is_new, self._is_forgotten = self._is_forgotten, False
        return is_new

    def forget(self) -> None:
        """Know what was found before, and nothing else."""
        self._is_forgotten = True
        self.priors.clear()
        self._batches.put_back_antennas()
        self._batches.ask_for_clock()
        self._know_clock(None)
        self.turn_headings({name: one.mean for name, one in self._before.items()})
        if (shift := self._before.get(GNSS_ARM)) is not None:
            self.move_antennas(shift)
        if (clock := self._before.get(GNSS_CLOCK)) is not None:
            self._know_clock(clock)

    def move_antennas(self, shift: Parameter) -> None:
        """Know that antennas are elsewhere than they were believed to be."""
        self._batches.move_antennas(shift)
        before = self.priors[GNSS_ARM].mean if GNSS_ARM in self.priors else 0.0
        self.priors[GNSS_ARM] = shift._replace(mean=before + shift.mean)

    def turn_headings(self, off: Mapping[str, Array]) -> None:
        """Know by how much (1,) [rad] headings are mounted otherwise than configured, by the name of the constant."""
        for name, sensor in self._mounted.items():
            mount = part_of(sensor.parameters, MOUNT)
            known = None if mount is None else off.get(mount.name(name))
            self._headings[name] = sensor if known is None else sensor.turned(float(known[0]))

    def know_clock_off(self, offset: Offset) -> None:
        """Know that the clock of GNSS is off by so much from what was known."""
        assert self._clock is not None
        by_s = self._collected.clock_ns * 1e-9 + offset.by_s
        sigmas = np.hypot(self._clock.sigmas, offset.sigma_s)
        self._know_clock(self._clock._replace(mean=np.array([by_s]), sigmas=sigmas, if_right=None))

    def _know_clock(self, clock: Parameter | None) -> None:
        """Know by how much stamps of GNSS are early [s]; None: by nothing."""
        if clock is not None:
            self.priors[GNSS_CLOCK] = clock
        self._collected.know_clock(0 if clock is None else round(float(clock.mean[0]) * 1e9))
