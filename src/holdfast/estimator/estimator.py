"""The estimator in one process: a message comes in, one half answers, the other optimises, an estimate goes out.

`ImuPath` and `Optimiser` talk only by samples and measurements one way and by optimised states the other way. Here they
are called in turn; `holdfast.realtime` puts them into two processes.
"""

from collections import Counter
from dataclasses import replace

from holdfast.config.model import Config, check_config, check_sensor
from holdfast.errors import ConfigError, MessageError
from holdfast.estimator.density import Density
from holdfast.estimator.imu_path import ImuPath
from holdfast.estimator.intake import Intake
from holdfast.estimator.listener import Listener
from holdfast.estimator.optimiser import Optimiser
from holdfast.event_log import EventLog, MeasurementRecord
from holdfast.events import Event, EventKind, Health, HealthReport, Outcome
from holdfast.geometry.earth import Geodetic, LocalFrame, check_datum
from holdfast.integrity.learnt_snapshot import LearntSnapshot, check_learnt
from holdfast.measured_fields import got, is_stamp
from holdfast.messages import ImuSample, JointAngle, Message
from holdfast.sensors.constants import Constant
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.registry import MessageKinds
from holdfast.state import NOTHING, BaseState, Estimate, Output


class Estimator(Intake):
    """Fuses the sensors of one machine; deterministic, and it does not die of bad data.

    Args:
        config: what the sensors are, where they sit, and how the estimator is to behave.
        listener: who is told of all that comes in and goes out, such as a batch smoother.
        learnt: what was learnt of the sensors before.

    Raises:
        ConfigError: an argument is none of these.
    """

    def __init__(
        self, config: Config, listener: Listener | None = None, *, learnt: LearntSnapshot | None = None
    ) -> None:
        check_config(config)
        learnt = check_learnt(learnt)
        if not isinstance(listener, Listener | None):
            raise ConfigError(f"listener: must have the methods of a Listener, not be a {type(listener).__name__}")
        self.config = config
        self._imu, self._kinds = config.imu_name, MessageKinds(config)
        self._log = EventLog(self._imu)
        self._buffer = ImuBuffer(config.imu)
        self._path = ImuPath(config, self._buffer, self._log, learnt.joint)
        self._optimiser = Optimiser(
            config, self._buffer, self._log, listener, Density(config, self._log), learnt=learnt
        )

    def close(self) -> None:
        """Count the measurements that still wait for the IMU when no more will come."""
        self._optimiser.close()

    @property
    def datum(self) -> Geodetic | None:
        """Origin of W on the ellipsoid, or None until the first accepted fix."""
        return self._optimiser.world.datum

    @property
    def world(self) -> LocalFrame | None:
        """The world frame W about the datum, or None until there is one."""
        return self._optimiser.world.frame

    @property
    def initialised(self) -> bool:
        """Whether estimates are being given."""
        return self._optimiser.tracking is not None

    @property
    def waiting_for(self) -> str:
        """What keeps the estimator from starting."""
        return self._optimiser.waiting_for

    @property
    def health(self) -> Health:
        """How the estimator is now, in one word."""
        return self._optimiser.health

    @property
    def waiting(self) -> Counter[str]:
        """How many measurements of each sensor wait for the IMU."""
        return self._optimiser.waiting

    @property
    def counts(self) -> Counter[tuple[str, Outcome]]:
        """How many measurements of each sensor had which outcome; those that still wait are not counted yet."""
        self._path.count()
        return self._log.counts

    @property
    def event_counts(self) -> Counter[EventKind]:
        """How many events of each kind there were."""
        return self._log.event_counts

    @property
    def events(self) -> list[Event]:
        """The events that have not been taken."""
        return self._path.clock.events(self._log.events)

    def health_report(self) -> HealthReport:
        """Return the health now with what it rests on."""
        stamp_ns = self._path.clock.stamp(self._buffer.latest_ns)
        return replace(self._optimiser.monitor.report(self._buffer.latest_ns, self.health), stamp_ns=stamp_ns)

    def noise(self, sensor: str) -> float:
        """Return how many times larger the noise of a sensor is than it claims, as its innovations show.

        Raises:
            ConfigError: the sensor is not in the configuration.
        """
        check_sensor(self.config, sensor)
        return self._optimiser.monitor.noise(sensor)

    @property
    def early_ns(self) -> dict[str, int]:
        """What is added to the stamps of sensors whose clocks are far off [ns], by name."""
        return self._optimiser.clocks.learnt()

    def constants(self) -> dict[str, Constant]:
        """Return what is known of mountings and clocks since the last start, by sensor or by what sensors share."""
        return self._optimiser.constants()

    def learnt(self) -> LearntSnapshot:
        """Return what was learnt of the sensors: noise, drift, mountings, clocks, the encoder; a reset forgets it."""
        return self._optimiser.learnt().with_joint(self._path.learnt())

    def stamp(self, time_ns: int) -> int:
        """Return the stamp that the IMU's clock showed at a time of the estimator's own, which never steps.

        Raises:
            MessageError: it is no time.
        """
        if not is_stamp(time_ns):
            raise MessageError(f"time_ns: must be a whole number of nanoseconds within 64 bits, {got(time_ns)}")
        return self._path.clock.stamp(time_ns)

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        return self._path.clock.events(self._log.take_events())

    def keep_records(self) -> None:
        """Keep a record of what becomes of every measurement from now on; whoever asks for it takes them."""
        self._log.keep_records()

    def take_records(self) -> list[MeasurementRecord]:
        """Return the records since the last call."""
        return self._path.clock.records(self._log.take_records())

    def process(self, message: Message) -> Output:
        """Take in one message, in the order of arrival.

        Raises:
            ConfigError: the sensor is not in the configuration.
            MessageError: it is no message, or one of another kind than the sensor's.
        """
        if isinstance(message, ImuSample) and message.sensor == self._imu:
            output = self._process_imu(message)
        else:
            self._kinds.check(message)
            output = self._process_other(self._path.clock.read(message))
        return self._path.clock.output(output)

    def _process_other(self, message: Message) -> Output:
        if isinstance(message, ImuSample | JointAngle) and self._path.serves_chassis(message.sensor):
            self._path.add_to_chassis(message)
        if self._optimiser.wants(message):
            return self._process_measurement(self._path.corrected(message))
        if not self._path.serves_chassis(message.sensor):
            self._log.count(message.sensor, Outcome.IGNORED)
        return NOTHING

    def reset(self) -> None:
        """Forget the state and what was learnt, and begin anew; W stays where it is."""
        self._path.forget()
        self._optimiser.restart()

    def set_datum(self, datum: Geodetic) -> None:
        """Put the origin of W somewhere else and begin anew: no pose of before compares with one of now.

        Raises:
            ConfigError: it is no position on the earth; nothing is changed.
        """
        check_datum(datum)
        self._path.stop()
        self._optimiser.restart(datum)

    def _process_imu(self, sample: ImuSample) -> Output:
        received = self._path.process(sample)
        if received is None:
            return NOTHING
        self._optimiser.receive(received)
        estimate = received.estimate
        if estimate is None:
            return NOTHING
        if not received.is_sound:
            self.reset()
            return NOTHING
        base = received.base
        return self._update(estimate, base) if self._optimiser.is_due else Output(estimate, base=base)

    def _process_measurement(self, message: Message) -> Output:
        first = self._optimiser.add(message)
        if first is not None:
            self._path.start(first, self._optimiser.gravity)
            return Output(None, first)
        return self._update() if self._optimiser.is_due else NOTHING

    def _update(self, estimate: Estimate | None = None, base: BaseState | None = None) -> Output:
        """Optimise once, and propagate to the present again."""
        update = self._optimiser.update()
        self._path.anchor(update.state, is_recovery=update.is_recovery)
        self._optimiser.drop_samples()
        return Output(estimate, update.state, update.smoothed, base)
