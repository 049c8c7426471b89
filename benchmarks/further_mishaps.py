"""What else may happen to a drive, for `drive_mishaps.py --further`: losses, clocks, claims, and worse IMUs."""

from dataclasses import replace

import numpy as np
from drive_faults import moved
from mishaps import GNSS, Messages, Mishap, changed, claiming, direction, every_nth, read_as, since_s

from holdfast.messages import GnssFix, GnssVelocity, ImuSample, Message


def lost_samples(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Samples of the IMU are lost by chance."""
    share = float(rng.choice([0.1, 0.3, 0.6]))
    left = [one for one in messages if not isinstance(one, ImuSample) or rng.random() > share]
    return left, f"{share:.0%} of samples lost"


def rare_samples(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Of the samples every fifth or tenth comes."""
    every = int(rng.choice([5, 10]))
    return every_nth(ImuSample, messages, every), f"IMU rate / {every}"


def scales(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The IMU's axes have scale errors of up to 4 and 6 %."""
    of_force, of_rate = 1.0 + rng.uniform(-0.04, 0.04, 3), 1.0 + rng.uniform(-0.06, 0.06, 3)
    return read_as(lambda force, rate: (force * of_force, rate * of_rate), messages), "scale errors"


def biases(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The IMU has biases of 3 to 8 deg/s and 0.5 to 1.5 m/s^2, ten times what is believed at power-on."""
    rate_deg_s, force_m_s2 = rng.uniform(3.0, 8.0), rng.uniform(0.5, 1.5)
    of_rate, of_force = np.radians(rate_deg_s) * direction(rng), force_m_s2 * direction(rng)
    biased = read_as(lambda force, rate: (force + of_force, rate + of_rate), messages)
    return biased, f"biases {rate_deg_s:.0f} deg/s {force_m_s2:.1f} m/s^2"


def coarse(_: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The IMU reads in steps of 0.3 deg/s and 0.08 m/s^2."""
    return read_as(
        lambda force, rate: (np.round(force / 0.08) * 0.08, np.round(rate / 0.005) * 0.005), messages
    ), "IMU coarse"


def vibration(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The machine shakes."""
    shakes = float(rng.choice([1.0, 5.0]))

    def shaken(force: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return force + shakes * rng.standard_normal(3), rate + 0.05 * shakes * rng.standard_normal(3)

    return read_as(shaken, messages), f"vibration {shakes:g} m/s^2"


def clock_step(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """All clocks step."""
    at_s = rng.uniform(0.2, 0.8) * since_s(messages, messages[-1])
    by_s = float(rng.choice([1.0, -1.0, 3600.0, -3600.0, 1.5e9]))

    def step(one: Message) -> Message:
        return replace(one, stamp_ns=one.stamp_ns + int(by_s * 1e9)) if since_s(messages, one) > at_s else one

    return [step(one) for one in messages], f"clocks step by {by_s:g} s at {at_s:.0f} s"


def late(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """What the receiver says arrives late, or every fifth fix does."""
    by_s, share = [(0.3, 1.0), (1.0, 1.0), (2.2, 1.0), (1.2, 0.2)][int(rng.integers(4))]

    def delayed(one: GnssFix | GnssVelocity) -> GnssFix | GnssVelocity:
        return replace(one, arrival_ns=one.arrival_ns + int(by_s * 1e9)) if rng.random() < share else one

    arrived = sorted(changed(GNSS, messages, delayed), key=lambda one: one.arrival_ns)
    return arrived, f"{share:.0%} of GNSS {by_s:g} s late"


def twice(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """A third of what the receiver says comes twice."""
    repeated = [one for one in messages for _ in range(1 + (isinstance(one, GNSS) and rng.random() < 1 / 3))]
    return repeated, "GNSS in part twice"


def no_claims(_: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Fixes come without a covariance."""
    return changed(GnssFix, messages, lambda one: replace(one, covariance=None)), "no claims"


def claims_of_velocity(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Doppler velocities claim ten times too much or too little."""
    factor = float(rng.choice([0.1, 10.0]))
    return claiming(GnssVelocity, factor, messages), f"Doppler claims {factor:g} times"


def outliers(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Fixes are elsewhere by 10 to 80 m, by chance, and claim a metre."""
    share = float(rng.choice([0.03, 0.1]))

    def elsewhere(one: GnssFix) -> GnssFix:
        return moved(one, rng.uniform(10.0, 80.0) * direction(rng)) if rng.random() < share else one

    return changed(GnssFix, messages, elsewhere), f"{share:.0%} of fixes elsewhere"


FURTHER: tuple[Mishap, ...] = (
    lost_samples,
    rare_samples,
    scales,
    biases,
    coarse,
    vibration,
    clock_step,
    late,
    twice,
    no_claims,
    claims_of_velocity,
    outliers,
)
LYING: tuple[Mishap, ...] = (outliers,)
