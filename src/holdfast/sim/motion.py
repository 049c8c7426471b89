"""Exact motion of every frame of the machine at any time.

The machine has eight generalised coordinates: position, height, yaw, pitch and roll of the chassis, the turn joint
and how hard it works. Quintic splines through a grid of them are the truth, so that all derivatives are exact. The
frames follow by rigid body kinematics, with the cabin vibrating on its mounts.
"""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import gaussian_filter1d

from holdfast.messages import Array
from holdfast.sim.driver import GRID_S, Plan, drive
from holdfast.sim.readings import generator
from holdfast.sim.scenario import BASE, CABIN, Chassis, Engine, Scenario
from holdfast.sim.scene import FrameMotion

TYRE_S = 0.08  # tyres and suspension smooth what the wheels run over
SWAY_S, SHAKE_S = 0.5, 0.08  # the arm tilts the machine slowly, and shakes it at about 2 Hz
SHAKE_RATIO = 0.15
VIBRATION_ARM_M = 1.0  # the cabin rocks on its mounts as if they were so far from its middle


class Surface(Protocol):
    """The ground that the wheels feel."""

    def height(self, x: Array, y: Array) -> Array:
        """Return the height [m] of the ground in W."""


class _Rotating(NamedTuple):
    """Attitude of a frame against its parent: (N, 3, 3), and in the frame angular velocity and acceleration (N, 3)."""

    R: Array
    rate: Array
    acceleration: Array


class _Moving(NamedTuple):
    """A point that moves: position, velocity and acceleration, (N, 3) each."""

    p: Array
    v: Array
    a: Array


class Motion:
    """The true motion of a machine; every frame of the scenario can be asked for, at any times within it."""

    def __init__(self, scenario: Scenario, surface: Surface, seed: int) -> None:
        plan = drive(scenario.activities, scenario.start, scenario.drive, scenario.duration_s)
        tilt = _arm_tilt(plan, scenario.engine, generator(seed, "arm"))
        z, pitch, roll = _on_ground(plan, scenario.chassis, surface)
        coordinates = np.stack(
            [plan.x_m, plan.y_m, z, plan.yaw_rad, pitch + tilt[0], roll + tilt[1], plan.joint_rad, plan.work], axis=1
        )
        self.duration_s = scenario.duration_s
        self.distance_m = float(np.hypot(np.diff(plan.x_m), np.diff(plan.y_m)).sum())
        self._spline: BSpline = make_interp_spline(plan.times_s, coordinates, k=5)
        self._vibration = _Vibration(scenario.engine, generator(seed, "vibration"))
        self._turn_joint = None if scenario.turn_joint is None else np.array(scenario.turn_joint.position_m)
        self._mounts: Mapping[str, tuple[str, Array]] = {
            extrinsic.child: (extrinsic.parent, extrinsic.matrix()) for extrinsic in scenario.extrinsics
        }

    def joint(self, times_s: Array) -> tuple[Array, Array]:
        """Return angle [rad] and rate [rad/s] of the turn joint, (N,) each."""
        return self._spline(times_s)[:, 6], self._spline(times_s, 1)[:, 6]

    def work(self, times_s: Array) -> Array:
        """Return how hard the machine works, (N,) from 0 to 1."""
        return np.asarray(self._spline(times_s)[:, 7])

    def frame(self, name: str, times_s: Array) -> FrameMotion:
        """Return the motion of a frame at times (N,) since the start of the scenario [s]."""
        q, dq, ddq = (self._spline(times_s, order) for order in range(3))
        rotation = _euler(q[:, 3:6], dq[:, 3:6], ddq[:, 3:6])
        position = _Moving(q[:, :3], dq[:, :3], ddq[:, :3])
        if name == BASE:
            return _frame_motion(rotation, position)
        parent, T = (CABIN, np.eye(4)) if name == CABIN else self._mounts[name]
        if parent == CABIN or self._turn_joint is None:  # without a joint the body on its wheels is the cabin
            rotation, position = _child(rotation, position, *self._cabin(times_s, q, dq, ddq))
        n = len(times_s)
        still = np.zeros((n, 3))
        mount = _Rotating(np.broadcast_to(T[:3, :3], (n, 3, 3)), still, still)
        return _frame_motion(
            *_child(rotation, position, mount, _Moving(np.broadcast_to(T[:3, 3], (n, 3)), still, still))
        )

    def _cabin(self, times_s: Array, q: Array, dq: Array, ddq: Array) -> tuple[_Rotating, _Moving]:
        """Return how the cabin moves against the chassis: the turn joint, and vibration on the mounts."""
        shift, rock = self._vibration.at(times_s, q[:, 7], dq[:, 7], ddq[:, 7])
        angles = [np.array(order) for order in rock]
        if self._turn_joint is not None:
            for order, joint in zip(angles, (q, dq, ddq), strict=True):
                order[:, 0] += joint[:, 6]
            shift = _Moving(shift.p + self._turn_joint, shift.v, shift.a)
        return _euler(*angles), shift


