"""What may happen to twists, headings, encoders, heights, prisms and a second IMU, for `machine_mishaps.py`."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from mishaps import Messages, Mishap, changed, clock_of, direction, rare, repeating, silent, since_s, spans, told
from scipy.spatial.transform import Rotation

from holdfast.messages import Heading, Height, ImuSample, JointAngle, PointPosition, Twist


def turned(kind: type[ImuSample | Twist], messages: Messages, rotation: Rotation) -> Messages:
    """Return the messages of a sensor that is turned."""
    vectors = ("specific_force", "angular_velocity") if kind is ImuSample else ("linear", "angular")

    def seen(one: Any) -> Any:
        return replace(one, **{name: rotation.apply(getattr(one, name)) for name in vectors})

    return changed(kind, messages, seen)


def meanwhile(
    rng: np.random.Generator, kind: Any, messages: Messages, change: Callable[[Any], Any]
) -> tuple[Messages, str]:
    """Return the messages with one kind changed in up to three spans."""
    when = spans(rng, messages, 3, [3.0, 10.0, 30.0])

    def other(one: Any) -> Any:
        return change(one) if any(a < since_s(messages, one) < b for a, b in when) else one

    return changed(kind, messages, other), told(when)


def slips(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Wheels slip at times: they turn faster, or not at all."""
    ratio = float(rng.choice([0.0, 0.5, 1.5, 3.0]))
    after, when = meanwhile(
        rng, Twist, messages, lambda one: replace(one, linear=ratio * one.linear, angular=ratio * one.angular)
    )
    return after, f"slip x {ratio:g} {when}"


def drifts_sideways(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The machine is said to move when it does not, at times."""
    by = rng.uniform(0.1, 2.0) * direction(rng) * [1.0, 1.0, 0.0]
    after, when = meanwhile(rng, Twist, messages, lambda one: replace(one, linear=one.linear + by))
    return after, f"velocity + {np.linalg.norm(by):.1f} m/s {when}"


def twist_scale(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Velocities are wrong by a factor: another wheel, or km/h."""
    by = float(rng.choice([0.5, 0.8, 1.1, 3.6, -1.0]))
    return changed(
        Twist, messages, lambda one: replace(one, linear=by * one.linear, angular=by * one.angular)
    ), f"velocity x {by:g}"


def twist_mount(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Velocities are in other axes."""
    by_deg = float(rng.choice([5.0, 90.0, 180.0]))
    return turned(
        Twist, messages, Rotation.from_rotvec([0.0, 0.0, np.radians(by_deg)])
    ), f"velocity turned {by_deg:g} deg"


def heading_offset(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Headings are off by an angle."""
    by_deg = float(rng.choice([2.0, 10.0, 90.0, 180.0])) * rng.choice([-1.0, 1.0])
    by = np.radians(by_deg)
    return changed(Heading, messages, lambda one: replace(one, yaw_rad=one.yaw_rad + by)), f"heading {by_deg:+g} deg"


def heading_sign(_: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Headings are clockwise from north."""
    return changed(Heading, messages, lambda one: replace(one, yaw_rad=np.pi / 2 - one.yaw_rad)), "heading from north"


def heading_at_times(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Headings are elsewhere at times."""
    by = float(rng.uniform(-np.pi, np.pi))
    after, when = meanwhile(rng, Heading, messages, lambda one: replace(one, yaw_rad=one.yaw_rad + by))
    return after, f"heading {np.degrees(by):+.0f} deg {when}"


def encoder_offset(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The zero of the encoder is elsewhere, or it turns the other way, or counts degrees."""
    by, sign = [(0.5, 1.0), (2.0, 1.0), (0.0, -1.0), (0.0, 57.3)][int(rng.integers(4))]
    return changed(
        JointAngle, messages, lambda one: replace(one, angle_rad=sign * one.angle_rad + by)
    ), f"encoder x {sign:g} + {by:g}"


def encoder_stuck(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The encoder stands still at times."""
    after, when = meanwhile(rng, JointAngle, messages, lambda one: replace(one, angle_rad=1.0))
    return after, f"encoder stuck {when}"


def height_offset(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Heights are of another datum."""
    by = float(rng.choice([0.1, 1.0, 47.0])) * rng.choice([-1.0, 1.0])
    return changed(Height, messages, lambda one: replace(one, height_m=one.height_m + by)), f"height {by:+g} m"


def height_at_times(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """Heights are elsewhere at times."""
    by = float(rng.uniform(-5.0, 5.0))
    after, when = meanwhile(rng, Height, messages, lambda one: replace(one, height_m=one.height_m + by))
    return after, f"height {by:+.1f} m {when}"


def prism_offset(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The total station is set up elsewhere."""
    by = float(rng.choice([0.05, 1.0, 100.0])) * direction(rng)
    return changed(PointPosition, messages, lambda one: replace(one, position=one.position + by)), (
        f"prism {np.linalg.norm(by):.2g} m"
    )


def prism_at_times(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """The total station follows something else at times."""
    by = rng.uniform(0.3, 20.0) * direction(rng)
    after, when = meanwhile(rng, PointPosition, messages, lambda one: replace(one, position=one.position + by))
    return after, f"prism {np.linalg.norm(by):.1f} m {when}"


def imu_mount(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
    """An IMU is mounted otherwise than its owner wrote."""
    by_deg = float(rng.choice([3.0, 10.0, 90.0]))
    return turned(
        ImuSample, messages, Rotation.from_rotvec(np.radians(by_deg) * direction(rng))
    ), f"IMU turned {by_deg:g} deg"


def boast(kind: Any, key: str) -> Mishap:
    """What a sensor claims is a thirtieth, a third, or thirty times as much."""

    def boasts(rng: np.random.Generator, messages: Messages) -> tuple[Messages, str]:
        factor, power = float(rng.choice([0.03, 0.3, 30.0])), 2 if key == "covariance" else 1

        def other(one: Any) -> Any:
            claim = getattr(one, key)
            return one if claim is None else replace(one, **{key: claim * factor**power})

        return changed(kind, messages, other), f"claims x {factor:g}"

    return boasts


OF_KIND: dict[type, tuple[Mishap, ...]] = {
    Twist: (
        slips,
        drifts_sideways,
        twist_scale,
        twist_mount,
        silent(Twist),
        clock_of(Twist),
        rare(Twist),
        boast(Twist, "covariance"),
    ),
    Heading: (
        heading_offset,
        heading_sign,
        heading_at_times,
        silent(Heading),
        clock_of(Heading),
        rare(Heading),
        boast(Heading, "sigma_rad"),
    ),
    JointAngle: (encoder_offset, encoder_stuck, silent(JointAngle), clock_of(JointAngle), rare(JointAngle)),
    Height: (height_offset, height_at_times, silent(Height), clock_of(Height), rare(Height), boast(Height, "sigma_m")),
    PointPosition: (
        prism_offset,
        prism_at_times,
        silent(PointPosition),
        clock_of(PointPosition),
        rare(PointPosition),
        boast(PointPosition, "covariance"),
    ),
    ImuSample: (
        imu_mount,
        repeating(ImuSample, ("specific_force", "angular_velocity"), [1.0, 3.0, 10.0], "IMU repeats itself"),
        silent(ImuSample),
        clock_of(ImuSample),
        rare(ImuSample),
    ),
}
