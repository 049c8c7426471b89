"""How vehicles move that are neither excavators nor cars, for `vehicles.py`: smooth at random, and known exactly."""

from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

G = 9.81
FLOWN_S = 40.0  # before a recording that begins in the air
STOPPED_S, REACH_M_S2 = (2.0, 8.0), 1.2  # how long a stop lasts, and how fast what stops drives off


class Motion(NamedTuple):
    """What a vehicle does at times (n,).

    Attributes:
        p: (n, 3) [m].
        attitude: (n,) of the vehicle: x ahead, y to the left, z up.
        shaken: (n,) density of its vibration [m/s^2/sqrt(Hz)].
    """

    p: np.ndarray
    attitude: Rotation
    shaken: np.ndarray


Vehicle = Callable[[np.random.Generator, np.ndarray], Motion]


def smoothed(t: np.ndarray, values: np.ndarray, over_s: float, mode: str = "nearest") -> np.ndarray:
    """Return values (n, ...) at times (n,), smoothed over a time, to rounding."""
    return gaussian_filter1d(values, over_s / (t[1] - t[0]), axis=0, mode=mode, truncate=7.0)


def wander(rng: np.random.Generator, t: np.ndarray, sigma: float, over_s: float) -> np.ndarray:
    """Return a random course (n,) about zero that changes over a time."""
    course = smoothed(t, rng.standard_normal(len(t)), over_s, mode="wrap")
    return sigma * course / course.std()


def ramps(t: np.ndarray, knots: Sequence[tuple[float, float]], over_s: float = 1.0) -> np.ndarray:
    """Return values (n,) that go through knots of time and value, rounded over a time."""
    return smoothed(t, np.interp(t, *zip(*knots, strict=True)), over_s)


def integral(t: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return what begins at zero and has rates (n, ...) at times (n,)."""
    steps = 0.5 * (t[1] - t[0]) * (rates[1:] + rates[:-1])
    return np.concatenate([np.zeros_like(rates[:1]), np.cumsum(steps, axis=0)])


def ahead(t: np.ndarray, yaw: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Return positions (n, 3) of what goes where it looks, in a plane."""
    return integral(t, speed[:, None] * np.stack([np.cos(yaw), np.sin(yaw), 0.0 * t], axis=1))


def angles(yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> Rotation:
    """Return attitudes (n,); pitch is positive with the nose down."""
    return Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1))


def hanging(t: np.ndarray, p: np.ndarray, yaw: np.ndarray) -> Rotation:
    """Return attitudes (n,) in which all force is along the vertical axis, as of what hangs or is lifted by thrust."""
    force = np.gradient(np.gradient(p, t, axis=0), t, axis=0)
    force[:, 2] += G
    up = force / np.linalg.norm(force, axis=1)[:, None]
    left = np.cross(up, np.stack([np.cos(yaw), np.sin(yaw), 0.0 * t], axis=1))
    left /= np.linalg.norm(left, axis=1)[:, None]
    return Rotation.from_matrix(np.stack([np.cross(left, up), left, up], axis=2))


def stop_and_go(rng: np.random.Generator, t: np.ndarray, speed_m_s: float, drive_s: float) -> np.ndarray:
    """Return speeds (n,) that are kept for about a time, with stops between."""

    def knots() -> Iterator[tuple[float, float]]:
        at_s = 8.0
        yield 0.0, 0.0
        while at_s < t[-1]:
            fast = speed_m_s * rng.uniform(0.6, 1.0)
            ramp_s, kept_s = max(2.0, fast / REACH_M_S2), drive_s * rng.uniform(0.6, 1.4)
            yield at_s, 0.0
            yield at_s + ramp_s, fast
            yield at_s + ramp_s + kept_s, fast
            at_s += 2.0 * ramp_s + kept_s
            yield at_s, 0.0
            at_s += rng.uniform(*STOPPED_S)

    return ramps(t, list(knots()), 0.5)


