"""What may happen to a drive, for `drive_mishaps.py`: outages, silences, mounts, rates, noise, jumps, clocks."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.geometry.rotations import exponentials
from holdfast.messages import GnssFix, GnssVelocity, ImuSample, Message

Messages = list[Message]
Mishap = Callable[[np.random.Generator, Messages], tuple[Messages, str]]
GNSS = GnssFix, GnssVelocity


def direction(rng: np.random.Generator) -> np.ndarray:
    """Return a unit vector (3,)."""
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)


def since_s(messages: Messages, one: Message) -> float:
    """Return how long after the first message one was stamped [s]."""
    return (one.stamp_ns - messages[0].stamp_ns) * 1e-9


def spans(rng: np.random.Generator, messages: Messages, most: int, lengths_s: list[float]) -> list[tuple[float, float]]:
    """Return up to so many spans of time within a drive, each as long as one of the lengths."""
    length_s = since_s(messages, messages[-1])
    starts = rng.uniform(0.1, 0.9, int(rng.integers(1, most + 1))) * length_s
    return [(float(start), float(start + rng.choice(lengths_s))) for start in starts]


def changed(kinds: Any, messages: Messages, change: Callable[[Any], Any]) -> Messages:
    """Return the messages with those of some kinds changed."""
    return [change(one) if isinstance(one, kinds) else one for one in messages]


def read_as(change: Callable[[Any, Any], tuple[Any, Any]], messages: Messages) -> Messages:
    """Return the messages with other readings of the IMU: of (3,) specific force and (3,) angular velocity."""

    def other(one: ImuSample) -> ImuSample:
        force, rate = change(one.specific_force, one.angular_velocity)
        return replace(one, specific_force=force, angular_velocity=rate)

    return changed(ImuSample, messages, other)


def claiming(kind: type[Message], factor: float, messages: Messages) -> Messages:
    """Return the messages with so many times the sigma in the claims of one kind."""

    def other(one: Any) -> Any:
        return one if one.covariance is None else replace(one, covariance=one.covariance * factor**2)

    return changed(kind, messages, other)


def every_nth(kind: type[Message], messages: Messages, n: int) -> Messages:
    """Return the messages with every n-th of one kind alone."""
    kept = {id(one) for one in [one for one in messages if isinstance(one, kind)][::n]}
    return [one for one in messages if not isinstance(one, kind) or id(one) in kept]


def without(kinds: Any, messages: Messages, when: list[tuple[float, float]]) -> tuple[Messages, str]:
    """Return the messages without those of some kinds in spans of time, and the spans."""
    left = [
        one for one in messages if not (isinstance(one, kinds) and any(a < since_s(messages, one) < b for a, b in when))
    ]
    return left, told(when)


def told(when: list[tuple[float, float]]) -> str:
    """Return spans of time in words."""
    return " ".join(f"{a:.0f}+{b - a:g}" for a, b in when)


def silent(kind: type[Message]) -> Mishap:
    """Messages of one kind are missing, up to four times."""

    def gone(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
        left, when = without(kind, messages, spans(rng, messages, 4, [1.0, 5.0, 30.0]))
        return left, f"silent {when}"

    return gone


def clock_of(kind: type[Message], said: str = "clock") -> Mishap:
    """The clock of a sensor is off by up to 0.25 s."""

    def off(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
        by_ns = int(rng.uniform(-2.5e8, 2.5e8))
        shifted = changed(kind, messages, lambda one: replace(one, stamp_ns=one.stamp_ns + by_ns))
        return shifted, f"{said} {by_ns * 1e-9:+.2f} s"

    return off


def rare(kind: type[Message], said: str = "one") -> Mishap:
    """Of the messages of a kind every n-th comes."""

    def few(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
        every = int(rng.choice([3, 10, 30]))
        return every_nth(kind, messages, every), f"{said} of {every}"

    return few


def repeating(kind: type[Message], keys: tuple[str, ...], lengths_s: list[float], said: str) -> Mishap:
    """A sensor repeats what some keys of its messages said, up to three times."""

    def repeats(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
        when, last = spans(rng, messages, 3, lengths_s), dict[str, Any]()

        def held(one: Any) -> Any:
            if not any(a < since_s(messages, one) < b for a, b in when):
                last["message"] = one
            still = last.get("message", one)
            return replace(one, **{key: getattr(still, key) for key in keys})

        return changed(kind, messages, held), f"{said} {told(when)}"

    return repeats


def outages(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """GNSS is away up to three times."""
    left, said = without(GNSS, messages, spans(rng, messages, 3, [10.0, 30.0]))
    return left, f"GNSS away {said}"


def silences(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The IMU is silent up to five times."""
    left, said = without(ImuSample, messages, spans(rng, messages, 5, [0.3, 1.0, 3.0]))
    return left, f"IMU silent {said}"


