"""How much larger or smaller the noise of a sensor is than it claims, as its innovations show over the last minute."""

from math import exp, log, sqrt

import numpy as np

from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.integrity.learnt_snapshot import LearntNoiseScale
from holdfast.integrity.white_noise import WhiteNoise
from holdfast.sensors.noise import FREE_VARIANCE
from holdfast.sensors.sensor import Innovation, Measurement, State

MEMORY_S = 20.0
MEAN_S = 5.0  # over which innovations are averaged whose logarithm tells how much is claimed too much
MAX_WEIGHT_S = 1.0  # of one measurement
MAX_RATIO = 9.0  # one measurement tells no more, whatever its innovation
LEAST_MEAN = 0.01  # less tells no more
LOWEST, HIGHEST = 1.0, 100.0  # of the factor on the covariance
DEAD_BAND = log(2.0)
LEVEL = log(4.0)  # twice or half the sigma
NEWS = 0.75  # levels from the one that was told last


class NoiseScale:
    """The factor on the covariance of one sensor: (48) in docs/math.md; and which part of that is white.

    Args:
        carried: what was learnt before.
    """

    def __init__(self, carried: LearntNoiseScale | None = None) -> None:
        self._log = 0.0 if carried is None else carried.log_factor
        self._raised = 0.0  # log of the factor, while it is raised
        self._weighed = 0.0  # log of the factor by which claims are multiplied before they come here
        self._mean = 1.0  # of the innovations beside what the factor now makes of the claim
        self._last_ns: int | None = None
        self._told = round(self._level)
        self.white = WhiteNoise(carried)

    def learnt(self) -> LearntNoiseScale | None:
        """Return what was learnt until now; None where nothing was."""
        if self._log + self._weighed == 0.0 and not self.white.count:
            return None
        return LearntNoiseScale(
            log_factor=min(self._log + self._weighed, log(HIGHEST) + DEAD_BAND),
            white_variance=self.white.variance,
            white_count=self.white.count,
        )

    @property
    def _level(self) -> float:
        return (log(self.value) + self._weighed) / LEVEL

    @property
    def value(self) -> float:
        """The factor; 1 as long as the evidence is within what chance and correlated errors make."""
        return exp(max(self._raised, self._learnt) if self.is_raised else self._learnt)

    @property
    def _learnt(self) -> float:
        return max(self._log - DEAD_BAND, min(self._log + DEAD_BAND, 0.0))

    @property
    def above_learnt(self) -> float:
        """The factor as it was learnt where it is above 1, whether it is raised or not."""
        return exp(max(0.0, self._learnt))

    @property
    def ratio(self) -> float:
        """How many times larger its noise is than claimed, rounded to what is worth telling."""
        return round(exp(0.5 * self._weighed) * sqrt(self.value), 3)

    @property
    def ratio_of_weighed(self) -> float:
        """The same beside claims as they come here."""
        return round(sqrt(self.value), 3)

    @property
    def above(self) -> float:
        """The factor where it is above 1: what is tested is not tested more strictly than it claims."""
        return max(1.0, self.value)

    def weigh(self, factor: float) -> None:
        """Know that claims are multiplied by a factor before they come here: what was learnt is in that now."""
        before, self._weighed = self._weighed, log(factor)
        by = self._weighed - before
        self._raised = max(self._raised - by, 0.0) if self.is_raised else 0.0
        if by > 0.0:
            self._log = max(self._log - by, min(self._log, 0.0))

    def raise_to(self, factor: float) -> None:
        """Believe at least this factor until `lower`, or until innovations show less."""
        self._raised = max(self._raised, min(log(max(factor, 1.0)), log(HIGHEST)))

    def lower(self) -> None:
        """Believe what was learnt before the factor was raised."""
        self._raised = 0.0

    @property
    def is_raised(self) -> bool:
        """Whether the factor has been raised."""
        return self._raised > 0.0

    def learn(
        self,
        innovation: Innovation,
        state: State,
        measurement: Measurement,
        event_log: EventLog,
        lowest: float = LOWEST,
    ) -> None:
        """Learn from a measurement of a trusted sensor, and report what is news.

        Args:
            innovation: of the measurement, its `R` as claimed.
            state: with which it was compared.
            measurement: in the order of stamps.
            event_log: where news goes.
            lowest: bound of the factor; below 1 where a claim holds a slow error that innovations do not show.
        """
        stamp_ns = measurement.stamp_ns
        since_s = MAX_WEIGHT_S if self._last_ns is None else abs(stamp_ns - self._last_ns) * 1e-9
        self._last_ns = stamp_ns
        is_measured = innovation.R.diagonal() < 0.1 * FREE_VARIANCE
        if not is_measured.any():
            return
        y, H, R = innovation.y, innovation.H, innovation.R
        if not is_measured.all():
            y, H, R = y[is_measured], H[is_measured], R[np.ix_(is_measured, is_measured)]
        R = R * self.value
        information = np.linalg.inv(H @ state.covariance @ H.T + R)
        ratio = min(float(y @ information @ y) / len(y), MAX_RATIO)
        share = float((information * R).sum()) / len(y)  # trace(S^-1 R): what is not the noise of the state
        weight_s = min(since_s, MAX_WEIGHT_S)
        self._mean += weight_s / MEAN_S * (ratio - self._mean)
        # an excess may be the state's; of a slow error the state has as much as the measurement, and it cancels
        excess = share * (ratio - 1.0) if ratio > 1.0 else min(ratio - 1.0, log(max(self._mean, LEAST_MEAN)))
        self._move(excess * weight_s / MEMORY_S, lowest)
        if abs(self._level - self._told) > NEWS:
            self._told = round(self._level)
            reason = f"its noise is {self.ratio:.1f} times what it claims"
            event_log.report(EventKind.NOISE, stamp_ns, measurement.sensor, reason)

    def _move(self, step: float, lowest: float) -> None:
        before = self.value
        if self.is_raised:
            self._raised = min(max(0.0, self._raised + step), log(HIGHEST))
        else:
            self._log = min(max(self._log + step, log(lowest) - DEAD_BAND), log(HIGHEST) + DEAD_BAND)
        self._mean *= before / self.value
