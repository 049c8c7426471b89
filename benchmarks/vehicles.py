"""Prints what the defaults are worth on what is neither an excavator nor a car: `python benchmarks/vehicles.py`.

One IMU as in a telephone, in any attitude, and one antenna move as `motions.py` says; the configuration says where the
antenna is, and how many metres a fix may claim, as that of `config init`. GNSS is RTK without velocities, or alone with
them; with `--odometry` there is a pose that drifts, too, and with `--outages` no fix for ten seconds now and then. The
distances of the odometry are `--scale` times what they are, which with `--known` the file says that they are not.
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from drives import rms
from motions import VEHICLES, wander
from scipy.spatial.transform import Rotation

from holdfast.config.load import config_of
from holdfast.config.model import Config
from holdfast.estimator.estimator import Estimator
from holdfast.events import EventKind
from holdfast.geometry.earth import Geodetic, LocalFrame, earth_rate_enu, gravity
from holdfast.messages import FixStatus, GnssFix, GnssVelocity, ImuSample, Message, SensorPose

RATE_HZ, LENGTH_S, START_NS = 200, 240.0, 1_700_000_000_000_000_000
DATUM = Geodetic(47.4, 8.5, 450.0)
GYROSCOPE, ACCELEROMETER = 1.2e-4, 2e-3  # densities [rad/s/sqrt(Hz), m/s^2/sqrt(Hz)]
BIASES = 0.007, 0.1  # sigmas [rad/s, m/s^2]
DOPPLER_M_S = np.array([0.05, 0.05, 0.1])
POSES_HZ, LATE_NS, POSE_M, POSE_RAD = 10, 50_000_000, 5e-3, 5e-4  # of an odometry, with the sigmas of one pose
DRIFT_M, DRIFT_RAD = 0.02, 5e-4  # by which it walks per root of the metres that it moves
OUTAGE_S, EVERY_S, FIRST_S = 10.0, 45.0, 60.0
SETTLED_S = 30.0
WORST = {EventKind.BEGUN_ANEW, EventKind.RECEIVER_LOST, EventKind.SENSOR_LOST, EventKind.CALIBRATION}
HEADS = "started after [s]", "RMS [m]", "of the fixes [m]", "largest [m]", "heading [deg]", "tilt [deg]", "NEES / 3"


class Receiver(NamedTuple):
    """Sigmas [m] of the slow and the white error, and of the claim, of east and north; up has twice as much."""

    rate_hz: int
    slow_m: float
    white_m: float
    claim_m: float
    status: FixStatus
    has_velocity: bool


RECEIVERS = {
    "RTK": Receiver(5, 0.006, 0.006, 0.01, FixStatus.GBAS, has_velocity=False),
    "alone": Receiver(1, 1.0, 0.2, 1.5, FixStatus.FIX, has_velocity=True),
}


class Odometry(NamedTuple):
    """How many times the true distances an odometry says, and whether the file says that they are right."""

    scale: float = 1.0
    is_known: bool = False


SLOW_S = 60.0
EAST_NORTH_UP = np.array([1.0, 1.0, 2.0])


@dataclass(frozen=True)
class Recording:
    """Messages by stamp, their configuration, and poses of the IMU (n,) at its stamps (n,) with errors of fixes."""

    messages: list[Message]
    config: Config
    stamps_ns: np.ndarray
    p: np.ndarray
    attitude: Rotation
    off_m: np.ndarray


def stamp_of(t: float) -> int:
    """Return the stamp of a time [s]."""
    return START_NS + round(1e9 * t)


def record(name: str, receiver: Receiver, seed: int, odometry: Odometry | None) -> Recording:
    """Return what the sensors of a vehicle say."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, LENGTH_S, 0.5 / RATE_HZ)
    motion = VEHICLES[name](rng, t)
    R_B_I = Rotation.random(random_state=int(rng.integers(1 << 31)))
    arm_B = rng.uniform([-0.5, -0.5, 0.2], [0.5, 0.5, 1.5])
    attitude = motion.attitude * R_B_I
    messages = list(_imu(rng, t, motion.p, attitude, motion.shaken))
    antenna = motion.p + motion.attitude.apply(arm_B)
    fixes, off = _fixes(rng, t, antenna, receiver)
    messages += fixes
    sensors: dict[str, Any] = {
        "imu": {"kind": "imu", "topic": "/imu"},
        "gnss": {"kind": "gnss", "topic": "/fix", "max_sigma_m": 2.0 * receiver.claim_m},
    }
    places = [{"parent": "imu", "child": "gnss", "translation_m": R_B_I.inv().apply(arm_B).tolist()}]
    if receiver.has_velocity:
        sensors["doppler"] = {"kind": "gnss_velocity", "topic": "/velocity", "frame": "gnss"}
    if odometry is not None:
        known = {"scale_sigma": 0.0} if odometry.is_known else {}
        sensors["odometry"] = {"kind": "odometry", "topic": "/odometry", **known}
        R_I_S, p_I_S = Rotation.random(random_state=int(rng.integers(1 << 31))), rng.uniform(-0.3, 0.3, 3)
        rotation = R_I_S.as_matrix().tolist()
        places.append(
            {"parent": "imu", "child": "odometry", "translation_m": p_I_S.tolist(), "rotation_matrix": rotation}
        )
        poses = _poses(rng, t, motion.p + attitude.apply(p_I_S), attitude * R_I_S)
        messages += [replace(one, position=odometry.scale * one.position) for one in poses]
    messages.sort(key=lambda one: one.stamp_ns)
    config = config_of({"sensors": sensors, "extrinsics": places}, name)
    return Recording(messages, config, np.array([stamp_of(s) for s in t]), motion.p, attitude, off)


