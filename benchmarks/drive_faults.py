"""Prints what faults of sensors cost on the cars of `drives/`: `python benchmarks/drive_faults.py`.

Every second fix is held out and judges, as in `drives.py`; these stay as they are, but for their clock. The
configuration is what `config init` writes of the drive without the fault. IMUs fail from the middle of the drive on,
velocities and clocks in all of it, and the fixes that are used for 40 s of every 80.
"""

import argparse
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from drives import held_out_row, messages_of, names_of, recorded_in, run_system, starter_config
from mishaps import changed

from holdfast.config.frames import Datum
from holdfast.config.model import Config
from holdfast.estimator.estimator import Estimator
from holdfast.geometry.earth import LocalFrame, is_on_earth
from holdfast.geometry.rotations import exponentials
from holdfast.messages import GnssFix, GnssVelocity, ImuSample, Message
from holdfast.replay.held_out import HoldOut, HoldOutFilter
from holdfast.sensors.gnss import point_of

AXIS = np.array([0.6, -0.5, 0.62])  # of what happens to the IMU: no axis of any car
KNOCKED = exponentials(np.radians(60.0) * AXIS[None] / np.linalg.norm(AXIS))[0].T
LATE_S = 1.0
WITHIN_BURST_NS = 200_000
WANDER_S = 10.0  # after which the error of a fix in a narrow street is another one

Fault = Callable[[list[Message]], list[Message]]


def of_imu(change: Callable[[ImuSample], ImuSample]) -> Fault:
    """Return a fault that changes the samples of the IMU from the middle of a drive on."""

    def fault(messages: list[Message]) -> list[Message]:
        middle_ns = (messages[0].stamp_ns + messages[-1].stamp_ns) // 2
        return [change(one) if isinstance(one, ImuSample) and one.stamp_ns > middle_ns else one for one in messages]

    return fault


def of_velocity(change: Callable[[Any], Any]) -> Fault:
    """Return a fault that changes every Doppler velocity (3,), east, north and up."""
    return lambda messages: [
        replace(one, velocity=change(one.velocity)) if isinstance(one, GnssVelocity) else one for one in messages
    ]


def late(messages: list[Message]) -> list[Message]:
    """Doppler velocities that are those of a second ago."""
    velocities = [one for one in messages if isinstance(one, GnssVelocity)]
    stamps, values = np.array([one.stamp_ns for one in velocities]), np.array([one.velocity for one in velocities])
    if not velocities:
        return messages

    def before(stamp_ns: int) -> np.ndarray:
        at = stamp_ns - LATE_S * 1e9 - stamps[0]
        return np.array([np.interp(at, stamps - stamps[0], column) for column in values.T])

    return [replace(one, velocity=before(one.stamp_ns)) if isinstance(one, GnssVelocity) else one for one in messages]


def doppler_early(by_s: float) -> Fault:
    """Doppler velocities that are stamped before they were measured, beside fixes that are not."""
    by_ns = round(by_s * 1e9)
    return lambda messages: changed(GnssVelocity, messages, lambda one: replace(one, stamp_ns=one.stamp_ns - by_ns))


def follows_speed(messages: list[Message]) -> list[Message]:
    """An accelerometer whose bias follows the speed, as where vibration is rectified: 0.5 m/s^2 at 10 m/s."""
    velocities = [one for one in messages if isinstance(one, GnssVelocity)]
    if not velocities:
        return messages
    zero_ns = velocities[0].stamp_ns
    at, speeds = [one.stamp_ns - zero_ns for one in velocities], [np.linalg.norm(one.velocity) for one in velocities]

    def change(one: ImuSample) -> ImuSample:
        speed = min(15.0, float(np.interp(one.stamp_ns - zero_ns, at, speeds)))
        return replace(one, specific_force=one.specific_force + 0.05 * speed * AXIS)

    return of_imu(change)(messages)


def wanders(amplitude_m: float) -> Fault:
    """Fixes that wander as in narrow streets, for 40 s of every 80, and claim a metre."""

    def fault(messages: list[Message]) -> list[Message]:
        rng, start_ns = np.random.default_rng(7), messages[0].stamp_ns
        error, last_ns, found = rng.normal(0.0, amplitude_m, 3), start_ns, list(messages)
        for k, one in enumerate(messages):
            if not isinstance(one, GnssFix):
                continue
            keep = np.exp(-max(0.0, (one.stamp_ns - last_ns) * 1e-9) / WANDER_S)
            error = keep * error + np.sqrt(1.0 - keep**2) * rng.normal(0.0, amplitude_m, 3)
            last_ns = max(last_ns, one.stamp_ns)
            if (one.stamp_ns - start_ns) * 1e-9 % 80.0 > 40.0:
                found[k] = moved(one, error)
        return found

    return fault


