"""The IMU beside the GNSS receivers, for the first configuration of a recording: clocks, axes and units of both."""

from collections.abc import Iterator, Mapping, Sequence
from statistics import median

import numpy as np

from holdfast.config.assignment import Guess, Measured, namespace
from holdfast.config.proposal import antenna_of
from holdfast.config.sensors import MOST_OFFSET_S
from holdfast.errors import RecordingError
from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.messages import Array, FixStatus, GnssFix, GnssVelocity, Heading, ImuSample, Message
from holdfast.recording import velocity_convention
from holdfast.recording.clock_offset import ClockOffset, pooled
from holdfast.recording.heading_convention import is_clockwise
from holdfast.recording.imu_mended import Mended, Received, mended
from holdfast.recording.kinds import SATELLITE
from holdfast.recording.source import Recording, Subscription

WINDOWS_S = ((0.0, 120.0), (120.0, 180.0))  # begin and length; the second where the first tells too little
WANTED_SIGMA_S = 0.012
MAX_RATE_HZ = 5.0  # of a receiver; more tell no more of a machine's motion
ORDERS = {"gnss": 2, "gnss_velocity": 1}
CLOCKWISE = Measured(
    remarks={"clockwise": "it turns the other way than the gyroscope, as a compass does"}, values={"clockwise": True}
)


def imu_beside_receivers(recording: Recording, guesses: Sequence[Guess]) -> dict[str, Measured]:
    """Return by topic what a configuration can say of the IMU and of the receivers; reads at most five minutes.

    Where a driver gives other units or signs, a warning says so, and all else is measured with what mends them.
    """
    used = [guess for guess in guesses if not guess.rule.spare and guess.kind in {"imu", "heading", *ORDERS}]
    receivers = {guess.topic.topic: ORDERS[guess.kind] for guess in used if guess.kind in ORDERS}
    imu_topic = next((guess.topic.topic for guess in used if guess.kind == "imu"), None)
    if imu_topic is None:
        return {}
    messages: dict[str, list[Message]] = {guess.topic.topic: [] for guess in used}
    received: dict[str, Received] = {}
    wrong: dict[str, Measured] = {}
    imu = mended(np.empty(0), np.empty((0, 6)), {})
    for start_s, duration_s in WINDOWS_S:
        news = list(read_window(recording, [_as_guessed(guess) for guess in used], start_s, duration_s))
        if not news:
            continue
        for message in news:
            messages[message.sensor].append(message)
        received = received_beside(messages, imu_topic, receivers)
        wrong = dict(_wrong_velocities(received, used))
        right = {topic: one for topic, one in received.items() if topic not in wrong}
        imu = mended(*imu_rows(messages[imu_topic]), right)
        if all(offset is not None and offset.sigma_s <= WANTED_SIGMA_S for offset in imu.offsets.values()):
            break
    measured = {topic: _measured(offset) for topic, offset in _of_receivers(imu.offsets, guesses).items()} | wrong
    for topic, one in received.items():
        if abs(one.behind_s) > MOST_OFFSET_S:
            measured[topic] = Measured(warnings=(_far(one.behind_s),))
    for topic in (guess.topic.topic for guess in used if guess.kind == "heading"):
        if is_clockwise(imu.times_s, imu.readings, *_heading(messages[topic])):
            measured[topic] = CLOCKWISE.joined(measured.get(topic, Measured()))
    return measured | ({imu_topic: _of_driver(imu)} if imu.mistakes else {})


def received_beside(
    messages: Mapping[str, Sequence[Message]], imu: str, receivers: Mapping[str, int]
) -> dict[str, Received]:
    """Return what receivers say, by sensor; `receivers` says the order of each, see `Received`."""
    delay_s = _delay_s(messages[imu])
    return {
        name: Received(*_receiver(messages[name]), order, _delay_s(messages[name]) - delay_s)
        for name, order in receivers.items()
    }


def _of_driver(imu: Mended) -> Measured:
    """Return the factors that mend what the driver of an IMU says."""
    why = "; ".join(imu.mistakes)
    needed = {key: tuple(float(f"{factor:.9g}") for factor in factors) for key, factors in imu.needed.items()}
    return Measured((), dict.fromkeys(needed, why), needed, (f"{why}: mended by {' and '.join(needed)}",))


def _as_guessed(guess: Guess) -> Subscription:
    return Subscription(guess.topic.topic, guess.topic.topic, guess.kind)


def _wrong_velocities(received: Mapping[str, Received], guesses: Sequence[Guess]) -> Iterator[tuple[str, Measured]]:
    """Yield the topics whose velocities are not those of their receiver's fixes, with a warning."""
    antennas = [guess for guess in guesses if guess.kind == "gnss"]
    for guess in guesses:
        antenna, topic = antenna_of(guess, antennas), guess.topic.topic
        if antenna is None:
            continue
        fixes, velocities = received[antenna.topic.topic], received[topic]
        found = velocity_convention.mistake(fixes.times_s, fixes.values, velocities.times_s, velocities.values)
        if found is not None:
            warning = (
                f"it goes with the fixes of {antenna.topic.topic} as if {found[0]} (residuals {found[1]:.1f} times "
                "smaller); its driver must give the velocity east, north, up in m/s"
            )
            yield topic, Measured(warnings=(warning,))