def multicopter(rng: np.random.Generator, t: np.ndarray) -> Motion:
    """Ten seconds on the ground, then it tilts to accelerate, and looks elsewhere than it flies."""
    flying = ramps(t, [(10.0, 0.0), (16.0, 1.0)], 1.5)
    velocity = flying[:, None] * np.stack([wander(rng, t, sigma, 4.0) for sigma in (4.0, 4.0, 0.7)], axis=1)
    velocity[:, 2] += 2.0 * flying * (t < 30.0)
    p = integral(t, smoothed(t, velocity, 0.5))
    return Motion(p, hanging(t, p, flying * wander(rng, t, 1.5, 10.0)), 0.002 + 0.1 * (flying > 0.01))


def multicopter_in_flight(rng: np.random.Generator, t: np.ndarray) -> Motion:
    """The recording begins in the air."""
    begun = round(FLOWN_S / (t[1] - t[0]))
    motion = multicopter(rng, np.arange(len(t) + begun) * (t[1] - t[0]))
    return Motion(motion.p[begun:], motion.attitude[begun:], motion.shaken[begun:])


def aeroplane(rng: np.random.Generator, t: np.ndarray) -> Motion:
    """In the air from the first sample, 45 m/s; in banked turns it feels no force to the side."""
    speed, climb = 45.0 + wander(rng, t, 4.0, 15.0), wander(rng, t, 0.06, 10.0)
    bank = np.radians(25.0) * np.tanh(1.5 * wander(rng, t, 1.0, 8.0))
    yaw = integral(t, G * np.tan(bank) / speed)
    direction = np.stack([np.cos(climb) * np.cos(yaw), np.cos(climb) * np.sin(yaw), np.sin(climb)], axis=1)
    return Motion(integral(t, speed[:, None] * direction), angles(yaw, -climb - 0.05, -bank), 0.03 + 0.0 * t)


def train(rng: np.random.Generator, t: np.ndarray) -> Motion:
    """Up to 35 m/s; canted curves of a kilometre behind a long way straight ahead at one speed."""
    speed = ramps(t, [(15.0, 0.0), (75.0, 35.0), (180.0, 35.0), (220.0, 0.0)], 3.0)
    rate = speed / 1200.0 * smoothed(t, np.sign(wander(rng, t, 1.0, 8.0)) * (t > 100.0), 3.0)
    yaw = integral(t, rate)
    return Motion(ahead(t, yaw, speed), angles(yaw, 0.0 * t, -0.5 * speed * rate / G), 0.002 + 0.0002 * speed)


def express(rng: np.random.Generator, t: np.ndarray) -> Motion:
    """A train at 85 m/s when the recording begins."""
    speed = ramps(t, [(0.0, 85.0), (100.0, 85.0), (160.0, 60.0), (240.0, 88.0)], 5.0)
    rate = speed / 6000.0 * np.tanh(2.0 * wander(rng, t, 1.0, 10.0))
    yaw = integral(t, rate)
    return Motion(ahead(t, yaw, speed), angles(yaw, 0.0 * t, -0.7 * speed * rate / G), 0.02 + 0.0 * t)


def boat(rng: np.random.Generator, t: np.ndarray) -> Motion:
    """Moored, then under way, in waves all the time and in a current to which it does not look."""
    under_way = ramps(t, [(20.0, 0.0), (30.0, 1.0)], 3.0)
    yaw = 0.08 * np.sin(2.0 * np.pi * t / 7.1) + under_way * wander(rng, t, 1.2, 15.0)
    p = ahead(t, yaw, 3.0 * under_way) + integral(t, under_way[:, None] * [0.4, 0.0, 0.0])
    p += np.stack([size * np.sin(2.0 * np.pi * t / s) for size, s in ((0.15, 6.3), (0.2, 5.2), (0.4, 6.0))], axis=1)
    roll = 0.1 * np.sin(2.0 * np.pi * t / 4.7) + wander(rng, t, 0.035, 2.0)
    return Motion(p, angles(yaw, 0.05 * np.sin(2.0 * np.pi * t / 5.9), roll), 0.005 + 0.0 * t)


