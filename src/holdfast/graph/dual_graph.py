"""Two graphs: the main one takes GNSS, the fallback one never a doubtful fix; one of them is published.

They are one smoother as long as they are identical, which costs nothing; a graph is cloned when they begin to differ:

- At the loss of GNSS, if the configuration treats odometry differently in the two (the paper: relative in the main
  graph, pseudo-global by Eq. 10 in the fallback). The main graph goes on without being published.
- At the recovery, fixes go into a trial clone of the main graph. If it accepts them, it is adopted, and the fallback
  graph is given up (the paper resets it to the main one); if not, nothing that was published ever saw them.
"""

from collections.abc import Iterator, Mapping
from types import MappingProxyType

import gtsam

from holdfast.config.model import Config
from holdfast.events import Outcome
from holdfast.graph.odometry_track import Joined, OdometryTrack
from holdfast.graph.smoother import Smoother
from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.odometry import TrackPose
from holdfast.sensors.sensor import Parameter
from holdfast.state import OptimisedState


class _Graph:
    """A smoother and the tracks of the odometries in it, by name."""

    def __init__(self, smoother: Smoother, tracks: dict[str, OdometryTrack]) -> None:
        self.smoother = smoother
        self.tracks = tracks

    def begin_tracks_anew(self, name: str | None = None) -> None:
        for one, track in self.tracks.items():
            if name in (None, one):
                self.tracks[one] = track.begin_anew()


class DualGraph:
    """The main graph and, while GNSS is lost, the fallback graph.

    Args:
        config: of the estimator.
        buffer: of the IMU's samples.
        gravity: [m/s^2].
        tracks: an empty track of each odometry, by name.
        state: where both begin.
        carried: priors of constants of sensors, by name, as they were learnt before.
        found: the same, as they were found by what has found the state.
        arm: the shift of antennas that have told where both begin, if that is estimated.
    """

    def __init__(
        self,
        config: Config,
        buffer: ImuBuffer,
        gravity: float,
        tracks: Mapping[str, OdometryTrack],
        state: OptimisedState,
        *,
        carried: Mapping[str, Parameter] = MappingProxyType({}),
        found: Mapping[str, Parameter] = MappingProxyType({}),
        arm: Parameter | None = None,
    ) -> None:
        self._config = config.graph
        self._main = _Graph(
            Smoother(config, buffer, gravity, state, carried=carried, found=found, arm=arm), dict(tracks)
        )
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

    def newest_pose(self, odometry: str) -> TrackPose | None:
        """Return the newest pose of an odometry in the main graph."""
        return self._main.tracks[odometry].newest

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
        mode = self._config.fallback_odometry
        differ = (self._config.main_odometry, mode) != ("anchored", "anchored")
        if not (self._config.dual and differ and self._fallback is None):
            return
        smoother = self._main.smoother.clone()
        self._fallback = _Graph(smoother, {name: track.copy(mode) for name, track in self._main.tracks.items()})
        if mode == "frozen":
            for track in self._fallback.tracks.values():
                track.freeze(smoother)

    def trial(self) -> Smoother:
        """Return a clone of the main smoother, to try in it what may be bad. It must follow an optimisation."""
        return self._main.smoother.clone()

    def adopt(self, trial: Smoother) -> None:
        """Let a trial that has accepted GNSS be the main smoother, and publish it."""
        self._main.smoother = trial
        self._fallback, self.is_lost = None, False

    def add_pose(self, pose: TrackPose) -> Joined:
        """Join a pose to the track of its odometry in both graphs.

        Returns:
            What became of it in the published graph, and whether the main one says that the odometry has jumped.
        """
        joined = []
        for graph in self._graphs():
            key = graph.smoother.node(pose.stamp_ns)
            track = graph.tracks[pose.sensor]
            joined.append(Joined(Outcome.LATE) if key is None else track.add(graph.smoother, key, pose))
        return Joined(joined[-1].outcome, joined[0].jump)

    def move(self, correction: gtsam.Pose3, position_sigma_m: float) -> None:
        """Begin anew, both graphs as one, at the published state moved by a correction in W, its position in doubt."""
        if self._fallback is not None:
            mode = self._config.main_odometry
            tracks = {name: track.copy(mode) for name, track in self._fallback.tracks.items()}
            self._main, self._fallback = _Graph(self._fallback.smoother, tracks), None
        self.is_lost = False
        self._main.smoother.move(correction, position_sigma_m)
        self._main.begin_tracks_anew()

    def begin_parameter_anew(self, name: str, prior: Parameter) -> None:
        """Know this alone of a sensor's parameter from now on."""
        for smoother in self.smoothers():
            smoother.parameters.begin_anew(name, prior)

    def let_parameter_go(self, name: str, start: Array) -> None:
        """Forget what is known of a sensor's parameter; it is somewhere about a value (p,)."""
        for smoother in self.smoothers():
            smoother.parameters.let_go(name, start)

    def begin_tracks_anew(self, odometry: str | None = None, *, within: Smoother | None = None) -> None:
        """Begin the track of an odometry, or of all, anew in both graphs, or within one smoother.

        What joins it to the poses before is not to be believed, or the smoother lost its window or its position.
        """
        for graph in self._graphs():
            if within in (None, graph.smoother):
                graph.begin_tracks_anew(odometry)
