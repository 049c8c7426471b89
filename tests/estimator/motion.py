# ruff: noqa: PLR0917 - how a sensor measures is many small choices with defaults
"""A machine whose motion is known in closed form, and what perfect or noisy sensors on it measure.

It stands, sets off smoothly and then drives a circle of 1.5 m radius at 1.5 m/s and 1 rad/s, rising, falling, rolling
and pitching. Everything is a function of a phase that is zero at standstill and grows by 1 per second at full speed.
"""

from dataclasses import dataclass
from math import cos, sin

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.estimator.estimator import Estimator
from holdfast.estimator.imu_path import receive
from holdfast.estimator.optimiser import Optimiser
from holdfast.event_log import EventLog
from holdfast.geometry.earth import Geodetic, LocalFrame, gravity
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT
from holdfast.messages import FixStatus, GnssFix, GnssVelocity, Height, ImuSample, PointPosition, SensorPose, Twist
from holdfast.sensors.imu import ImuBuffer

DATUM = Geodetic(47.4, 8.5, 450.0)
G = gravity(DATUM.latitude_deg, DATUM.altitude_m)
UP = np.array([0.0, 0.0, G])
HEADING_DEG = float(np.degrees(0.3))
EPOCH_NS = 1_700_000_000_000_000_000

ARM = np.array([0.4, -0.5, 1.2])
ARM_RIGHT = np.array([-0.7, -1.9, 1.1])
NOT_TURNED = gtsam.Pose3()
T_I_L = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, -0.2, 2.0), np.array([0.8, 0.3, 0.9]))


def ns(t):
    """Seconds of the motion to a stamp."""
    return EPOCH_NS + round(t * 1e9)


def seconds(stamp_ns):
    return (stamp_ns - EPOCH_NS) * 1e-9


@dataclass(frozen=True)
class Drive:
    """Stands until `start_s`, is at full speed after another `ramp_s`; `speed` scales phase against time."""

    start_s: float = 2.5
    ramp_s: float = 2.0
    speed: float = 1.0
    yaw_rad: float = 0.3
    roll_rad: float = 0.05
    pitch_rad: float = -0.08
    radius_m: float = 1.5
    tilt: float = 1.0
    heave_m: float = 0.2

    def phase(self, t):
        """Phase and its first two derivatives: the rate is a smooth step of fifth order."""
        x = min(max((t - self.start_s) / self.ramp_s, 0.0), 1.0)
        ramp = self.ramp_s * (x**6 - 3.0 * x**5 + 2.5 * x**4)
        phase = ramp + max(0.0, t - self.start_s - self.ramp_s)
        rate = 6.0 * x**5 - 15.0 * x**4 + 10.0 * x**3
        change = (30.0 * x**4 - 60.0 * x**3 + 30.0 * x**2) / self.ramp_s
        return self.speed * phase, self.speed * rate, self.speed * change

    def _euler(self, u):
        """Roll, pitch and yaw, and their derivatives by phase."""
        angles = [
            self.roll_rad + 0.15 * self.tilt * sin(1.3 * u),
            self.pitch_rad + 0.1 * self.tilt * sin(0.9 * u),
            self.yaw_rad + u,
        ]
        return angles, [0.195 * self.tilt * cos(1.3 * u), 0.09 * self.tilt * cos(0.9 * u), 1.0]

    def nav(self, t):
        u, du, _ = self.phase(t)
        r, a = self.radius_m, self.yaw_rad
        position = [r * (sin(a + u) - sin(a)), r * (cos(a) - cos(a + u)), self.heave_m * sin(0.7 * u)]
        velocity = np.array([r * cos(a + u), r * sin(a + u), 0.7 * self.heave_m * cos(0.7 * u)]) * du
        return gtsam.NavState(gtsam.Rot3.RzRyRx(*self._euler(u)[0]), np.array(position), velocity)

    def pose(self, t):
        return self.nav(t).pose()

    def readings(self, t):
        """Specific force [m/s^2] and angular velocity [rad/s] of I."""
        u, du, ddu = self.phase(t)
        r, a = self.radius_m, self.yaw_rad
        first = np.array([r * cos(a + u), r * sin(a + u), 0.7 * self.heave_m * cos(0.7 * u)])
        second = np.array([-r * sin(a + u), r * cos(a + u), -0.49 * self.heave_m * sin(0.7 * u)])
        (roll, pitch, yaw), (d_roll, d_pitch, d_yaw) = self._euler(u)
        rate = np.array(
            [
                d_roll - sin(pitch) * d_yaw,
                cos(roll) * d_pitch + sin(roll) * cos(pitch) * d_yaw,
                -sin(roll) * d_pitch + cos(roll) * cos(pitch) * d_yaw,
            ]
        )
        return gtsam.Rot3.RzRyRx(roll, pitch, yaw).unrotate(second * du**2 + first * ddu + UP), rate * du