def scattered(sigma_m: float) -> Fault:
    """Fixes that scatter from one to the next, whatever they claim."""

    def fault(messages: list[Message]) -> list[Message]:
        rng = np.random.default_rng(7)

        def change(one: GnssFix) -> GnssFix:
            return replace(moved(one, rng.normal(0.0, sigma_m, 3)), covariance=one.covariance)

        return changed(GnssFix, messages, change)

    return fault


def rounded(step_deg: float) -> Fault:
    """Fixes of a receiver, or a driver, that tells fewer digits than it claims."""

    def change(one: GnssFix) -> GnssFix:
        latitude, longitude = (round(at / step_deg) * step_deg for at in (one.latitude_deg, one.longitude_deg))
        return replace(one, latitude_deg=latitude, longitude_deg=longitude)

    return lambda messages: changed(GnssFix, messages, change)


def jitters(most_s: float) -> Fault:
    """Stamps of a receiver that are given when its messages arrive, earlier or later by up to so much."""

    def fault(messages: list[Message]) -> list[Message]:
        rng, epochs = np.random.default_rng(7), dict[int, int]()

        def change(one: GnssFix | GnssVelocity) -> GnssFix | GnssVelocity:
            by_ns = epochs.setdefault(one.stamp_ns, round(rng.uniform(-most_s, most_s) * 1e9))
            return replace(one, stamp_ns=one.stamp_ns + by_ns)

        return changed(GnssFix | GnssVelocity, messages, change)

    return fault


def first_are_off(count: int, by_m: float) -> Fault:
    """The first fixes that are used are far to the east of where the machine is."""

    def fault(messages: list[Message]) -> list[Message]:
        fixes = [id(one) for one in messages if isinstance(one, GnssFix)][: 2 * count]  # every second one is held out
        return changed(
            GnssFix, messages, lambda one: moved(one, np.array([by_m, 0.0, 0.0])) if id(one) in fixes else one
        )

    return fault


def zeros_first(lasting_s: float) -> Fault:
    """A receiver that says 0 deg north, 0 deg east before it knows where it is, with the status of a fix."""

    def fault(messages: list[Message]) -> list[Message]:
        until_ns = messages[0].stamp_ns + lasting_s * 1e9
        zeros = {"latitude_deg": 0.0, "longitude_deg": 0.0, "altitude_m": 0.0}
        return changed(GnssFix, messages, lambda one: replace(one, **zeros) if one.stamp_ns < until_ns else one)

    return fault


def bursts(every_s: float) -> Fault:
    """Samples of the IMU that are stamped as they arrive, many at once."""

    def fault(messages: list[Message]) -> list[Message]:
        every_ns, zero_ns, count = round(every_s * 1e9), messages[0].stamp_ns, Counter[int]()

        def change(one: ImuSample) -> ImuSample:
            burst = (one.stamp_ns - zero_ns) // every_ns + 1
            count[burst] += 1
            return replace(one, stamp_ns=zero_ns + burst * every_ns + (count[burst] - 1) * WITHIN_BURST_NS)

        return changed(ImuSample, messages, change)

    return fault


def moved(fix: GnssFix, by: np.ndarray) -> GnssFix:
    """Return a fix that is elsewhere by (3,), east, north and up [m], and claims a metre."""
    there = LocalFrame(point_of(fix)).to_geodetic(by)
    names = "latitude_deg", "longitude_deg", "altitude_m"
    return replace(fix, covariance=np.eye(3), **{name: getattr(there, name) for name in names})


def by_another_clock(ahead_s: float) -> Fault:
    """All of the receiver is stamped by a clock that is off by so much, and arrives when it did."""
    by_ns = round(ahead_s * 1e9)
    return lambda messages: changed(
        GnssFix | GnssVelocity, messages, lambda one: replace(one, stamp_ns=one.stamp_ns + by_ns)
    )


def arrive_late(by_s: float) -> Fault:
    """All of the receiver arrives so late, with the right stamps, as over a slow link."""

    def fault(messages: list[Message]) -> list[Message]:
        by_ns = round(by_s * 1e9)
        later = changed(GnssFix | GnssVelocity, messages, lambda one: replace(one, arrival_ns=one.arrival_ns + by_ns))
        return sorted(later, key=lambda one: one.arrival_ns)

    return fault