def late_start(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The recording begins somewhere in the first 40 %, mostly in motion."""
    from_s = rng.uniform(0.0, 0.4) * since_s(messages, messages[-1])
    return [one for one in messages if since_s(messages, one) >= from_s], f"from {from_s:.0f} s"


def any_mount(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The IMU is mounted in any attitude."""
    R = exponentials(rng.uniform(0.0, np.pi) * direction(rng)[None])[0]
    return read_as(lambda force, rate: (R @ force, R @ rate), messages), "any mount"


def few_fixes(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Of the fixes every n-th comes."""
    every = int(rng.choice([2, 5]))
    return every_nth(GnssFix, messages, every), f"a fix of {every}"


def worse_imu(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The IMU has biases of up to 2 deg/s and 0.4 m/s^2, and more noise."""
    of_rate, of_force = np.radians(rng.uniform(0.0, 2.0)) * direction(rng), rng.uniform(0.0, 0.4) * direction(rng)
    noise_rad_s, noise_m_s2 = [(0.0, 0.0), (0.005, 0.05), (0.02, 0.3)][int(rng.integers(3))]

    def worse(force: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rate = rate + of_rate + noise_rad_s * rng.standard_normal(3)
        return force + of_force + noise_m_s2 * rng.standard_normal(3), rate

    return read_as(worse, messages), f"noise {noise_rad_s:g} rad/s"


def jump(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The gyroscope's bias jumps by up to 3 deg/s."""
    at_s, by_deg_s = rng.uniform(0.2, 0.8) * since_s(messages, messages[-1]), rng.uniform(0.5, 3.0)
    by = np.radians(by_deg_s) * direction(rng)

    def jumped(one: ImuSample) -> ImuSample:
        is_later = since_s(messages, one) > at_s
        return replace(one, angular_velocity=one.angular_velocity + by) if is_later else one

    return changed(ImuSample, messages, jumped), f"gyroscope {by_deg_s:.1f} deg/s at {at_s:.0f} s"


def clock(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The clock of the receiver is off by up to 0.3 s."""
    by_ns = int(rng.uniform(-3e8, 3e8))
    shifted = changed(GNSS, messages, lambda one: replace(one, stamp_ns=one.stamp_ns + by_ns))
    return shifted, f"clock {by_ns * 1e-9:+.2f} s"


def claims(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Fixes claim a tenth or a third of their sigma."""
    factor = float(rng.choice([0.1, 0.3]))
    return claiming(GnssFix, factor, messages), f"claims {factor:g} times"


def no_velocities(_: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The receiver gives no Doppler velocities."""
    return [one for one in messages if not isinstance(one, GnssVelocity)], "no Doppler"


def slow_imu(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Of the samples every second or fourth comes."""
    every = int(rng.choice([2, 4]))
    return every_nth(ImuSample, messages, every), f"IMU rate / {every}"


MISHAPS: tuple[Mishap, ...] = (
    late_start,
    any_mount,
    outages,
    few_fixes,
    worse_imu,
    silences,
    clock,
    claims,
    no_velocities,
    slow_imu,
    jump,
)