class StopAndGo(Drive):
    """Its speed swings: on a circle at a constant one, a late stamp looks like another heading."""

    def phase(self, t):
        u, du, ddu = super().phase(t)
        swing = 1.0 + 0.7 * cos(2.0 * u)
        return u + 0.35 * sin(2.0 * u), du * swing, ddu * swing - 1.4 * sin(2.0 * u) * du**2


@dataclass(frozen=True)
class FigureEight(Drive):
    """Looks where it drives: on a circle at a constant speed an arm looks like another heading."""

    def _derivatives(self, u):
        """Position and its first two derivatives by phase."""
        p = np.array([20.0 * sin(u), 10.0 * sin(2.0 * u), 0.0])
        return p, np.array([20.0 * cos(u), 20.0 * cos(2.0 * u), 0.0]), np.array([-p[0], -4.0 * p[1], 0.0])

    def nav(self, t):
        u, du, _ = self.phase(t)
        p, first, _ = self._derivatives(u)
        return gtsam.NavState(gtsam.Rot3.Yaw(np.arctan2(first[1], first[0])), p, first * du)

    def readings(self, t):
        u, du, ddu = self.phase(t)
        _, first, second = self._derivatives(u)
        rate = (first[0] * second[1] - first[1] * second[0]) / (first @ first) * du
        force = self.nav(t).attitude().unrotate(second * du**2 + first * ddu + UP)
        return force, np.array([0.0, 0.0, rate])


@dataclass(frozen=True)
class ConstantTwist:
    """Constant twist from `gtsam.ConstantTwistScenario`, which owes nothing to `Drive`."""

    scenario: gtsam.ConstantTwistScenario

    def nav(self, t):
        return self.scenario.navState(t)

    def pose(self, t):
        return self.scenario.pose(t)

    def readings(self, t):
        force = self.scenario.rotation(t).unrotate(self.scenario.acceleration_n(t) + UP)
        return force, self.scenario.omega_b(t)


def tilted_circle(speed_m_s=1.5, turn_rad_s=1.0):
    """Climbing circle around an axis that is not the vertical."""
    axis = np.array([0.2, -0.3, 0.93])
    start = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.2, 0.3, -0.7), np.array([1.0, 2.0, 3.0]))
    rate = turn_rad_s * axis / np.linalg.norm(axis)
    return ConstantTwist(gtsam.ConstantTwistScenario(rate, np.array([speed_m_s, 0.0, 0.0]), start))


# --- sensors ----------------------------------------------------------------------------------------------------------


def imu(motion, start_s, end_s, hz=100.0, rng=None, densities=(2e-3, 2e-4), bias=None, phase_s=0.0, walk=None):
    """Samples in [start, end]; `bias` is (6,) accelerometer, gyroscope; `walk` the densities of its random walk."""
    bias = np.zeros(6) if bias is None else np.array(bias, dtype=float)
    samples = []
    for k in range(round((end_s - start_s) * hz) + 1):
        t = start_s + phase_s + k / hz
        force, rate = motion.readings(t)
        if rng is None:
            force = force + 1e-9 * (-1) ** k  # the same digits for seconds would be a dead sensor
        else:
            force = force + rng.normal(0.0, densities[0] * np.sqrt(hz), 3)
            rate = rate + rng.normal(0.0, densities[1] * np.sqrt(hz), 3)
            if walk is not None:
                bias = bias + rng.normal(0.0, np.repeat(walk, 3) / np.sqrt(hz))
        samples.append(ImuSample(ns(t), ns(t), "imu", rate + bias[3:], force + bias[:3]))
    return samples


def fix_at(motion, t, noise=None, sigma=(0.01, 0.01, 0.02), arm=ARM, sensor="gnss", delay_s=0.0, stamp_shift_s=0.0):
    pose = motion.pose(t)
    p_W_G = pose.transformFrom(arm) + (0.0 if noise is None else noise)
    stamp = ns(t + stamp_shift_s)
    covariance = np.diag(np.square(sigma))
    return GnssFix(stamp, ns(t + delay_s), sensor, *LocalFrame(DATUM).to_geodetic(p_W_G), covariance, FixStatus.GBAS)