def _far(behind_s: float) -> str:
    way = "behind" if behind_s > 0.0 else "ahead of"
    return f"its stamps are {abs(behind_s):.0f} s {way} the IMU's, by their arrivals; both drivers must use one clock"


def read_window(
    recording: Recording, subscriptions: Sequence[Subscription], start_s: float, duration_s: float
) -> Iterator[Message]:
    """Yield the messages of a window, up to the end or the damage of the recording."""
    try:
        yield from recording.read(subscriptions, start_s, duration_s)
    except RecordingError:
        return


def imu_rows(messages: Sequence[Message]) -> tuple[Array, Array]:
    """Return stamps (N,) [s] and readings (N, 6)."""
    samples = [one for one in messages if isinstance(one, ImuSample)]
    return _ordered([one.stamp_ns for one in samples], np.array([one.values() for one in samples]).reshape(-1, 6))


def _receiver(messages: Sequence[Message]) -> tuple[Array, Array]:
    """Return stamps (M,) [s] and velocities or positions (M, 3) in a local frame, of at most 5 Hz."""
    fixes = [one for one in messages if isinstance(one, GnssFix) and one.status is not FixStatus.NO_FIX]
    velocities = [one for one in messages if isinstance(one, GnssVelocity)]
    points = [Geodetic(fix.latitude_deg, fix.longitude_deg, fix.altitude_m) for fix in fixes]
    frame = LocalFrame(next(filter(_is_on_earth, points), Geodetic(0.0, 0.0, 0.0)))
    rows = [frame.to_enu(point) if _is_on_earth(point) else np.full(3, np.nan) for point in points]
    rows += [np.append(one.velocity[:2], np.nan_to_num(one.velocity[2])) for one in velocities]
    stamps = [fix.stamp_ns for fix in fixes] + [velocity.stamp_ns for velocity in velocities]
    times_s, values = _ordered(stamps, np.array(rows).reshape(-1, 3))
    step = max(1, round(1.0 / (MAX_RATE_HZ * float(np.median(np.diff(times_s)))))) if len(times_s) > 1 else 1
    return times_s[::step], values[::step]


def _delay_s(messages: Sequence[Message]) -> float:
    """Return by how much messages arrive later than they are stamped [s]; 0 for none."""
    return median(one.arrival_ns - one.stamp_ns for one in messages) * 1e-9 if messages else 0.0


def _heading(messages: Sequence[Message]) -> tuple[Array, Array]:
    """Return stamps (M,) [s] and headings (M,) [rad]."""
    headings = [one for one in messages if isinstance(one, Heading)]
    rows = np.array([one.yaw_rad for one in headings]).reshape(-1, 1)
    times_s, values = _ordered([one.stamp_ns for one in headings], rows)
    return times_s, values[:, 0]


def _is_on_earth(point: Geodetic) -> bool:
    return bool(np.isfinite(point).all()) and abs(point.latitude_deg) <= 90.0


def _ordered(stamps_ns: Sequence[int], rows: Array) -> tuple[Array, Array]:
    """Return finite rows by increasing stamps [s]."""
    stamps, first = np.unique(np.array(stamps_ns, dtype=np.int64), return_index=True)
    finite = np.isfinite(rows[first]).all(axis=1)
    return stamps[finite].astype(np.float64) * 1e-9, rows[first][finite]


def _of_receivers(offsets: Mapping[str, ClockOffset | None], guesses: Sequence[Guess]) -> dict[str, ClockOffset | None]:
    """Return the offset of every topic of a receiver: all are of one clock where fixes and velocities do not disagree.

    A velocity that the receiver differences from positions is late by half their period, so they may well.
    """
    found = dict(offsets)
    antennas = [guess for guess in guesses if guess.kind == "gnss"]
    for guess in guesses:
        antenna = antenna_of(guess, antennas)
        if antenna is not None and guess.topic.topic in offsets:
            fix, velocity = offsets[antenna.topic.topic], offsets[guess.topic.topic]
            found[antenna.topic.topic], found[guess.topic.topic] = pooled(fix, velocity)
    for guess in guesses:
        if guess.kind == "heading" and any(word in guess.topic.topic for word in SATELLITE):  # a compass has its own
            own = (a.topic.topic for a in antennas if a.topic.topic.startswith(f"{namespace(guess.topic)}/"))
            if (antenna_topic := next(own, None)) is not None:
                found[guess.topic.topic] = found[antenna_topic]
    return found


def _measured(offset: ClockOffset | None) -> Measured:
    """Return an offset as a value if it is clear, else as a note."""
    if offset is None:
        return Measured(("clock against the IMU: too little motion to measure it",))
    if not offset.is_clear():
        return Measured((f"clock against the IMU: {offset}",))
    return Measured((), {"time_offset_s": f"measured {offset}"}, {"time_offset_s": round(offset.offset_s, 3)})
