"""The live node: samples from the network go into the estimator, its estimates out and into the feeds."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from time import monotonic_ns, time_ns
from typing import Any

from holdfast.config.model import Config
from holdfast.events import Event, EventKind
from holdfast.geometry.earth import Geodetic, is_on_earth
from holdfast.live.dds import Network, Sample
from holdfast.live.feed import Feed, Record
from holdfast.live.idl import STORE
from holdfast.live.inputs import Inputs
from holdfast.live.line_limit import LineLimit, Subject
from holdfast.live.outputs import Level, Outputs
from holdfast.live.scans import LiveScans
from holdfast.live.watch import MALFORMED, Finding, Watch
from holdfast.messages import ImuSample
from holdfast.point_cloud import PointCloud
from holdfast.printable import one_line
from holdfast.realtime.engine import RealtimeEstimator
from holdfast.recording.source import Subscription
from holdfast.replay.datum_check import DatumCheck
from holdfast.ros.messages import OK, WARN, Status, estimator_status

REVIEW_NS = 1_000_000_000
STOP_WITHIN_S = 0.1
MAX_LINE = 500  # characters, on the terminal and on /rosout
GRAVE = {
    EventKind.OPTIMISER_FAULT,
    EventKind.CLOCK_STEP,
    EventKind.GNSS_LOST,
    EventKind.SENSOR_LOST,
    EventKind.IMU_GAP,
}
EMPTY, FIX = "std_msgs/msg/Empty", "sensor_msgs/msg/NavSatFix"


class LiveNode:
    """Joins network, estimator and feeds.

    Args:
        config: of the estimator and of the node.
        subscriptions: which topic feeds which sensor.
        engine: the estimator.
        network: where to subscribe and to publish.
        feeds: processes that get a copy of everything that is received and published.
        scans: odometries that are made of scans, in their own processes.
        show: prints one line for the user.
    """

    def __init__(
        self,
        config: Config,
        subscriptions: Sequence[Subscription],
        engine: RealtimeEstimator,
        network: Network,
        *,
        feeds: Sequence[Feed],
        scans: Sequence[LiveScans] = (),
        show: Callable[[str], None],
    ) -> None:
        live = config.live
        self.name = f"{live.namespace}/{live.node_name}"
        self._engine = engine
        self._network = network
        self._feeds = feeds
        self._scans = {one.name: one for one in scans}
        self._imu = config.imu_name if scans else ""
        self._show = show
        self._clock = ArrivalClock()
        full = [
            replace(subscription, topic=full_name(subscription.topic, live.namespace)) for subscription in subscriptions
        ]
        self.inputs = Inputs(network, full, reliable=live.reliable_inputs)
        self.outputs = Outputs(network, config, self.name)
        self._watch = Watch(
            self.inputs.topics,
            live.silent_after_s,
            live.max_clock_offset_s,
            reliable=live.reliable_inputs,
            began_ns=self._clock.now_ns(),
        )
        self._controls: dict[str, Callable[[Sample, int], None]] = {}
        if live.commands:
            self._controls = {f"{self.name}/reset": self._reset, f"{self.name}/set_datum": self._set_datum}
            for topic, type_name in zip(self._controls, (EMPTY, FIX), strict=True):
                network.subscribe(topic, type_name, reliable=True)
        self._findings: dict[str, Finding] = {}
        self._complaints: dict[str, str] = {}
        self._limit = LineLimit()
        self._datum: Geodetic | None = None
        self._datum_check, self._is_far_told = DatumCheck(config), False
        self.has_started = False

    def run(self, keep_on: Callable[[], bool]) -> None:
        """Work until `keep_on` returns False; it is called ten times a second at least."""
        next_review_ns = self._clock.now_ns() + REVIEW_NS
        while keep_on():
            samples = self._network.wait(STOP_WITHIN_S)
            now_ns = self._clock.now_ns()
            incoming = [Record(*sample, now_ns) for sample in samples] if self._feeds else []
            for sample in self._without_overload(samples, now_ns):
                self._take(sample, now_ns)
            self._take_poses()
            if self._engine.datum != self._datum:
                self._report_datum(now_ns)
            for event in self._engine.take_events():
                self._report_event(event, now_ns)
            if now_ns >= next_review_ns:
                next_review_ns = now_ns + REVIEW_NS
                self._review(now_ns)
            self._pass_on(incoming)

    def _without_overload(self, samples: list[Sample], now_ns: int) -> list[Sample]:
        """Leave out the oldest samples of topics of which more have come than the estimator takes in."""
        counts = Counter(sample.topic for sample in samples)
        surplus: dict[str, int] = {}
        for topic, count in counts.items():
            sensors = self.inputs.sensors.get(topic, ())
            rooms = [self._engine.room(sensor, now_ns) for sensor in sensors]
            room = max((room for room in rooms if room is not None), default=count)
            if None not in rooms and count > room:
                surplus[topic] = count - room
                self.inputs.shed[topic] += count - room
                for sensor in sensors:
                    self._engine.shed(sensor, count - room, now_ns)
        if not surplus:
            return samples
        kept = []
        for sample in samples:
            left = surplus.get(sample.topic, 0)
            surplus[sample.topic] = left - 1
            if left <= 0:
                kept.append(sample)
        return kept

    def _take(self, sample: Sample, now_ns: int) -> None:
        control = self._controls.get(sample.topic)
        if control is not None:
            control(sample, now_ns)
            return
        for message in self.inputs.decode(sample, now_ns):
            self._watch.note(sample.topic, message.stamp_ns, now_ns, time_ns())
            if isinstance(message, PointCloud):
                self._scans[message.sensor].offer(message)
                continue
            if message.sensor == self._imu and isinstance(message, ImuSample):
                for scans in self._scans.values():
                    scans.add_sample(message)
            self._datum_check.add(message)
            output = self._engine.process(message)
            if output.estimate is not None:
                self.has_started = True
                self.outputs.estimate(output.estimate, output.base, now_ns)

    def _take_poses(self) -> None:
        """Give the estimator the poses that were made of scans, as those of any odometry."""
        for scans in self._scans.values():
            now_ns = self._clock.now_ns()
            for pose in scans.poses(now_ns):
                self._engine.process(pose)
            if (fault := scans.fault()) is not None:
                self._report((scans.name, "scans"), Level.WARN, f"{scans.name}: {fault}; it is started again", now_ns)

    def _pass_on(self, incoming: list[Record]) -> None:
        batch = incoming + self.outputs.take_records()
        if batch:
            for feed in self._feeds:
                feed.offer(batch)

    # --- controls ------------------------------------------------------------------------------------------------

    def _reset(self, sample: Sample, now_ns: int) -> None:
        self.outputs.clear_path()
        self._engine.reset()
        self._report((sample.topic, "reset"), Level.WARN, f"{sample.topic}: the estimator begins anew", now_ns)

    def _set_datum(self, sample: Sample, now_ns: int) -> None:
        try:
            fix: Any = STORE.deserialize_cdr(sample.data, sample.type_name)
        except Exception as error:  # damaged bytes raise anything
            self._report((sample.topic, "unreadable"), Level.ERROR, f"{sample.topic}: cannot be read ({error})", now_ns)
            return
        datum = Geodetic(fix.latitude, fix.longitude, fix.altitude)
        if not is_on_earth(datum):
            text = f"{sample.topic}: {tuple(datum)} is no position on the Earth; nothing is changed"
            self._report((sample.topic, "no position"), Level.ERROR, text, now_ns)
            return
        self.outputs.clear_path()
        self._engine.set_datum(datum)

    def _report_datum(self, now_ns: int) -> None:
        self._datum = self._engine.datum
        if self._datum is not None:
            self.outputs.datum(self._datum, now_ns)
            origin = f"{self._datum.latitude_deg:.8f}, {self._datum.longitude_deg:.8f}, {self._datum.altitude_m:.3f} m"
            self._report(("world", "origin"), Level.INFO, f"the world's origin is {origin}", now_ns)

    # --- what is wrong -------------------------------------------------------------------------------------------

    def _review(self, now_ns: int) -> None:
        publications = self._network.publications()
        self.inputs.join(publications)
        findings = self._watch.review(now_ns, publications, self.inputs.malformed, self.inputs.reasons)
        for topic, finding in findings.items():
            before = self._findings.get(topic)
            if before is None or before.kind != finding.kind:
                self._report((topic, finding.kind), Level.WARN, f"{topic}: {finding.text}", now_ns)
        for topic in self._findings.keys() - findings.keys():
            if self._findings[topic].kind != MALFORMED:
                self._report((topic, "is well again"), Level.INFO, f"{topic}: is well again", now_ns)
        self._findings = findings
        if (far := self._datum_check.warning) is not None and not self._is_far_told:
            self._is_far_told = True
            self._report(("world", "far datum"), Level.WARN, far, now_ns)
        for (source, kind), number in self._limit.end(now_ns):
            self._log(Level.INFO, f"{source or 'estimator'}: {kind}: {number} more such lines", now_ns)
        for feed in self._feeds:
            if complaint := feed.complaint():
                self._complaints[feed.name] = complaint
                self._report((feed.name, "complaint"), Level.ERROR, complaint, now_ns)
        self.outputs.diagnostics(self._statuses(now_ns), now_ns)
        self.outputs.path(now_ns)

    def _statuses(self, now_ns: int) -> list[Status]:
        statuses = [estimator_status(self._engine)]
        for topic, types in self.inputs.topics.items():
            finding, reception = self._findings.get(topic), self._watch.received[topic]
            values = [
                ("type", " | ".join(types)),
                ("received", str(self.inputs.received[topic])),
                ("shed", str(self.inputs.shed[topic])),
                ("malformed", str(self.inputs.malformed[topic])),
                ("rate_hz", f"{reception.rate_hz(now_ns):.2f}"),
                ("stamp_minus_clock_s", f"{reception.offset_ns * 1e-9:.6f}"),
            ]
            text = "ok" if finding is None else finding.text
            statuses.append(Status(OK if finding is None else WARN, f"holdfast: {topic}", text, values))
        statuses += [scans.status() for scans in self._scans.values()]
        if self._network.unsent:
            unsent = [(topic, str(count)) for topic, count in sorted(self._network.unsent.items())]
            statuses.append(Status(WARN, "holdfast: publishing", "some messages could not be sent", unsent))
        for feed in self._feeds:
            text = self._complaints.get(feed.name, "ok" if feed.alive else "has ended")
            is_well = text == "ok" and not feed.dropped
            statuses.append(
                Status(OK if is_well else WARN, f"holdfast: {feed.name}", text, [("dropped", str(feed.dropped))])
            )
        return statuses

    def _report_event(self, event: Event, now_ns: int) -> None:
        level = Level.WARN if event.kind in GRAVE else Level.INFO
        source = f"{event.sensor}: " if event.sensor else ""
        text = f"{source}{event.kind}: {event.reason}"
        self._report((event.sensor, event.kind), level, text, now_ns)

    def _report(self, subject: Subject, level: Level, text: str, now_ns: int) -> None:
        """Log something, unless too much of its kind was logged a short while ago."""
        if self._limit.admits(subject, now_ns):
            self._log(level, text, now_ns)

    def _log(self, level: Level, text: str, now_ns: int) -> None:
        text = one_line(text, MAX_LINE)
        self._show(text if level is Level.INFO else f"{'warning' if level is Level.WARN else 'error'}: {text}")
        self.outputs.log(level, text, now_ns)


class ArrivalClock:
    """Time of arrival [ns since the epoch]: this machine's clock at the start, never set after it."""

    def __init__(self) -> None:
        self._offset_ns = time_ns() - monotonic_ns()

    def now_ns(self) -> int:
        """Return the time now."""
        return self._offset_ns + monotonic_ns()


def full_name(topic: str, namespace: str) -> str:
    """Return a topic in full: a name without a leading slash belongs to the namespace."""
    return topic if topic.startswith("/") else f"{namespace}/{topic}"