def fixes(motion, start_s, end_s, hz=10.0, rng=None, sigma=(0.01, 0.01, 0.02), phase_s=0.0, **how):
    times = start_s + phase_s + np.arange(int((end_s - start_s) * hz + 1e-6) + 1) / hz
    noises = [None] * len(times) if rng is None else rng.normal(0.0, sigma, (len(times), 3))
    return [fix_at(motion, t, noise, sigma, **how) for t, noise in zip(times, noises, strict=True)]


def scans(
    motion,
    start_s,
    end_s,
    hz=5.0,
    rng=None,
    sigma=(0.002, 0.02),
    phase_s=0.0,
    delay_s=0.0,
    stamp_shift_s=0.0,
    sensor="lidar",
):
    """The lidar's track; noise (rotation [rad], translation [m]) is that of a motion between two scans, and stays."""
    times = start_s + phase_s + np.arange(int((end_s - start_s) * hz + 1e-6) + 1) / hz
    first, messages = None, []
    for t in times:
        here = motion.pose(t) * T_I_L
        first = here if first is None else first
        track = first.between(here)
        if rng is not None:
            track = track * gtsam.Pose3.Expmap(rng.normal(0.0, np.repeat(sigma, 3) / np.sqrt(2.0)))
        q = track.rotation().toQuaternion()
        xyzw = np.array([q.x(), q.y(), q.z(), q.w()])
        stamp = ns(t + stamp_shift_s)
        messages.append(SensorPose(stamp, ns(t + delay_s), sensor, track.translation(), xyzw, None))
    return messages


def stamps_of(start_s, end_s, hz, phase_s=0.0):
    return start_s + phase_s + np.arange(int((end_s - start_s) * hz + 1e-6) + 1) / hz


def twists(motion, start_s, end_s, hz=10.0, T_I_S=NOT_TURNED, scale=1.0, rng=None, sigma=0.02, sensor="wheels"):
    """Velocity of a frame S of the cabin in its own axes."""
    messages = []
    for t in stamps_of(start_s, end_s, hz, 0.0031):
        _, rate = motion.readings(t)
        velocity = T_I_S.rotation().unrotate(motion.nav(t).bodyVelocity() + np.cross(rate, T_I_S.translation()))
        noise = np.zeros(3) if rng is None else rng.normal(0.0, sigma, 3)
        messages.append(Twist(ns(t), ns(t), sensor, scale * velocity + noise, np.zeros(3), None))
    return messages


def velocities(motion, start_s, end_s, hz=5.0, arm=ARM, rng=None, sigma=(0.05, 0.05, 0.1), sensor="doppler"):
    """Velocity of an antenna in W."""
    messages = []
    for t in stamps_of(start_s, end_s, hz, 0.0137):
        _, rate = motion.readings(t)
        velocity = motion.nav(t).velocity() + motion.nav(t).attitude().rotate(np.cross(rate, arm))
        noise = np.zeros(3) if rng is None else rng.normal(0.0, sigma)
        messages.append(GnssVelocity(ns(t), ns(t), sensor, velocity + noise, np.diag(np.square(sigma))))
    return messages


def prisms(motion, start_s, end_s, hz=10.0, arm=ARM, rng=None, sigma_m=0.005, sensor="prism"):
    messages = []
    for t in stamps_of(start_s, end_s, hz, 0.0057):
        noise = np.zeros(3) if rng is None else rng.normal(0.0, sigma_m, 3)
        messages.append(PointPosition(ns(t), ns(t), sensor, motion.pose(t).transformFrom(arm) + noise, None))
    return messages


def poses(motion, start_s, end_s, hz=5.0, T_W_F=NOT_TURNED, T_I_S=NOT_TURNED, rng=None, sensor="marker"):
    """Poses of S in F, with the noise of the default configuration."""
    messages = []
    for t in stamps_of(start_s, end_s, hz, 0.0083):
        noise = np.zeros(6) if rng is None else rng.normal(0.0, np.repeat([0.01, 0.05], 3))
        T_F_S = T_W_F.inverse() * motion.pose(t) * T_I_S * gtsam.Pose3.Expmap(noise)
        q = T_F_S.rotation().toQuaternion()
        xyzw = np.array([q.x(), q.y(), q.z(), q.w()])
        messages.append(SensorPose(ns(t), ns(t), sensor, T_F_S.translation(), xyzw, None))
    return messages


def heights(
    motion, start_s, end_s, hz=5.0, arm=(0.0, 0.0, 0.0), constant_m=0.0, rng=None, sigma_m=0.05, sensor="laser"
):
    messages = []
    for t in stamps_of(start_s, end_s, hz, 0.0019):
        noise = 0.0 if rng is None else rng.normal(0.0, sigma_m)
        height_m = motion.pose(t).transformFrom(np.array(arm))[2] + constant_m + noise
        messages.append(Height(ns(t), ns(t), sensor, float(height_m), None))
    return messages


