"""Plain inertial navigation by trapezoids: what exact IMU signals must lead back to."""

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation


def integrate(times_s, angular_velocity, specific_force, R0, p0, v0, gravity, earth_rate=None):  # noqa: PLR0917
    """Return R_W_I (N, 3, 3), p_W and v_W (N, 3), integrated from the start state.

    With W the earth rate, R' = R [w] - [W] R and v' = R f + g - 2 W x v are solved by R = exp(-W t) Q and
    v = exp(-2 W t) u, so that only Q' = Q [w] and u' = exp(2 W t) (R f + g) are left to integrate. Forces are turned
    into W before they are averaged: gravity then cancels at every sample, whatever the machine turns.

    The error falls with the square of the period. Of a vibration near a third of the rate trapezoids lose a quarter of
    its velocity, the velocity at the start included, which is then carried along: 28 Hz at 100 Hz and 0.4 m/s^2 may
    cost 6 cm in 60 s where the truth is exact. Start at a turning point of the vibration, or sample faster.

    Args:
        times_s: (N,) increasing.
        angular_velocity: (N, 3) of I against inertial space, in I [rad/s].
        specific_force: (N, 3) in I [m/s^2].
        R0: (3, 3) attitude R_W_I at the first time.
        p0: (3,) position [m].
        v0: (3,) velocity [m/s].
        gravity: [m/s^2], centrifugal part included.
        earth_rate: (3,) in W [rad/s]; None is an earth that stands still.
    """
    elapsed = times_s - times_s[0]
    earth = np.zeros(3) if earth_rate is None else np.asarray(earth_rate)

    def turned(factor):
        return Rotation.from_rotvec(np.outer(factor * elapsed, earth)).as_matrix()

    dt = np.diff(times_s)[:, None]
    before, after = angular_velocity[:-1], angular_velocity[1:]
    # the second term is coning: the rotation vector of a rate that is linear in time (Bortz 1971)
    turns = Rotation.from_rotvec(dt * (before + after) / 2.0 + dt**2 * np.cross(before, after) / 12.0).as_matrix()
    Q = np.empty((len(times_s), 3, 3))
    Q[0] = R0
    for k, turn in enumerate(turns):
        Q[k + 1] = Q[k] @ turn
    R = turned(-1.0) @ Q
    a = np.einsum("nij,nj->ni", R, specific_force) - [0.0, 0.0, gravity]
    u = v0 + cumulative_trapezoid(np.einsum("nij,nj->ni", turned(2.0), a), times_s, axis=0, initial=0.0)
    v = np.einsum("nij,nj->ni", turned(-2.0), u)
    return R, p0 + cumulative_trapezoid(v, times_s, axis=0, initial=0.0), v
