"""Two graphs: the main one takes GNSS, the fallback one never a doubtful fix; one of them is published.

They are one smoother as long as they are identical, which costs nothing; a graph is cloned when they begin to differ:

- At the loss of GNSS, if the configuration treats scans differently in the two (the paper: relative in the main graph,
  pseudo-global by Eq. 10 in the fallback). The main graph goes on without being published.
- At the recovery, fixes go into the main graph on trial. If it accepts them, it is published and the fallback graph
  is given up (the paper resets it to the main one); if not, nothing that was published ever saw them.
"""

from collections.abc import Callable, Iterator

import gtsam

from holdfast.config.model import Config
from holdfast.graph.nodes import Placed
from holdfast.graph.scans import Scan, ScanChain
from holdfast.graph.smoother import Smoother
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.lidar import LidarModel
from holdfast.state import OptimisedState, Outcome


class _Graph:
    """A smoother and how scans are joined in it."""

    def __init__(self, smoother: Smoother, scans: ScanChain | None) -> None:
        self.smoother = smoother
        self.scans = scans


class DualGraph:
    """The main graph and, while GNSS is lost, the fallback graph."""

    def __init__(
        self, config: Config, buffer: ImuBuffer, gravity: float, lidar: LidarModel | None, state: OptimisedState
    ) -> None:
        self._config = config.graph
        smoother = Smoother(config, buffer, gravity)
        smoother.start(state)
        self._main = _Graph(smoother, None if lidar is None else ScanChain(lidar, config.graph.main_lidar))
        self._fallback: _Graph | None = None
        self.is_lost = False

    @property
    def published(self) -> Smoother:
        """The smoother whose newest state is published."""
        return (self._fallback or self._main).smoother

    @property
    def main(self) -> Smoother:
        """The smoother that takes GNSS."""
        return self._main.smoother

    @property
    def newest_scan(self) -> Scan | None:
        """The newest scan in the main graph."""
        return None if self._main.scans is None else self._main.scans.newest

    @property
    def jumped_ns(self) -> int | None:
        """When the lidar odometry jumped last."""
        return None if self._main.scans is None else self._main.scans.jumped_ns

    def smoothers(self) -> Iterator[Smoother]:
        """Yield the main smoother and, if it is another one, the fallback."""
        for graph in self._graphs():
            yield graph.smoother

    def _graphs(self) -> Iterator[_Graph]:
        yield self._main
        if self._fallback is not None:
            yield self._fallback

    def lose(self) -> None:
        """GNSS is lost: from here on the fallback graph is published. It must follow an optimisation."""
        self.is_lost = True
        different = (self._config.main_lidar, self._config.fallback_lidar) != ("anchored", "anchored")
        if not (self._config.dual and different and self._fallback is None):
            return
        smoother, _ = self._main.smoother.clone()
        scans = None if self._main.scans is None else self._main.scans.copy(self._config.fallback_lidar)
        if scans is not None and self._config.fallback_lidar == "frozen":
            scans.freeze(smoother)
        self._fallback = _Graph(smoother, scans)

    def regain(self, add_fixes: Callable[[Smoother], bool]) -> Callable[[Placed], Placed] | None:
        """GNSS may be back: try it in the main graph and publish that if it accepts the fixes.

        Args:
            add_fixes: adds the fixes to the smoother that it is given, optimises, and says whether they agree.

        Returns:
            What finds the counterpart of a factor placed before, or None if the fixes were refused.
        """
        trial, counterpart = self._main.smoother.clone()
        if not add_fixes(trial):
            return None
        self._main.smoother = trial
        self._fallback, self.is_lost = None, False
        return counterpart

    def add_scan(self, scan: Scan) -> Outcome:
        """Join a scan to what was before, in both graphs; say what became of it in the published one."""
        outcome = Outcome.IGNORED
        for graph in self._graphs():
            assert graph.scans is not None
            key = graph.smoother.node(scan.stamp_ns)
            outcome = Outcome.LATE if key is None else graph.scans.add(graph.smoother, key, scan)
        return outcome

    def move(self, correction: gtsam.Pose3, position_sigma_m: float) -> None:
        """Begin anew, both graphs as one, at the published state moved by a correction in W, its position in doubt."""
        if self._fallback is not None:
            self._main, self._fallback = self._fallback, None
            if self._main.scans is not None:
                self._main.scans = self._main.scans.copy(self._config.main_lidar)
        self.is_lost = False
        self._main.smoother.move(correction, position_sigma_m)
        self.forget_scans(self._main.smoother)

    def forget_scans(self, smoother: Smoother) -> None:
        """Begin the chain of scans anew in a smoother that lost its window."""
        for graph in self._graphs():
            if graph.smoother is smoother and graph.scans is not None:
                graph.scans.forget()
