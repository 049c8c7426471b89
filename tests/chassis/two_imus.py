"""Cabin and chassis of the machine askew, each with an inertial measurement unit, on ground as rough as is asked for.

Angular velocity and specific force at the joint are sums of sines; what the sensors measure follows in closed form.
"""

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from slewing import NO_BIAS, NO_COVARIANCE, T_W_O, Chassis, machine, ns

from holdfast.config.model import Config
from holdfast.messages import ImuSample, JointAngle
from holdfast.sensors.learnt_joint import NOTHING_OF_JOINT
from holdfast.sensors.mount import Mount
from holdfast.state import _E, Estimate

RATE_HZ = 100.0
ENCODER_NOISE_RAD = 2e-4
BLANK = Estimate.of(0, gtsam.NavState(), T_W_O, NO_BIAS, NO_COVARIANCE, np.zeros(3), True)


@dataclass(frozen=True)
class Ground:
    """What moves the machine: amplitudes of sines.

    Attributes:
        rate_rad_s: of the chassis about its horizontal axes.
        force_m_s2: of the horizontal specific force.
        slew_rad: of the joint.
    """

    rate_rad_s: float = 0.05
    force_m_s2: float = 1.0
    slew_rad: float = 0.5


@dataclass(frozen=True)
class Wrong:
    """What is otherwise than configured: zero of the encoder, rotation vector of the base IMU in J, its clock.

    `force_yaw_rad` is by how much its accelerometers are turned against its gyroscopes.
    """

    zero_rad: float = 0.0
    rotation_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    clock_s: float = 0.0
    force_yaw_rad: float = 0.0


def _sines(rng, times_s, amplitudes, slowest_hz, fastest_hz):
    """Columns of three sines each, and their derivative."""
    values, slopes = np.zeros((2, len(times_s), len(amplitudes)))
    for column, amplitude in enumerate(amplitudes):
        for _ in range(3):
            omega, phase = 2.0 * np.pi * rng.uniform(slowest_hz, fastest_hz), rng.uniform(0.0, 2.0 * np.pi)
            values[:, column] += amplitude / 1.7 * np.sin(omega * times_s + phase)
            slopes[:, column] += amplitude / 1.7 * omega * np.cos(omega * times_s + phase)
    return values, slopes


def turned(vectors, angles):
    """Vectors (N, 3) rotated about z."""
    c, s = np.cos(angles), np.sin(angles)
    x, y, z = vectors.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)


def at_arm(force, rate, acceleration, arm):
    return force + np.cross(acceleration, arm) + np.cross(rate, np.cross(rate, arm))