def _imu(
    rng: np.random.Generator, t: np.ndarray, p: np.ndarray, attitude: Rotation, shaken: np.ndarray
) -> Iterator[ImuSample]:
    """Yield samples in the middle of the intervals that they are the mean of."""
    before, mid, after = slice(0, -2, 2), slice(1, -1, 2), slice(2, None, 2)
    velocity, dt = np.gradient(p, t, axis=0), 1.0 / RATE_HZ
    rates = (attitude[before].inv() * attitude[after]).as_rotvec() / dt
    rates += attitude[mid].inv().apply(earth_rate_enu(DATUM.latitude_deg))
    up = np.array([0.0, 0.0, gravity(DATUM.latitude_deg, DATUM.altitude_m)])
    forces = attitude[mid].inv().apply((velocity[after] - velocity[before]) / dt + up)
    densities = np.full(len(forces), GYROSCOPE), np.hypot(ACCELEROMETER, shaken[mid])
    off = [
        bias * rng.standard_normal(3) + np.sqrt(RATE_HZ) * density[:, None] * rng.standard_normal(forces.shape)
        for density, bias in zip(densities, BIASES, strict=True)
    ]
    for s, rate, force in zip(t[mid], rates + off[0], forces + off[1], strict=True):
        yield ImuSample(stamp_of(s), stamp_of(s), "imu", rate, force)