def in_order(*streams):
    """All messages in the order of arrival; at the same instant the IMU comes first."""
    return sorted((m for stream in streams for m in stream), key=lambda m: (m.arrival_ns, m.sensor != "imu", m.sensor))


# --- configuration and running ----------------------------------------------------------------------------------------


def machine(lidar=True, gnss=True, right=False, heading=False, heading_deg=HEADING_DEG, more=None, **sections):
    """Configuration of the machine.

    `more` are further sensors: name -> section, with a pose T_I_S as `mount` if they have one. Other keyword arguments
    are sections, or `imu_`, `gnss_`, `lidar_`, `heading_` settings.
    """
    sensors = {
        "imu": {"kind": "imu", "topic": "/imu", "accelerometer_error_ratio": 0.0, "gyroscope_error_ratio": 0.0}
        | sections.pop("imu_", {})
    }
    extrinsics = [
        link("imu", "gnss", at(ARM)),
        link("imu", "right", at(ARM_RIGHT)),
        link("imu", "lidar", T_I_L),
    ]
    if gnss:
        sensors["gnss"] = {"kind": "gnss", "topic": "/gnss", "correlation_s": 0.0} | sections.pop("gnss_", {})
    if right:
        sensors["gnss_right"] = {"kind": "gnss", "topic": "/right", "frame": "right", "correlation_s": 0.0}
    if lidar:
        sensors["lidar"] = {"kind": "odometry", "topic": "/lidar"} | sections.pop("lidar_", {})
    if heading:
        sensors["heading"] = {"kind": "heading", "topic": "/heading"} | sections.pop("heading_", {})
    for name, section in (more or {}).items():
        sensors[name] = {"topic": f"/{name}"} | {key: value for key, value in section.items() if key != "mount"}
        if "mount" in section:
            extrinsics.append(link("imu", name, section["mount"]))
    return Config.model_validate(
        {
            "sensors": sensors,
            "extrinsics": extrinsics,
            "initialisation": {"heading_deg": heading_deg} | sections.pop("initialisation", {}),
            "frames": {"datum": DATUM._asdict()},
            **sections,
        }
    )


def at(position):
    """A pose that is not turned."""
    return gtsam.Pose3(gtsam.Rot3(), np.asarray(position, dtype=float))


def link(parent, child, T):
    """One of the `extrinsics`."""
    rotation = tuple(tuple(row) for row in T.rotation().matrix().tolist())
    return {"parent": parent, "child": child, "translation_m": tuple(T.translation()), "rotation_matrix": rotation}


def run(config, messages, learnt=NOTHING_LEARNT):
    """Return the estimator after all messages, and what each of them led to."""
    estimator = Estimator(config, learnt=learnt)
    return estimator, [estimator.process(message) for message in messages]


def optimised(config, messages, after_update=lambda *_: None):
    """Return the optimiser after all messages, its log and its buffer: the estimator without its IMU path."""
    buffer, log = ImuBuffer(config.imu), EventLog(config.imu_name)
    optimiser = Optimiser(config, buffer, log)
    for message in messages:
        if isinstance(message, ImuSample):
            optimiser.receive(receive(buffer, message))
        else:
            optimiser.add(message)
        if optimiser.is_due:
            optimiser.update()
            optimiser.drop_samples()
            after_update(optimiser, buffer.latest_ns)
    return optimiser, log, buffer


def estimates(outputs):
    return [output.estimate for output in outputs if output.estimate is not None]


def horizontal_errors_m(motion, outputs, since_s):
    """Horizontal errors after a time."""
    return [
        float(np.linalg.norm((e.nav.position() - motion.nav(seconds(e.stamp_ns)).position())[:2]))
        for e in estimates(outputs)
        if e.stamp_ns > ns(since_s)
    ]


def deviation(motion, estimate):
    """Position [m], rotation [rad] and velocity [m/s] between an estimate, or an optimised state, and the truth."""
    truth = motion.nav(seconds(estimate.stamp_ns))
    return apart(truth, estimate.nav)


def apart(a, b):
    return (
        float(np.linalg.norm(a.position() - b.position())),
        float(np.linalg.norm(a.attitude().logmap(b.attitude()))),
        float(np.linalg.norm(a.velocity() - b.velocity())),
    )


def error(motion, estimate):
    """Tangent (9,) that leads from an estimate to the truth, whose covariance is `covariance`."""
    return estimate.nav.localCoordinates(motion.nav(seconds(estimate.stamp_ns)))
