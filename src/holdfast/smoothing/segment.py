"""One stretch from a start of the estimator to its end: the graph of all measurements, and the optimum of it.

The graph is built by the smoother of the causal estimator, with the same nodes, links, tracks and factors. Only its
solver is another one, and its window is minutes long; what leaves it hands its information on to what follows.
"""

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.config.model import Config
from holdfast.covariances import Covariances
from holdfast.estimator.standstill import Standing
from holdfast.events import Outcome
from holdfast.graph.batch import Batch, Solved
from holdfast.graph.nodes import Link
from holdfast.graph.odometry_track import OdometryTrack, believed_calibration
from holdfast.graph.smoother import Smoother
from holdfast.sensors.clock import with_estimated_clock
from holdfast.sensors.constants import priors_of, priors_of_machine
from holdfast.sensors.gnss import is_measured
from holdfast.sensors.heading import MOUNT
from holdfast.sensors.lever_arm import GNSS_ARM
from holdfast.sensors.odometry import OdometryModel, OdometryNoise
from holdfast.sensors.sensor import Measurement, Parameter, Role, Sensor, of_role, part_of
from holdfast.smoothing.block import Biases, Block, Refused, Work
from holdfast.smoothing.closures import CONTRADICTED, Closer, Stretch, close
from holdfast.smoothing.decisions import SHAPES, Candidate, candidate, enter_all, refused_runs, weight_of
from holdfast.smoothing.recorded import Recorded
from holdfast.smoothing.track import track_of
from holdfast.state import OptimisedState

APART_NS = 100_000_000  # covariances at nodes that are closer together tell nothing new
BELIEVED = 0.5  # a measurement of less weight counts as refused
FEW = 0.002  # of the measurements: if no more have changed, the optimum is where it was
TOGETHER = 0.5  # of a run of refused measurements that agree, if any is to enter
BELIEFS = 3  # times that the optimum decides which clocks are off
READMISSIONS = 2  # times that refused measurements are compared with the optimum and its covariance