def pauses(lasting_s: float) -> Fault:
    """Nothing is recorded for some seconds of each minute, first after half of one."""

    def missing(messages: list[Message]) -> list[Message]:
        first_ns = messages[0].arrival_ns
        return [one for one in messages if ((one.arrival_ns - first_ns) * 1e-9 + 30.0) % 60.0 < 60.0 - lasting_s]

    return missing


def drifts(messages: list[Message]) -> list[Message]:
    """A gyroscope whose bias drifts by 1 deg/s in five minutes, as one that warms up."""
    middle_ns = (messages[0].stamp_ns + messages[-1].stamp_ns) // 2

    def change(one: ImuSample) -> ImuSample:
        since = (one.stamp_ns - middle_ns) * 1e-9 / 300.0
        return replace(one, angular_velocity=one.angular_velocity + np.radians(1.0) * since * AXIS)

    return of_imu(change)(messages)


def folded(amplitude_m_s2: float, hz: float) -> Fault:
    """An engine that shakes the IMU nearly as often as that measures: its samples swing slowly.

    The machine does not move with them.
    """
    across = np.cross(AXIS, [0.0, 0.0, 1.0])

    def change(one: ImuSample) -> ImuSample:
        phase = 2.0 * np.pi * hz * (one.stamp_ns % 10**12) * 1e-9
        swings = amplitude_m_s2 * (np.sin(phase) * AXIS + np.cos(phase) * across)
        return replace(one, specific_force=one.specific_force + swings)

    return of_imu(change)


def turned(sample: ImuSample) -> ImuSample:
    """Return a sample of an IMU that has been knocked."""
    rate, force = KNOCKED @ sample.angular_velocity, KNOCKED @ sample.specific_force
    return replace(sample, angular_velocity=rate, specific_force=force)


FAULTS: dict[str, Fault] = {
    "none": lambda messages: messages,
    "gyroscope's bias jumps by 1 deg/s": of_imu(
        lambda one: replace(one, angular_velocity=one.angular_velocity + np.radians(1.0) * AXIS)
    ),
    "gyroscope's bias jumps by 3 deg/s": of_imu(
        lambda one: replace(one, angular_velocity=one.angular_velocity + np.radians(3.0) * AXIS)
    ),
    "gyroscope's bias drifts by 1 deg/s in 5 min": drifts,
    "gyroscope reads zero": of_imu(lambda one: replace(one, angular_velocity=np.zeros(3))),
    "accelerometer's bias jumps by 0.5 m/s^2": of_imu(
        lambda one: replace(one, specific_force=one.specific_force + 0.5 * AXIS)
    ),
    "accelerometer's bias follows the speed": follows_speed,
    "engine folded to 0.5 Hz, 0.3 m/s^2": folded(0.3, 0.5),
    "engine folded to 0.5 Hz, 1 m/s^2": folded(1.0, 0.5),
    "engine folded to 0.5 Hz, 3 m/s^2": folded(3.0, 0.5),
    "IMU knocked by 60 deg between two samples": of_imu(turned),
    "Doppler of the other sign": of_velocity(lambda velocity: -velocity),
    "Doppler north, east, down": of_velocity(lambda velocity: velocity[[1, 0, 2]] * [1.0, 1.0, -1.0]),
    "Doppler always zero": of_velocity(lambda velocity: 0.0 * velocity),
    "Doppler late by 1 s": late,
    "Doppler stamped 0.1 s early": doppler_early(0.1),
    "Doppler stamped 0.2 s early": doppler_early(0.2),
    "fixes scatter by 0.1 m, whatever they claim": scattered(0.1),
    "fixes scatter by 0.3 m, whatever they claim": scattered(0.3),
    "fixes rounded to 1e-5 deg": rounded(1e-5),
    "stamps of GNSS jitter by 10 ms": jitters(0.01),
    "stamps of GNSS jitter by 50 ms": jitters(0.05),
    "the first three fixes are 100 km off": first_are_off(3, 100e3),
    "zeros for 20 s before the first fix": zeros_first(20.0),
    "fixes wander by 10 m and claim 1 m": wanders(10.0),
    "fixes wander by 20 m and claim 1 m": wanders(20.0),
}


DATUMS_M = {"datum 100 km to the west": 100e3, "datum 200 km to the west": 200e3}
"""Not faults of the messages: how far from the machine W begins."""

