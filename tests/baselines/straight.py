"""A machine whose problem is linear, since it does not turn and its attitude and biases are known."""

import gtsam
import numpy as np

from holdfast.baselines.intake import Measurement, PositionFix
from holdfast.baselines.propagation import Propagation, Tuning
from holdfast.config.load import parse_config
from holdfast.sensors.preintegration import Step
from holdfast.sensors.sensor import Position

G = 9.81
DT = 0.01
ACCEL_DENSITY = 0.02
FIX_SIGMA = 0.05
POSITION_DENSITY = 1e-4  # default of graph.position_integration_sigma
CONFIG = parse_config(
    f"""
sensors:
  imu:
    kind: imu
    topic: /imu
    accelerometer_noise_density: {ACCEL_DENSITY}
    gyroscope_noise_density: 1e-12
    accelerometer_random_walk: 1e-9
    gyroscope_random_walk: 1e-9
  gnss: {{kind: gnss, topic: /fix}}
extrinsics:
  - {{parent: imu, child: gnss}}
"""
)
WHITE = Tuning(acceleration=0.0, angular_rate_rad_s=0.0, fix_inflation=1.0)
F = np.block([[np.eye(3), DT * np.eye(3)], [np.zeros((3, 3)), np.eye(3)]])
# white acceleration, constant over a step, and what interpolation leaves
Q = np.kron([[DT**4 / 4, DT**3 / 2], [DT**3 / 2, DT**2]], np.eye(3)) * ACCEL_DENSITY**2 / DT
Q[:3, :3] += POSITION_DENSITY**2 * DT * np.eye(3)
H = np.hstack([np.eye(3), np.zeros((3, 3))])
R = FIX_SIGMA**2 * np.eye(3)
P0 = np.diag([0.2] * 3 + [0.3] * 3) ** 2
CERTAIN = 1e-14  # variance of what is known


def model():
    return Propagation(CONFIG, G, WHITE)


def first_covariance():
    P = np.eye(15) * CERTAIN
    P[3:9, 3:9] = P0
    return P


def step(acceleration):
    return Step(DT, acceleration + np.array([0.0, 0.0, G]), np.zeros(3))


def fix(position, stamp_ns=0):
    measured = Position(stamp_ns, "gnss", position, R, 0.0)
    return Measurement(stamp_ns, "gnss", PositionFix(measured, np.zeros(3)))


def history(seed, steps=60, every=5):
    """Return a truth (6,) drawn from the prior about zero, readings of acceleration, and fixes by their step."""
    rng = np.random.default_rng(seed)
    x = rng.multivariate_normal(np.zeros(6), P0)
    readings, fixes = [], {}
    for k in range(1, steps + 1):
        a = rng.standard_normal(3)
        x = F @ x + np.concatenate([a * DT**2 / 2, a * DT])
        x[:3] += POSITION_DENSITY * np.sqrt(DT) * rng.standard_normal(3)
        readings.append(a + ACCEL_DENSITY / np.sqrt(DT) * rng.standard_normal(3))
        if k % every == 0:
            fixes[k] = x[:3] + FIX_SIGMA * rng.standard_normal(3)
    return x, readings, fixes


def kalman(readings, fixes):
    """Return mean (6,) and covariance (6, 6) of the textbook's filter."""
    x, P = np.zeros(6), P0
    for k, a in enumerate(readings, start=1):
        x, P = F @ x + np.concatenate([a * DT**2 / 2, a * DT]), F @ P @ F.T + Q
        if k in fixes:
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            x, P = x + K @ (fixes[k] - H @ x), (np.eye(6) - K @ H) @ P
    return x, P


def filtered(filter_, belief, readings, fixes):
    """Run one of the baselines' filters over the same; return what `kalman` returns."""
    carried = model()
    for k, a in enumerate(readings, start=1):
        belief.nav = carried.advance(belief.nav, belief.bias, belief.bias_accel, belief.bias_gyro, step(a))
        filter_.predict(belief, carried)
        if k in fixes:
            filter_.update(belief, fix(fixes[k]))
    x = np.concatenate([belief.nav.position(), belief.nav.velocity()])
    return x, belief.nav_covariance()[3:9, 3:9]


def at_rest():
    return gtsam.NavState(gtsam.Rot3(), np.zeros(3), np.zeros(3)), gtsam.imuBias.ConstantBias()