def _fixes(
    rng: np.random.Generator, t: np.ndarray, antenna: np.ndarray, receiver: Receiver
) -> tuple[list[Message], np.ndarray]:
    """Return the messages of a receiver, and the horizontal errors (k,) of its fixes."""
    frame, messages = LocalFrame(DATUM), list[Message]()
    at = np.arange(7, len(t), 2 * RATE_HZ // receiver.rate_hz)
    slow = np.stack([wander(rng, t, receiver.slow_m, 0.5 * SLOW_S)[at] for _ in range(3)], axis=1)
    errors = EAST_NORTH_UP * (slow + receiver.white_m * rng.standard_normal(slow.shape))
    velocities = np.gradient(antenna, t, axis=0)
    claim = np.diag((receiver.claim_m * EAST_NORTH_UP) ** 2)
    for k, error in zip(at, errors, strict=True):
        stamp, point = stamp_of(t[k]), frame.to_geodetic(antenna[k] + error)
        messages.append(GnssFix(stamp, stamp, "gnss", *point, claim, receiver.status))
        if receiver.has_velocity:
            velocity = velocities[k] + DOPPLER_M_S * rng.standard_normal(3)
            messages.append(GnssVelocity(stamp, stamp, "doppler", velocity, np.diag(DOPPLER_M_S**2)))
    return messages, np.linalg.norm(errors[:, :2], axis=1)


def _poses(rng: np.random.Generator, t: np.ndarray, p: np.ndarray, attitude: Rotation) -> Iterator[SensorPose]:
    """Yield poses of an odometry in the frame where it started, which drifts as it moves."""
    at = np.arange(11, len(t), 2 * RATE_HZ // POSES_HZ)
    R, position = Rotation.identity(), np.zeros(3)
    for before, k in zip((at[0], *at), at, strict=False):
        step, moved = attitude[before].inv(), p[k] - p[before]
        root = np.sqrt(np.linalg.norm(moved))
        position = position + R.apply(step.apply(moved) + root * DRIFT_M * rng.standard_normal(3))
        R = R * step * attitude[k] * Rotation.from_rotvec(root * DRIFT_RAD * rng.standard_normal(3))
        seen = position + POSE_M * rng.standard_normal(3)
        turned = R * Rotation.from_rotvec(POSE_RAD * rng.standard_normal(3))
        yield SensorPose(stamp_of(t[k]), stamp_of(t[k]) + LATE_NS, "odometry", seen, turned.as_quat(), None)


def is_out(message: Message) -> bool:
    """Whether a message is one of GNSS in an outage."""
    since_s = (message.stamp_ns - START_NS) * 1e-9 - FIRST_S
    return isinstance(message, GnssFix | GnssVelocity) and since_s > 0.0 and since_s % EVERY_S < OUTAGE_S


def run(name: str, kind: str, seed: int, odometry: Odometry | None, has_outages: bool) -> str:
    """Return a row of the table."""
    recording = record(name, RECEIVERS[kind], seed, odometry)
    messages = [one for one in recording.messages if not (has_outages and is_out(one))]
    tried = judge(recording, messages)
    if isinstance(tried, str):
        return f"| {name} | {kind} | {seed} | {tried} |"
    cells = [name, kind, str(seed), *tried.cells()]
    if has_outages:
        times_s, off = tried.times_s, tried.off_m
        ends_s = np.arange(FIRST_S + OUTAGE_S, times_s[-1], EVERY_S)
        ends = [off[times_s < end_s][-1] for end_s in ends_s if end_s > times_s[0] + SETTLED_S]
        cells += [f"{np.median(ends):.2f}", f"{max(ends):.2f}"] if ends else ["", ""]
    return f"| {' | '.join([*cells, tried.told])} |"


@dataclass(frozen=True)
class Tried:
    """Horizontal errors, of tilt and of heading (n,) against the truth ten times a second, and what was told."""

    times_s: np.ndarray
    off_m: np.ndarray
    tilt_deg: np.ndarray
    heading_deg: np.ndarray
    nees: np.ndarray
    fixes_off_m: float
    told: str

    def cells(self) -> list[str]:
        """Return values of the columns HEADS."""
        settled = self.times_s > self.times_s[0] + SETTLED_S
        angles = rms(self.heading_deg[settled]), rms(self.tilt_deg[settled])
        values = self.times_s[0], rms(self.off_m), self.fixes_off_m, self.off_m.max(), *angles, self.nees.mean()
        return [f"{value:.3f}" for value in values]


def judge(recording: Recording, messages: list[Message]) -> Tried | str:
    """Return how far from the truth the estimates of some messages are, or why there are none."""
    estimator, events, judged = Estimator(recording.config), Counter[str](), list[np.ndarray]()
    for message in messages:
        one = estimator.process(message).estimate
        events.update(f"{event.sensor} {event.kind}" for event in estimator.take_events() if event.kind in WORST)
        if one is None or one.stamp_ns // 100_000_000 == (judged[-1][0] if judged else 0):
            continue
        assert estimator.datum is not None
        k = int(np.searchsorted(recording.stamps_ns, one.stamp_ns))
        R = one.nav.attitude().matrix()
        geodetic = LocalFrame(estimator.datum).to_geodetic(one.nav.position())
        off = LocalFrame(DATUM).to_enu(geodetic) - recording.p[k]
        turned = (Rotation.from_matrix(R) * recording.attitude[k].inv()).as_rotvec(degrees=True)
        nees = off @ np.linalg.solve(R @ one.covariance[3:6, 3:6] @ R.T, off)
        row = one.stamp_ns // 100_000_000, np.hypot(*off[:2]), np.hypot(*turned[:2]), abs(turned[2]), nees / 3.0
        judged.append(np.array(row))
    if not judged:
        return f"never started: {estimator.waiting_for}"
    times, *errors = np.array(judged).T
    told = ", ".join(f"{event} {count}" for event, count in sorted(events.items()))
    return Tried(0.1 * times - START_NS * 1e-9, *errors, rms(recording.off_m), told)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(VEHICLES), default=list(VEHICLES), metavar="VEHICLE")
    parser.add_argument("--gnss", nargs="+", choices=list(RECEIVERS), default=list(RECEIVERS))
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--odometry", action="store_true")
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--known", action="store_true")
    parser.add_argument("--outages", action="store_true")
    given = parser.parse_args()
    heads = ["vehicle", "GNSS", "seed", *HEADS]
    heads += ["end of an outage, median [m]", "largest [m]"] if given.outages else []
    print(f"| {' | '.join([*heads, 'events'])} |")
    print(f"|---|---|{'---:|' * (len(heads) - 2)}---|")
    seeds = range(given.first, given.first + given.count)
    odometry = Odometry(given.scale, given.known) if given.odometry else None
    tasks = product(given.only, given.gnss, seeds, [odometry], [given.outages])
    with ProcessPoolExecutor(2) as pool:
        for row in pool.map(run, *zip(*tasks, strict=True)):
            print(row, flush=True)


if __name__ == "__main__":
    main()
