"""What may happen to an odometry, for the mishaps of KITTI and of machines: jumps, lies, noise, scale, mount, clock."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from mishaps import Messages, Mishap, changed, clock_of, direction, rare, repeating, silent, since_s, spans, told
from scipy.spatial.transform import Rotation

from holdfast.messages import SensorPose


def posed(one: SensorPose, rotation: Rotation, translation: np.ndarray | float = 0.0) -> SensorPose:
    """Return a pose in another frame."""
    quaternion = (rotation * Rotation.from_quat(one.quaternion)).as_quat()
    return replace(one, position=rotation.apply(one.position) + translation, quaternion=quaternion)


def seen_from(one: SensorPose, rotation: Rotation) -> SensorPose:
    """Return a pose of a sensor that is turned by a rotation."""
    return replace(one, quaternion=(Rotation.from_quat(one.quaternion) * rotation).as_quat())


def of_odometry(change: Callable[[SensorPose], SensorPose], messages: Messages) -> Messages:
    """Return the messages with other poses."""
    return changed(SensorPose, messages, change)


def jumps(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The frame jumps up to three times, as by a loop that is closed."""
    at = np.sort(rng.uniform(0.1, 0.9, int(rng.integers(1, 4))) * since_s(messages, messages[-1]))
    rotations = [Rotation.from_rotvec(rng.uniform(0.0, 0.5) * direction(rng)) for _ in at]
    translations = [rng.uniform(0.3, 20.0) * direction(rng) for _ in at]

    def jumped(one: SensorPose) -> SensorPose:
        for at_s, rotation, translation in zip(at, rotations, translations, strict=True):
            one = posed(one, rotation, translation) if since_s(messages, one) > at_s else one
        return one

    return of_odometry(jumped, messages), f"frame jumps {' '.join(f'{at_s:.0f}' for at_s in at)}"


def restart(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The odometry starts again, where it is."""
    at_s = rng.uniform(0.1, 0.9) * since_s(messages, messages[-1])
    first = next(one for one in messages if isinstance(one, SensorPose) and since_s(messages, one) > at_s)
    back = Rotation.from_quat(first.quaternion).inv()

    def again(one: SensorPose) -> SensorPose:
        return posed(one, back, -back.apply(first.position)) if since_s(messages, one) > at_s else one

    return of_odometry(again, messages), f"restart {at_s:.0f}"


def runaway(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The odometry runs away up to two times, by 1 to 10 m/s, and turns by up to 11 deg/s."""
    when = spans(rng, messages, 2, [3.0, 10.0, 20.0])
    speeds = [rng.uniform(1.0, 10.0) * direction(rng) * [1.0, 1.0, 0.1] for _ in when]
    rates = [rng.uniform(0.0, 0.2) * direction(rng) for _ in when]

    def away(one: SensorPose) -> SensorPose:
        for (a, b), speed, rate in zip(when, speeds, rates, strict=True):
            lasted_s = np.clip(since_s(messages, one) - a, 0.0, b - a)
            one = posed(one, Rotation.from_rotvec(rate * lasted_s), speed * lasted_s)
        return one

    return of_odometry(away, messages), f"runs away {told(when)}"


def noise(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Poses are noisy, three or ten times the default."""
    times = float(rng.choice([3.0, 10.0]))

    def noisy(one: SensorPose) -> SensorPose:
        shaken = seen_from(one, Rotation.from_rotvec(times * 0.002 * rng.standard_normal(3)))
        return replace(shaken, position=one.position + times * 0.02 * rng.standard_normal(3))

    return of_odometry(noisy, messages), f"noise {times:g} times"


def scale(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Distances are wrong by up to 5 %."""
    by = 1.0 + rng.uniform(-0.05, 0.05)
    return of_odometry(lambda one: replace(one, position=one.position * by), messages), f"scale {by:.3f}"


def mount(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The sensor is mounted otherwise than its owner wrote, by 1 to 15 degrees or by any angle."""
    by_deg = float(rng.choice([rng.uniform(1.0, 15.0), rng.uniform(15.0, 180.0)]))
    rotation = Rotation.from_rotvec(np.radians(by_deg) * direction(rng))
    back = rotation.inv()
    return of_odometry(lambda one: seen_from(posed(one, back), rotation), messages), f"mount {by_deg:.0f} deg"


def late(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Poses arrive late."""
    by_s = float(rng.choice([0.3, 1.0, 2.2]))
    shifted = of_odometry(lambda one: replace(one, arrival_ns=one.arrival_ns + int(by_s * 1e9)), messages)
    return sorted(shifted, key=lambda one: one.arrival_ns), f"poses {by_s:g} s late"


def outliers(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """One pose in twenty is elsewhere."""

    def elsewhere(one: SensorPose) -> SensorPose:
        away = rng.uniform(1.0, 30.0) * direction(rng)
        return replace(one, position=one.position + away) if rng.random() < 0.05 else one

    return of_odometry(elsewhere, messages), "5% of poses elsewhere"


def boast(_: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Poses claim a tenth of a millimetre."""
    return of_odometry(lambda one: replace(one, covariance=np.eye(6) * 1e-8), messages), "poses boast"


ODOMETRY: tuple[Mishap, ...] = (
    jumps,
    restart,
    silent(SensorPose),
    repeating(SensorPose, ("position", "quaternion"), [3.0, 10.0, 30.0], "frozen"),  # as in a tunnel
    runaway,
    noise,
    scale,
    mount,
    clock_of(SensorPose, "its clock"),
    rare(SensorPose, "a pose"),
    late,
    outliers,
    boast,
)