OF_ALL: dict[str, Fault] = {
    "nothing is recorded for 3 s in each minute": pauses(3.0),
    "nothing is recorded for 10 s in each minute": pauses(10.0),
    "nothing is recorded for 30 s in each minute": pauses(30.0),
    "samples of the IMU in bursts of 0.1 s": bursts(0.1),
    "GNSS arrives 4 s late": arrive_late(4.0),
    "GNSS arrives 10 s late": arrive_late(10.0),
    "stamps of GNSS 0.25 s early": by_another_clock(-0.25),
    "stamps of GNSS 0.25 s early, gyroscope's bias jumps by 3 deg/s": lambda messages: FAULTS[
        "gyroscope's bias jumps by 3 deg/s"
    ](by_another_clock(-0.25)(messages)),
    "clock of GNSS 1 s behind": by_another_clock(-1.0),
    "clock of GNSS 3 s behind": by_another_clock(-3.0),
    "clock of GNSS 8 s behind": by_another_clock(-8.0),
    "clock of GNSS 1 s ahead": by_another_clock(1.0),
    "clock of GNSS 18 s ahead": by_another_clock(18.0),
    "clock of GNSS 50 years ahead": by_another_clock(50.0 * 365.25 * 86400.0),
}
"""Those that change what judges, too: a fix that is held out may be missing, or has the clock that was found."""


def judge(drive: Path, name: str) -> dict[str, Any]:
    """Run one drive with one fault, in a process of its own."""
    config = starter_config(drive / "bag")
    rules = [HoldOut(sensor, 2) for sensor in names_of(config, "gnss")]
    messages = messages_of(drive, config)
    if name in DATUMS_M:
        config = with_datum(config, messages, DATUMS_M[name])
    if name in OF_ALL:
        changed = OF_ALL[name](messages)
    else:
        changed = where_used(config, rules, messages, FAULTS.get(name, FAULTS["none"])(messages))
    return held_out_row(config, run_system(Estimator(config), changed, rules), changed, drive / "reference.csv")


def with_datum(config: Config, messages: list[Message], west_m: float) -> Config:
    """Return a configuration whose world begins far to the west of the first fix."""
    fix = next(one for one in messages if isinstance(one, GnssFix) and is_on_earth(point_of(one)))
    west = LocalFrame(point_of(fix)).to_geodetic(np.array([-west_m, 0.0, 0.0]))._replace(altitude_m=fix.altitude_m)
    return config.model_copy(update={"frames": config.frames.model_copy(update={"datum": Datum(**west._asdict())})})


def those_not_used(config: Config, rules: list[HoldOut], messages: list[Message]) -> set[int]:
    """Return the identities of the fixes that are held out or of no use: no fault is to change which these are."""
    held_out = HoldOutFilter(rules, config)
    of_no_use = {id(one) for one in held_out.split(messages) if not held_out.is_usable(one)}
    return of_no_use | {id(one) for one, _ in held_out.held}


def where_used(config: Config, rules: list[HoldOut], before: list[Message], after: list[Message]) -> list[Message]:
    """Return changed messages, but those of before of what is not used: no fault is to change what judges."""
    stay = those_not_used(config, rules, before)
    return [old if id(old) in stay else new for old, new in zip(before, after, strict=True)]


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="faults whose name holds this")
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data" / "drives")
    given = parser.parse_args()
    drives = recorded_in(given.data)
    if not drives:
        print(f"all drives: skipped, no recording at {given.data}")
        return
    print("Horizontal errors at held-out fixes [m]: the RMS of each drive, and the largest of all\n")
    print(f"| Fault | {' | '.join(drive.name for drive in drives)} | median | largest |")
    print("|---|" + "---:|" * (len(drives) + 2))
    names = [name for name in [*FAULTS, *OF_ALL, *DATUMS_M] if given.only in name]
    with ProcessPoolExecutor(2) as pool:
        jobs = {name: [pool.submit(judge, drive, name) for drive in drives] for name in names}
        for name, futures in jobs.items():
            rows = [future.result() for future in futures]
            errors = [row.get("rms", np.nan) for row in rows]
            cells = " | ".join("never started" if np.isnan(one) else f"{one:.2f}" for one in errors)
            largest = max(row.get("max", np.nan) for row in rows)
            print(f"| {name} | {cells} | {np.nanmedian(errors):.2f} | {largest:.1f} |", flush=True)


if __name__ == "__main__":
    main()