class _Vibration:
    """The cabin on its mounts: sinusoids whose amplitude follows the work."""

    def __init__(self, engine: Engine, rng: np.random.Generator) -> None:
        self._idle, self._work = engine.idle_acceleration_m_s2, engine.work_acceleration_m_s2
        self._omega = 2.0 * np.pi * engine.frequency_hz * np.array([1.0, 1.0, 2.0, 1.0, 1.0, 2.0])
        self._phase = rng.uniform(0.0, 2.0 * np.pi, 6)
        self._arm = np.array([1.0, 1.0, 1.0, VIBRATION_ARM_M, VIBRATION_ARM_M, VIBRATION_ARM_M])

    def at(self, times_s: Array, work: Array, d_work: Array, dd_work: Array) -> tuple[_Moving, _Moving]:
        """Return shift [m] and (yaw, pitch, roll) [rad] with their derivatives, from the work and its derivatives.

        x = A(t) sin(w t + phi), with A w^2 the amplitude of the acceleration.
        """
        scale = 1.0 / (self._omega**2 * self._arm)
        span = self._work - self._idle
        amplitude = (self._idle + span * work)[:, None] * scale
        d_amplitude, dd_amplitude = (span * order[:, None] * scale for order in (d_work, dd_work))
        angle = times_s[:, None] * self._omega + self._phase
        sine, cosine = np.sin(angle), np.cos(angle)
        x = amplitude * sine
        dx = d_amplitude * sine + amplitude * self._omega * cosine
        ddx = dd_amplitude * sine + 2.0 * d_amplitude * self._omega * cosine - self._omega**2 * x
        return _Moving(x[:, :3], dx[:, :3], ddx[:, :3]), _Moving(x[:, 3:], dx[:, 3:], ddx[:, 3:])


def _on_ground(plan: Plan, chassis: Chassis, surface: Surface) -> tuple[Array, Array, Array]:
    """Return height, pitch and roll (N,) of the plane that fits the four points under the wheels best."""
    cosine, sine = np.cos(plan.yaw_rad), np.sin(plan.yaw_rad)
    half_base, half_track = chassis.wheelbase_m / 2.0, chassis.track_m / 2.0
    heights = {
        (fore, left): surface.height(
            plan.x_m + fore * half_base * cosine - left * half_track * sine,
            plan.y_m + fore * half_base * sine + left * half_track * cosine,
        )
        for fore in (1, -1)
        for left in (1, -1)
    }
    z = sum(heights.values()) / 4.0
    rise = sum(fore * h for (fore, _), h in heights.items()) / (4.0 * half_base)
    bank = sum(left * h for (_, left), h in heights.items()) / (4.0 * half_track)
    pitch = -np.arctan(rise)
    roll = np.arctan(bank * np.cos(pitch))
    smooth = gaussian_filter1d(np.stack([z, pitch, roll]), TYRE_S / GRID_S, axis=1, mode="nearest")
    return smooth[0], smooth[1], smooth[2]


def _arm_tilt(plan: Plan, engine: Engine, rng: np.random.Generator) -> Array:
    """Return pitch and roll (2, N) by which the arm at work tilts and shakes the chassis, towards where it points."""
    noise = rng.standard_normal((2, len(plan.times_s)))
    sway = _unit(gaussian_filter1d(noise[0], SWAY_S / GRID_S))
    shake = _unit(gaussian_filter1d(noise[1], SHAKE_S / GRID_S) - gaussian_filter1d(noise[1], 2.0 * SHAKE_S / GRID_S))
    tilt = np.radians(engine.arm_tilt_deg) * plan.work**2 * (0.5 * sway + SHAKE_RATIO * shake)
    return np.stack([tilt * np.cos(plan.joint_rad), tilt * np.sin(plan.joint_rad)])


def _unit(noise: Array) -> Array:
    return np.asarray(noise / noise.std())


def _euler(angles: Array, rates: Array, accelerations: Array) -> _Rotating:
    """Return the rotation of R = Rz(yaw) Ry(pitch) Rx(roll) from (yaw, pitch, roll) and derivatives, (N, 3) each."""
    (cy, cp, cr), (sy, sp, sr) = np.cos(angles).T, np.sin(angles).T
    (y1, p1, r1), (y2, p2, r2) = rates.T, accelerations.T
    R = np.stack(
        [
            np.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr], axis=-1),
            np.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr], axis=-1),
            np.stack([-sp, cp * sr, cp * cr], axis=-1),
        ],
        axis=1,
    )
    rate = np.stack([r1 - y1 * sp, p1 * cr + y1 * sr * cp, -p1 * sr + y1 * cr * cp], axis=-1)
    acceleration = np.stack(
        [
            r2 - y2 * sp - y1 * p1 * cp,
            p2 * cr - p1 * r1 * sr + y2 * sr * cp + y1 * r1 * cr * cp - y1 * p1 * sr * sp,
            -p2 * sr - p1 * r1 * cr + y2 * cr * cp - y1 * r1 * sr * cp - y1 * p1 * cr * sp,
        ],
        axis=-1,
    )
    return _Rotating(R, rate, acceleration)


def _child(parent: _Rotating, origin: _Moving, rotation: _Rotating, position: _Moving) -> tuple[_Rotating, _Moving]:
    """Return how a child moves in W, from its parent in W and itself in the parent (rigid body kinematics)."""
    w = parent.rate
    carried = np.cross(w, position.p)
    v = carried + position.v
    a = np.cross(parent.acceleration, position.p) + np.cross(w, carried) + 2.0 * np.cross(w, position.v) + position.a
    inherited = _rotate(rotation.R.transpose(0, 2, 1), w)
    rotated = _Rotating(
        parent.R @ rotation.R,
        inherited + rotation.rate,
        _rotate(rotation.R.transpose(0, 2, 1), parent.acceleration)
        - np.cross(rotation.rate, inherited)
        + rotation.acceleration,
    )
    moved = (origin.p + _rotate(parent.R, position.p), origin.v + _rotate(parent.R, v), origin.a + _rotate(parent.R, a))
    return rotated, _Moving(*moved)


def _frame_motion(rotation: _Rotating, position: _Moving) -> FrameMotion:
    return FrameMotion(rotation.R, position.p, position.v, position.a, rotation.rate)


def _rotate(R: Array, v: Array) -> Array:
    return np.asarray(np.einsum("nij,nj->ni", R, v))
