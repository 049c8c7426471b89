"""Headings on their way into the dual graph: tested, weighed, and held back while GNSS is lost."""

from collections import deque
from itertools import pairwise
from math import sqrt

from holdfast.estimator.journal import Journal
from holdfast.graph.dual_graph import DualGraph
from holdfast.graph.smoother import Smoother
from holdfast.sensors.heading import AxisYaw, HeadingModel
from holdfast.sensors.noise import correlation_inflation, shared_inflation
from holdfast.state import EventKind, Outcome


class HeadingFusion:
    """The headings of one machine.

    They come from the receiver whose fixes are doubted, so while GNSS is lost they wait in quarantine; those of its
    recovery enter together with the fixes, and the heading of the world is corrected once.
    """

    def __init__(self, model: HeadingModel, journal: Journal) -> None:
        self._model = model
        self._tell, self._count = journal.tell, journal.count
        self.restart()

    def restart(self) -> None:
        """Forget everything: the estimator starts, or starts over."""
        self._quarantine: deque[AxisYaw] = deque()
        self._last_ns = 0

    def forget(self) -> None:
        """Forget what waits: the graph lost its window, or the estimate is moved."""
        self._quarantine.clear()

    def add(self, graph: DualGraph, heading: AxisYaw) -> Outcome:
        """Judge a heading at its node, and add its factor to the main graph if it may enter."""
        smoother = graph.published
        if smoother.node(heading.stamp_ns) is None:
            return Outcome.LATE
        if not graph.is_lost:
            inflation = correlation_inflation(self._model.correlation_s, self._since_last_s(heading))
            return self._enter(graph.main, heading, inflation)
        while self._quarantine and self._quarantine[0].stamp_ns < smoother.oldest_ns:
            self._quarantine.popleft()
        self._quarantine.append(heading)
        return Outcome.QUARANTINED

    def admit(self, smoother: Smoother, since_ns: int) -> bool:
        """Let the headings since a time out of quarantine, into a smoother that has just accepted the fixes since then.

        Each is judged by what the fixes have made of the estimate.

        Returns:
            Whether any entered, so that the smoother has to be optimised again.
        """
        held = [heading for heading in self._quarantine if heading.stamp_ns >= since_ns]
        self._quarantine.clear()
        if not held:
            return False
        gaps_s = [abs(b.stamp_ns - a.stamp_ns) * 1e-9 for a, b in pairwise(held)]
        inflation = shared_inflation(self._model.correlation_s, [self._since_last_s(held[0]), *gaps_s])
        outcomes = [self._enter(smoother, heading, inflation) for heading in held]
        for heading, outcome in zip(held, outcomes, strict=True):
            self._count(heading.sensor, Outcome.QUARANTINED, -1)
            self._count(heading.sensor, outcome, 1)
        return Outcome.USED in outcomes

    def _since_last_s(self, heading: AxisYaw) -> float:
        return abs(heading.stamp_ns - self._last_ns) * 1e-9

    def _enter(self, smoother: Smoother, heading: AxisYaw, inflation: float) -> Outcome:
        key = smoother.node(heading.stamp_ns)
        if key is None:
            return Outcome.LATE
        model, nav = self._model, smoother.nav(heading.stamp_ns)
        innovation = model.innovation(nav, heading.yaw_rad)
        if innovation is None:
            return Outcome.OUT_OF_RANGE
        covariance = smoother.covariance(heading.stamp_ns)
        if model.nis(nav, covariance, innovation, heading.sigma_rad) > model.limit:
            self._tell(EventKind.REJECTED, heading.stamp_ns, heading.sensor, Outcome.INNOVATION)
            return Outcome.INNOVATION
        self._last_ns = heading.stamp_ns
        smoother.add(model.factor(key, nav, innovation, heading.sigma_rad * sqrt(inflation)))
        return Outcome.USED