class Segment:
    """All measurements since one start, in the order of time.

    Args:
        config: of the estimator.
        recorded: what the estimator has checked.
        state: where it begins.
        sensors: the models, by name.
        gravity: [m/s^2].
        found: constants of sensors with which the state was found, if they are far from what is configured.
        overlap_s: of the window after its done part, which the future still tells about.
        closer: finds loop closures, if there are scans.
    """

    def __init__(
        self,
        config: Config,
        recorded: Recorded,
        state: OptimisedState,
        sensors: Mapping[str, Sensor],
        *,
        gravity: float,
        found: Mapping[str, Parameter],
        overlap_s: float,
        closer: Closer | None = None,
    ) -> None:
        graph = config.graph.model_copy(update={"lag_s": overlap_s})
        self._config, self._recorded, self._models, self._gravity = config, recorded, sensors, gravity
        self._sensors: Mapping[str, Any] = sensors
        self._batch, arm = Batch(), priors_of(sensors).get(GNSS_ARM)
        self._smoother = Smoother(
            config.model_copy(update={"graph": graph}),
            recorded.buffer,
            gravity,
            state,
            new_solver=lambda: self._batch,
            known=recorded.nav,
            found={name: one for name, one in found.items() if name != GNSS_ARM or arm is not None},
            arm=arm,
        )
        models: dict[str, OdometryModel] = of_role(sensors, Role.ODOMETRY)
        self._tracks = {
            name: OdometryTrack(OdometryNoise(model), model.max_interval_ns, config.graph.main_odometry)
            for name, model in models.items()
        }
        self._closer, self._closed_ns = closer, 0
        self._closures: Counter[str] = Counter()  # since the last finish, by what became of them
        self._interval_ns = round(config.graph.max_node_interval_s * 1e9)
        self._candidates: list[Candidate] = []
        self._counts: Counter[tuple[str, Outcome]] = Counter()
        self._overlap_ns = round(overlap_s * 1e9)

    @property
    def oldest_ns(self) -> int:
        """Time of the first node that is not done."""
        return self._smoother.oldest_ns

    @property
    def newest_ns(self) -> int:
        """Time of the newest node."""
        return self._smoother.newest_ns

    # --- building ----------------------------------------------------------------------------------------------------

    def extend(self, until_ns: int) -> None:
        """Take in all that was measured until a time."""
        self._smoother.imu_noise.force_scale = self._recorded.force_scale
        self._sensors = {name: self._believed(sensor) for name, sensor in self._models.items()}
        for time_ns, measurement in self._recorded.take(until_ns):
            self._lead_to(time_ns)
            self._take(measurement)
        self._lead_to(until_ns)
        self._candidates.sort(key=lambda one: one.measurement.stamp_ns)

    def _believed(self, sensor: Any) -> Any:
        """Return a sensor with its clock, its lever arm and its mounting as known unless they were found off."""
        name = sensor.name
        if is_measured(sensor):
            sensor = sensor if self._recorded.is_off(GNSS_ARM) else sensor.with_known_arm()
        mount = part_of(sensor.parameters, MOUNT)
        if mount is not None and not self._recorded.is_off(mount.name(name)):
            sensor = sensor.turned(self._recorded.believed_rad(mount.name(name)))
        clocked = with_estimated_clock(sensor)
        of_clock = clocked.parameters[len(sensor.parameters) :]
        return clocked if any(self._recorded.is_off(one.name(name)) for one in of_clock) else sensor

    def _priors(self) -> dict[str, Parameter]:
        return priors_of_machine(self._config, self._sensors)

    def _lead_to(self, time_ns: int) -> None:
        """Make nodes where nothing was measured for long."""
        while time_ns - self._smoother.newest_ns > self._interval_ns:
            grid_ns = self._smoother.newest_ns // self._interval_ns * self._interval_ns
            self._smoother.node(grid_ns + self._interval_ns)

    def _take(self, measurement: Measurement) -> None:
        key = self._smoother.node(measurement.stamp_ns)
        if key is None:
            self._counts[measurement.sensor, Outcome.LATE] += 1
        elif isinstance(measurement, Standing):
            self._smoother.enter_zero_velocity(measurement, self._config.standstill.velocity_sigma_m_s)
            self._counts[measurement.sensor, Outcome.USED] += 1
        elif measurement.sensor in self._tracks:
            pose: Any = measurement
            outcome, _ = self._tracks[measurement.sensor].add(self._smoother, key, pose)
            self._counts[measurement.sensor, outcome] += 1
        else:
            self._take_candidate(measurement)

    def _take_candidate(self, measurement: Measurement) -> None:
        sensor, beside = self._sensors[measurement.sensor], self._recorded.beside(measurement)
        scale, used = self._recorded.noise(measurement), self._recorded.was_used(measurement)
        is_right = used is not False
        one = candidate(
            self._smoother, sensor, measurement, beside.joint, scale, colour=beside.colour, is_right=is_right
        )
        if used is None:
            one.compare(self._batch, self._recorded.covariance(measurement.stamp_ns))
            used = one.nis < one.limit
        one.weight = 1.0 if used else 0.0
        one.is_in_doubt = not used
        self._candidates.append(one)

    # --- solving -----------------------------------------------------------------------------------------------------

    def solve(self) -> Work:
        """Find the optimum, and which measurements are believed in it.

        Raises:
            RuntimeError: GTSAM failed.
        """
        enter_all(self._batch, self._candidates)
        solved = [self._batch.converge(), *self._believe_constants()]
        changed, has_moved = 0, True
        for shape in SHAPES:
            changed += self._judge_again(shape, has_moved=has_moved)
            has_moved = changed > FEW * len(self._candidates) or (changed > 0 and shape == SHAPES[-1])
            if has_moved:
                solved.append(self._batch.converge())
                changed = 0
        for _ in range(READMISSIONS):
            if not self._readmit():
                break
            solved.append(self._batch.converge())
        solved += self._believe_constants()
        if self._closer is not None:
            self._close(self._closer)
        return self._work(solved)

    def _believe_constants(self) -> list[Solved]:
        """Decide which constants of sensors are as configured, and find the optimum anew as long as that changes."""
        solved: list[Solved] = []
        while self._smoother.review_parameters(self._priors()) and len(solved) < BELIEFS:
            solved.append(self._batch.converge())
        return solved

    def _close(self, closer: Closer) -> None:
        """Look for loop closures, and let those in that agree with all else."""
        links = self._smoother.links()
        track = track_of(self._recorded.buffer, self._batch, links, self._gravity)
        calibrations = {
            name: believed_calibration(self._smoother, name, model.calibration)
            for name, model in of_role(self._sensors, Role.ODOMETRY).items()
        }
        found = closer(Stretch(track, self._covariances(links), self._closed_ns, calibrations))
        self._closed_ns = self.newest_ns
        self._closures += found.counts
        contradicted = close(self._batch, found.closures, self._smoother.key) if found.closures else 0
        if contradicted:
            self._closures["accepted"] -= contradicted
            self._closures[CONTRADICTED] += contradicted

    def _judge_again(self, shape: float, *, has_moved: bool) -> int:
        """Weigh what is not in doubt by its residual under a loss of a shape; return how many have changed.

        The residuals are those of before unless the estimate `has_moved`.
        """
        for one in self._candidates:
            if not one.is_in_doubt:
                if has_moved:
                    one.compare(self._batch)
                one.weight = weight_of(one.nis, one.limit, shape)
        return enter_all(self._batch, self._candidates)

    def _readmit(self) -> int:
        """Let refused measurements in that agree with the optimum, given its covariance; return what has changed.

        Those of a sensor that were refused in a row enter only if most of them agree: a walk of the fixes agrees at
        first, too.
        """
        for run in refused_runs(self._candidates, BELIEVED):
            for one in run:
                one.compare(self._batch, self._batch.covariance(one.keys[0]))
            agreeing = [one for one in run if one.nis < one.limit]
            if len(agreeing) >= TOGETHER * len(run):
                for one in agreeing:
                    one.weight, one.is_in_doubt = 1.0, False
        return enter_all(self._batch, self._candidates)

    def _work(self, solved: list[Solved]) -> Work:
        return Work(
            start_ns=self.oldest_ns,
            end_ns=self.newest_ns,
            nodes=len(self._smoother),
            factors=self._batch.factor_count,
            cost_before=solved[0].before,
            cost_after=solved[-1].after,
            iterations=sum(one.iterations for one in solved),
            rounds=len(solved),
        )

    # --- what is done ------------------------------------------------------------------------------------------------

    def finish(self, work: Work, *, is_last: bool) -> Block:
        """Return what lies before the overlap, or all if it is the last, and drop it from the problem."""
        horizon_ns = self.newest_ns + 1 if is_last else self.newest_ns - self._overlap_ns
        links = [link for link in self._smoother.links() if link.start_ns < horizon_ns]
        track = track_of(self._recorded.buffer, self._batch, links, self._gravity)
        block = Block(
            track,
            self._recorded.mounted(track.times_ns),
            self._covariances(links),
            self._biases(links),
            self._counted(horizon_ns),
            self._refused(horizon_ns),
            self._smoother.constants(self._priors()),
            work,
            self._closures,
        )
        self._closures = Counter()
        self._candidates = [one for one in self._candidates if one.measurement.stamp_ns >= horizon_ns]
        if not is_last:
            self._smoother.optimise()
        return block

    def _covariances(self, links: list[Link]) -> Covariances:
        """Return the covariances at nodes of some links, those at both ends included; between them they are linear."""
        nodes: list[tuple[int, int]] = []
        for link in links:
            if not nodes or link.is_gap or link.start_ns - nodes[-1][0] >= APART_NS:
                nodes.append((link.start_ns, link.keys[0]))
        nodes += [(link.end_ns, link.keys[1]) for link in links[-1:]]
        values = np.array([self._batch.covariance(key) for _, key in nodes]).reshape(-1, 9, 9)
        return Covariances(np.array([stamp for stamp, _ in nodes], dtype=np.int64), values)

    def _biases(self, links: list[Link]) -> Biases:
        first = {link.bias_key: link for link in reversed(links)}
        firsts = sorted(first.values(), key=lambda link: link.start_ns)
        found = [self._smoother.bias(link) for link in firsts]
        values = [bias.vector() for bias, _ in found]
        sigmas = [np.sqrt(np.diag(covariance)) for _, covariance in found]
        times = np.array([link.start_ns for link in firsts], dtype=np.int64)
        return Biases(times, np.array(values).reshape(-1, 6), np.array(sigmas).reshape(-1, 6))

    def _counted(self, horizon_ns: int) -> Counter[tuple[str, Outcome]]:
        counts, self._counts = self._counts, Counter()
        for one in self._candidates:
            if one.measurement.stamp_ns < horizon_ns:
                outcome = Outcome.USED if one.weight >= BELIEVED else _reason(one)
                counts[one.sensor.name, outcome] += 1
        return counts

    def _refused(self, horizon_ns: int) -> list[Refused]:
        return [
            Refused(one.measurement.stamp_ns, one.sensor.name, one.weight, one.nis, _reason(one))
            for one in self._candidates
            if one.weight < 1.0 and one.measurement.stamp_ns < horizon_ns
        ]


def _reason(one: Candidate) -> Outcome:
    return Outcome.CONTRADICTED if one.outcome is Outcome.USED else one.outcome