class TwoImus:
    """Runs `BaseKinematics` with the readings of both units and of the encoder.

    Args:
        seed: of motion, noise and biases.
        duration_s: how long.
        ground: what moves the machine.
        wrong: what the configuration does not know.
        has_base: there is a base IMU.
        learnt: what was learnt before.
        sections: changes of the sections of joint and base IMU.
    """

    def __init__(
        self,
        seed,
        duration_s=40.0,
        ground=Ground(),
        wrong=Wrong(),
        *,
        has_base=True,
        learnt=NOTHING_OF_JOINT,
        **sections,
    ):
        noise = {"noise_deg": float(np.degrees(ENCODER_NOISE_RAD))}
        given = machine(base_imu=has_base, joint=noise).model_dump(exclude_unset=True)
        for name, section in sections.items():
            given["sensors"][name] |= section
        self.config = Config.model_validate(given)
        self.wrong, self.rng = wrong, np.random.default_rng(seed)
        self.times_s = np.arange(0.0, duration_s, 1.0 / RATE_HZ)
        self._motion = np.random.default_rng(seed + 1000)
        self._phases = replace(ground), self._motion.bit_generator.state
        self.chassis = Chassis(self.config, learnt)

    def _signals(self, times_s):
        """Rate, its derivative and specific force of the chassis at the joint, in J; the joint's angle and its own."""
        ground, state = self._phases
        self._motion.bit_generator.state = state
        rates, slopes = _sines(self._motion, times_s, (ground.rate_rad_s, ground.rate_rad_s, 0.1), 0.3, 2.0)
        forces, _ = _sines(self._motion, times_s, (ground.force_m_s2, ground.force_m_s2, 0.2), 0.05, 0.5)
        forces[:, 2] += 9.81
        q, q_rate = _sines(self._motion, times_s, (ground.slew_rad,), 0.03, 0.08)
        h = 1e-4
        self._motion.bit_generator.state = state
        for _ in range(2):
            _sines(self._motion, times_s[:1], (1.0,) * 3, 0.3, 2.0)
        _, later = _sines(self._motion, times_s + h, (ground.slew_rad,), 0.03, 0.08)
        return rates, slopes, forces, q[:, 0], q_rate[:, 0], (later - q_rate)[:, 0] / h

    def _noisy(self, section, rates, forces):
        """Readings with white noise, and a constant bias of the accelerometer."""
        density = np.array([section.gyroscope_noise_density, section.accelerometer_noise_density])
        noise = density * np.sqrt(RATE_HZ)
        shape = rates.shape
        biased = forces + 0.3 * section.accelerometer_bias_sigma * self.rng.standard_normal(3)
        return rates + noise[0] * self.rng.standard_normal(shape), biased + noise[1] * self.rng.standard_normal(shape)

    def _cabin(self):
        """Estimates, and the specific force of each."""
        mount, (rates, slopes, forces, q, q_rate, q_acceleration) = self._mount, self._signals(self.times_s)
        up = np.array([0.0, 0.0, 1.0])
        rates = turned(rates + q_rate[:, None] * up, -q)
        slopes = turned(slopes + q_acceleration[:, None] * up, -q) - np.cross(q_rate[:, None] * up, rates)
        R_I_A = mount.T_I_A.rotation().matrix()
        rates, slopes, forces = rates @ R_I_A.T, slopes @ R_I_A.T, turned(forces, -q) @ R_I_A.T
        forces = at_arm(forces, rates, slopes, -mount.T_I_A.translation())
        rates, forces = self._noisy(self.config.imu, rates, forces)
        estimates = []
        for t, rate in zip(self.times_s, rates, strict=True):
            values = BLANK.values.copy()
            values[_E["angular_velocity"]] = rate
            estimates.append(Estimate(ns(t), values, True))
        return estimates, forces

    def _base(self):
        times_s = self.times_s + 0.006
        rates, slopes, forces, *_ = self._signals(times_s)
        T_J_S = Mount(self.config, self.config.frame_of("base_imu")).T_J_S
        forces = at_arm(forces, rates, slopes, T_J_S.translation())
        R = gtsam.Rot3.Expmap(np.array(self.wrong.rotation_rad)).matrix() @ T_J_S.rotation().matrix()
        section = self.config.base_imu[1]
        rates = rates @ R + 0.3 * section.gyroscope_bias_sigma * self.rng.standard_normal(3)
        skewed = gtsam.Rot3.Rz(self.wrong.force_yaw_rad).matrix()
        rates, forces = self._noisy(section, rates, forces @ skewed @ R)
        stamps = times_s + self.wrong.clock_s
        return [
            ImuSample(ns(stamp), ns(t + 0.001), "base_imu", rate, force)
            for t, stamp, rate, force in zip(times_s, stamps, rates, forces, strict=True)
        ]

    def _encoder(self):
        times_s = self.times_s + 0.003
        q = self._signals(times_s)[3] - self.wrong.zero_rad
        q += ENCODER_NOISE_RAD * self.rng.standard_normal(len(q))
        return [JointAngle(ns(t), ns(t + 0.004), "joint", float(a)) for t, a in zip(times_s, q, strict=True)]

    def run(self):
        """Return the states of the chassis, and the true angle of the joint at each."""
        self._mount = Mount(self.config, self.config.frames.base)
        estimates, forces = self._cabin()
        messages = self._encoder() + (self._base() if self.config.base_imu else [])
        states = self.chassis.run(estimates, messages, forces)
        known = [row for row, state in enumerate(states) if state is not None]
        return [states[row] for row in known], self._signals(self.times_s)[3][known]

    @property
    def events(self):
        """(kind, sensor, reason) of each."""
        return [(str(event.kind), event.sensor, event.reason) for event in self.chassis.log.events]
