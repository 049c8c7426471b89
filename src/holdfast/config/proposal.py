"""What is proposed for a recording: sensors with their values, and where each sits as far as the recording tells."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from holdfast.config.assignment import Guess, Measured, Topic, TopicKind, assign, described, namespace
from holdfast.config.frames import FramesConfig
from holdfast.config.kinds import KINDS
from holdfast.config.recorded_frames import RecordedFrames, RecordedLink
from holdfast.config.schema import Place
from holdfast.config.sensors import (
    GnssConfig,
    GnssVelocityConfig,
    HeadingConfig,
    ImuConfig,
    MountedConfig,
    OdometryConfig,
    ScansConfig,
)
from holdfast.errors import RecordingError
from holdfast.messages import Array
from holdfast.printable import one_line

BASE, CABIN = FramesConfig().base, "cabin"
UNKNOWN_FRAME = {"offset_sigma_m": 1e4, "offset_sigma_deg": 180.0}  # of what is not given in W
NOT_MOUNTED = "the recording does not say how it is mounted"


@dataclass(frozen=True)
class Mount:
    """Where a frame sits.

    Attributes:
        T: T_parent_child (4, 4) [m]; None where nobody knows.
        source: of T in words; where it is None, why if there is something to say.
        turns: whether its rotation matters; that of an antenna does not.
    """

    parent: str
    child: str
    T: Array | None = None
    source: str = ""
    turns: bool = True


@dataclass(frozen=True)
class SensorProposal:
    """One sensor.

    Attributes:
        given: keys of its section that are set.
        measured: what stands above the section and beside its keys.
        why_not: why it is not used; empty where it is.
    """

    guess: Guess
    given: Mapping[str, Any]
    measured: Measured = field(default_factory=Measured)
    why_not: str = ""

    @property
    def name(self) -> str:
        """Its name in the configuration."""
        return self.guess.sensor

    @property
    def section(self) -> type[Any]:
        """The model of its section."""
        return KINDS[self.guess.kind]

    @property
    def frame(self) -> str:
        """The frame in which it sits."""
        return str(self.given.get("frame", self.name))


@dataclass(frozen=True)
class Proposal:
    """A configuration as far as a recording tells it.

    Attributes:
        sensors: in the order of the kinds; also those that are not used.
        mounts: of all sensors that sit elsewhere than the IMU, of the cabin and of the base.
        turn_joint: T_parent_child where the joint reads zero; None where nothing turns.
        base: the frame of the chassis.
        warnings: what contradicts itself in the frames of the recording, or leads nowhere, one line each.
        unused: topics that are taken for nothing, with what they could be.
    """

    recording: str
    sensors: tuple[SensorProposal, ...]
    mounts: tuple[Mount, ...]
    turn_joint: Mount | None
    base: str
    warnings: tuple[str, ...]
    unused: tuple[tuple[Topic, tuple[str, ...]], ...]

    @property
    def used(self) -> list[SensorProposal]:
        """The sensors that are used."""
        return [sensor for sensor in self.sensors if not sensor.why_not]

    @property
    def all_warnings(self) -> tuple[str, ...]:
        """Those of the messages of the sensors that are used, with their names, and those of the frames."""
        of_sensors = (f"{one.name}: {warning}" for one in self.used for warning in one.measured.warnings)
        return (*of_sensors, *self.warnings)

    def mount_of(self, sensor: SensorProposal) -> Mount | None:
        """Return where the frame of a sensor sits; None for that of the IMU, and for what has no mount."""
        return next((mount for mount in self.mounts if mount.child == sensor.frame), None)


def propose(
    recording: str,
    topics: Iterable[Topic],
    kinds: Iterable[TopicKind],
    measured: Mapping[str, Measured] | None = None,
    frames: RecordedFrames | None = None,
) -> Proposal:
    """Return what is proposed for a recording.

    Args:
        recording: its name, for the messages.
        topics: what it holds.
        kinds: how topics of every kind of measurement are found.
        measured: what the messages of some topics came to, by topic.
        frames: what the recording tells of frames.

    Raises:
        RecordingError: no topic can be the IMU.
    """
    topics, frames = list(topics), frames or RecordedFrames()
    found = assign(topics, kinds)
    imu = next((guess for guess in found.guesses if guess.kind == "imu"), None)
    if imu is None:
        there = one_line(", ".join(described(topic) for topic in topics)) or "nothing"
        raise RecordingError(f"{recording}: no IMU in it, and Holdfast cannot do without one (it has {there})")
    sensors = [_sensor(guess, found.guesses, measured or {}, frames) for guess in found.guesses]
    machine = _Machine(sensors, frames)
    return Proposal(
        recording,
        tuple(machine.sensors),
        tuple(machine.mounts()),
        machine.turn_joint(),
        machine.base,
        tuple(dict.fromkeys((*frames.warnings, *machine.warnings))),
        found.unused,
    )


def antenna_of(guess: Guess, antennas: Sequence[Guess]) -> Guess | None:
    """Return the antenna whose velocity a topic tells: that of the same receiver, else the only one."""
    if KINDS[guess.kind] is not GnssVelocityConfig:
        return None
    same = [antenna for antenna in antennas if namespace(antenna.topic) == namespace(guess.topic)]
    return next(iter(same), antennas[0] if len(antennas) == 1 else None)


def only_what_is_known(proposal: Proposal) -> Proposal:
    """Return a proposal that a replay can run by: without sensors whose mounts are needed and not known.

    One antenna stays, at the IMU, where none is known; and of what measures neither position nor velocity one sensor,
    where nothing else is left beside the IMU. Those that go say why in `why_not`.
    """
    unknown = {mount.child for mount in proposal.mounts if mount.T is None}
    antennas = [sensor for sensor in proposal.used if sensor.section is GnssConfig]
    known = [sensor for sensor in antennas if sensor.frame not in unknown]
    kept_antennas = known or antennas[:1]
    joint = proposal.turn_joint
    origin = next(sensor.frame for sensor in proposal.used if sensor.section is ImuConfig)
    turns = joint is not None and joint.T is not None and joint.child not in unknown and not _is_nameless(proposal)
    kept: list[str] = []
    for sensor in proposal.used:
        if sensor.section is ImuConfig or sensor in kept_antennas:
            kept.append(sensor.name)
        elif sensor.section is HeadingConfig:
            kept += [sensor.name] * (len(known) > 1)
        elif sensor.guess.kind in ("joint", "base_imu"):
            kept += [sensor.name] * turns
        elif sensor.frame in {antenna.frame for antenna in kept_antennas}:
            kept.append(sensor.name)
        elif sensor.frame not in unknown:
            mount = proposal.mount_of(sensor)
            kept += [sensor.name] * (turns or mount is None or mount.parent == origin)
    if len(kept) == 1:
        kept += [s.name for s in proposal.used if s.guess.kind not in ("imu", "joint", "base_imu", "heading")][:1]
    sensors = [s if s.why_not or s.name in kept else replace(s, why_not=NOT_MOUNTED) for s in proposal.sensors]
    frames = {sensor.frame for sensor in sensors if not sensor.why_not} | {proposal.base}
    frames |= {joint.parent, joint.child} if joint is not None and turns else set()
    mounts = [mount for mount in proposal.mounts if mount.child in frames]
    if not turns:
        mounts = [mount for mount in mounts if mount.parent == origin]
    return replace(proposal, sensors=tuple(sensors), mounts=tuple(mounts), turn_joint=joint if turns else None)


def _is_nameless(proposal: Proposal) -> bool:
    """Whether nobody knows which of several joints is the turn joint."""
    joint = next((sensor for sensor in proposal.used if sensor.guess.kind == "joint"), None)
    return joint is not None and "joint_name" in joint.measured.remarks and "joint_name" not in joint.given


def _sensor(
    guess: Guess, guesses: Sequence[Guess], measured: Mapping[str, Measured], frames: RecordedFrames
) -> SensorProposal:
    """Return the section of one sensor without its frame."""
    section: type[Any] = KINDS[guess.kind]
    place = Place(section, None)
    given = {"kind": guess.kind, "topic": guess.topic.topic, **guess.rule.given}
    found = measured.get(guess.topic.topic, Measured())
    several_imus = sum(KINDS[other.kind] is ImuConfig for other in guesses) > 1
    if section is ImuConfig and several_imus and not guess.rule.spare:
        given["primary"] = True
    has_gnss = any(other.kind == "gnss" for other in guesses)
    needs_datum = has_gnss and section.model_validate(given).is_in_world()
    offsets = {key: value for key, value in UNKNOWN_FRAME.items() if needs_datum and place.child(key)}
    if guess.rule.spare or (needs_datum and not offsets):
        why_not = "beside GNSS it needs frames.datum" if needs_datum else "not used beside the primary one"
        return SensorProposal(guess, given, found, why_not)
    odometry = next((other for other in guesses if KINDS[other.kind] is OdometryConfig), None)
    if section is ScansConfig and odometry is not None:
        return SensorProposal(guess, given, found, f"not used beside the odometry {odometry.topic.topic}")
    if (names := frames.joints.get(guess.topic.topic, ())) and place.child("joint_name"):
        found = found.joined(_joint_name(guess, names))
    given |= offsets | {key: value for key, value in found.values.items() if place.child(key)}
    return SensorProposal(guess, given, found)


def _joint_name(guess: Guess, names: Sequence[str]) -> Measured:
    """Return which of the joints is the turn joint: the only one, or the only one whose name says so."""
    telling = [name for name in names if any(word in name.lower() for word in guess.rule.prefer)]
    chosen = names if len(names) == 1 else telling
    if len(chosen) == 1:
        why = "the only one in its messages" if len(names) == 1 else f"by its name, of {', '.join(names)}"
        return Measured((), {"joint_name": why}, {"joint_name": chosen[0]})
    return Measured((), {"joint_name": f"TODO choose: {', '.join(names)}"})


class _Machine:
    """Puts sensors into the frames of a recording: a working object that `propose` throws away."""

    def __init__(self, sensors: Sequence[SensorProposal], frames: RecordedFrames) -> None:
        self._frames = frames
        self.warnings: list[str] = []
        self.sensors = self._framed(sensors)
        self.origin = next(s.frame for s in self.sensors if s.section is ImuConfig and not s.guess.rule.spare)
        self._rigid = frames.joined(self.origin)
        self._leave_out_a_joint_that_turns_nothing()
        self._has_joint = any(sensor.guess.kind == "joint" for sensor in self.used)
        self.cabin = frames.root(self.origin) if self._rigid else CABIN
        self.base = self._base()

    @property
    def used(self) -> list[SensorProposal]:
        """The sensors that are used."""
        return [sensor for sensor in self.sensors if not sensor.why_not]

    def mounts(self) -> Iterator[Mount]:
        """Yield the transforms that the configuration needs."""
        if self._has_joint and self.cabin != self.origin:
            yield self._mount(self.origin, self.cabin)
        elif self.base in self._rigid:
            yield self._mount(self.origin, self.base)
        seen = {self.origin, self.base, *([self.cabin] if self._has_joint else [])}
        if (joint := self.turn_joint()) is not None and joint.parent not in seen:
            yield self._mount(self.base, joint.parent)
            seen.add(joint.parent)
        for sensor in self.sensors:  # also of one that a user may want to use
            is_left_out = bool(sensor.why_not) and sensor.guess.kind in ("base_imu", "scans")
            if issubclass(sensor.section, MountedConfig) and sensor.section is not ImuConfig and not is_left_out:
                if sensor.frame not in seen:
                    yield self._mount(self._parent(sensor), sensor.frame, sensor)
                seen.add(sensor.frame)

    def turn_joint(self) -> Mount | None:
        """Return how the cabin sits on the chassis, if it turns."""
        if not self._has_joint:
            return None
        link = self._turning()
        return Mount(self.base, self.cabin) if link is None else Mount(link.parent, link.child, link.T, link.source)

    def _framed(self, sensors: Sequence[SensorProposal]) -> list[SensorProposal]:
        """Return the sensors with the frames that their messages name, where the recording knows those."""
        guesses = [sensor.guess for sensor in sensors]
        antennas = [guess for guess in guesses if guess.kind == "gnss"]
        named = {sensor.name: self._named_frame(sensor) for sensor in sensors}
        for name in _sharing([sensor for sensor in sensors if sensor.section is GnssConfig], named):
            self.warnings.append(f"{name}: its messages name the frame of another antenna: where it is, is not known")
            named[name] = None
        framed = []
        for sensor in sensors:
            antenna = antenna_of(sensor.guess, antennas)
            whose = sensor.name if antenna is None else antenna.sensor
            frame = named[whose] or ("" if antenna is None else antenna.sensor)
            by_name = not frame and self._frames.knows(sensor.name) and issubclass(sensor.section, MountedConfig)
            if by_name or (frame and frame != sensor.name):
                frame = frame or sensor.name
                source = "by its name, which the messages do not tell" if by_name else "as its messages say"
                source = "that of its antenna" if antenna is not None else source
                remarks = Measured((), {"frame": source})
                sensor = replace(  # noqa: PLW2901
                    sensor, given={**sensor.given, "frame": frame}, measured=sensor.measured.joined(remarks)
                )
            framed.append(sensor)
        return framed

    def _named_frame(self, sensor: SensorProposal) -> str | None:
        """Return the frame that the messages of a sensor name; None if it leads nowhere."""
        frame = self._frames.of_topic.get(sensor.guess.topic.topic)
        if frame is None or not issubclass(sensor.section, MountedConfig) or sensor.why_not:
            return None
        if self._frames.knows(frame):
            return frame
        if self._frames.links:
            self.warnings.append(f"{sensor.name}: its messages name the frame {frame!r}, which no transform joins")
        return None

    def _leave_out_a_joint_that_turns_nothing(self) -> None:
        if BASE not in self._rigid and self.origin != BASE:
            return
        why_not = f"not used: {self.origin} and {BASE} are joined rigidly, nothing turns between them"
        self.sensors = [
            replace(sensor, why_not=why_not) if sensor.guess.kind in ("joint", "base_imu") else sensor
            for sensor in self.sensors
        ]

    def _base(self) -> str:
        """Return the frame of the chassis: the usual one, or else the root of what is joined below the turn joint."""
        if self._frames.knows(BASE) or not self._frames.links:
            return BASE
        if not self._has_joint:
            return self._frames.root(self.origin) if self._rigid else BASE
        link = self._turning()
        return BASE if link is None else self._frames.root(link.parent)

    def _turning(self) -> RecordedLink | None:
        return next((link for link in self._frames.turning if link.child == self.cabin), None)

    def _parent(self, sensor: SensorProposal) -> str:
        """Return the frame in which the mount of a sensor is given: that of the IMU, or the base beyond the joint."""
        is_base_imu = sensor.guess.kind == "base_imu"
        if sensor.frame in self._rigid or not (self._has_joint or is_base_imu):
            return self.origin
        is_below = is_base_imu or sensor.guess.rule.on_chassis
        return self.base if is_below or sensor.frame in self._frames.joined(self.base) else self.origin

    def _mount(self, parent: str, child: str, sensor: SensorProposal | None = None) -> Mount:
        turns = sensor is None or sensor.section not in (GnssConfig, GnssVelocityConfig)
        joined = self._frames.joined(parent).get(child)
        if joined is not None:
            return Mount(parent, child, joined.T, joined.source, turns)
        if self._frames.knows(child) and self._frames.links:
            self.warnings.append(f"no rigid transform of the recording leads from {parent!r} to {child!r}")
        return Mount(parent, child, None, "", turns)


def _sharing(antennas: Sequence[SensorProposal], named: Mapping[str, str | None]) -> list[str]:
    """Return the antennas whose frame is that of an earlier one."""
    frames = [named[antenna.name] for antenna in antennas]
    return [a.name for k, a in enumerate(antennas) if frames[k] is not None and frames[k] in frames[:k]]