def tractor(rng: np.random.Generator, t: np.ndarray) -> Motion:
    """Rows over a rough field, 2.5 m/s, with half a turn at their ends."""
    speed = ramps(t, [(10.0, 0.0), (14.0, 2.5)])
    ends = [((s, k * np.pi), (s + 8.0, (k + 1) * np.pi)) for k, s in enumerate(np.arange(35.0, t[-1], 30.0))]
    yaw, moving = ramps(t, list(chain.from_iterable(ends))), speed / 2.5
    roll, pitch = (moving * wander(rng, t, 0.045, 0.6) for _ in range(2))
    return Motion(ahead(t, yaw, speed), angles(yaw, pitch, roll), 0.01 + 0.03 * moving)


def backpack(rng: np.random.Generator, t: np.ndarray) -> Motion:
    """Somebody walks: two steps a second, which bounce and turn."""
    speed = stop_and_go(rng, t, 1.5, 25.0)
    moving, steps = speed / 1.5, 4.0 * np.pi * t
    yaw = wander(rng, t, 2.0, 8.0) + 0.08 * moving * np.sin(0.5 * steps) + wander(rng, t, 0.05, 0.5)
    p = ahead(t, yaw, speed) + 0.03 * (moving * np.sin(steps))[:, None] * [0.0, 0.0, 1.0]
    roll, pitch = (0.06 * moving * np.sin(k * steps + k) + wander(rng, t, 0.03, 0.7) for k in (0.5, 1.0))
    return Motion(p, angles(yaw, 0.1 + pitch, roll), 0.003 + 0.01 * moving)


def fork_lift(rng: np.random.Generator, t: np.ndarray) -> Motion:
    """Forth and back, and turns on the spot."""
    sense = np.where(wander(rng, t, 1.0, 15.0) > 0.0, 1.0, -1.0)
    speed = smoothed(t, stop_and_go(rng, t, 2.0, 8.0) * sense, 0.4)
    yaw = integral(t, ramps(t, [(10.0, 0.0), (12.0, 1.0)]) * wander(rng, t, 0.4, 2.5))
    return Motion(ahead(t, yaw, speed), angles(yaw, 0.0 * t, 0.0 * t), 0.01 + 0.0 * t)


def motorcycle(rng: np.random.Generator, t: np.ndarray) -> Motion:
    """It leans into curves, up to 18 m/s, and stops now and then."""
    speed = stop_and_go(rng, t, 18.0, 30.0)
    rate = 0.5 * np.tanh(wander(rng, t, 0.5, 3.0)) * np.minimum(1.0, speed / 5.0)
    yaw = integral(t, rate)
    return Motion(ahead(t, yaw, speed), angles(yaw, 0.0 * t, -np.arctan(speed * rate / G)), 0.005 + 0.002 * speed)


def crane_hook(rng: np.random.Generator, t: np.ndarray) -> Motion:
    """It hangs, swings and is moved about, and turns as it likes."""
    swing = [wander(rng, t, size, 20.0) * np.sin(2.0 * np.pi * t / 6.0 + k) for k, size in enumerate((0.7, 0.5))]
    moved = [wander(rng, t, size, 20.0) for size in (8.0, 8.0, 3.0)]
    p = np.stack([moved[0] + swing[0], moved[1] + swing[1], moved[2]], axis=1)
    return Motion(p, hanging(t, p, wander(rng, t, 1.0, 15.0)), 0.003 + 0.0 * t)


def slewing(rng: np.random.Generator, t: np.ndarray) -> Motion:
    """An excavator that digs: it turns to and fro and stays where it is, an arm's length from the IMU."""
    yaw = integral(t, ramps(t, [(8.0, 0.0), (10.0, 1.0)]) * wander(rng, t, 0.6, 2.0))
    p = np.stack([np.cos(yaw), np.sin(yaw), 0.0 * t], axis=1)
    return Motion(p, angles(yaw, 0.0 * t, 0.0 * t), 0.02 + 0.0 * t)


VEHICLES: dict[str, Vehicle] = {
    one.__name__.replace("_", " "): one
    for one in (
        multicopter,
        multicopter_in_flight,
        aeroplane,
        train,
        express,
        boat,
        tractor,
        backpack,
        fork_lift,
        motorcycle,
        crane_hook,
        slewing,
    )
}
