"""What must never happen, whatever the sensors do: values that are not finite, and an odometry frame that jumps."""

from collections.abc import Iterator

import numpy as np

from holdfast.covariances import correlation_eigenvalues
from holdfast.evaluation.evidence import Published
from holdfast.evaluation.smoothness import steps

MAX_STEP_M = 0.002
MAX_STEP_DEG = 0.02
FLOW_M_S, FLOW_DEG_S = 0.05, 0.5
"""At which corrections may flow into T_O_I: after lost samples of the IMU more of them than a step is allowed."""
ROUNDING = 1.001  # of a step between two estimates, over which readings are taken for linear


def violations(published: Published, start_ns: int) -> Iterator[str]:
    """Yield one line per fault of what was published from a start of the estimator on; times count from `start_ns`."""
    stamps = published.world.poses.stamps_ns
    times_s = (stamps - start_ns) * 1e-9
    backward = np.flatnonzero(np.diff(stamps) <= 0)
    if len(backward):
        yield f"the stamps do not increase at {times_s[backward[0] + 1]:.2f} s"
        return
    columns = {
        "position": published.world.poses.positions,
        "attitude": published.world.poses.quaternions,
        "velocity": published.world.velocities,
        "pose in O": np.hstack([published.odometry.poses.positions, published.odometry.poses.quaternions]),
        "angular velocity": published.inertial.angular_velocity,
        "covariance": published.covariances.reshape(-1, 81),
    }
    broken = False
    for name, values in columns.items():
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if len(bad):
            broken = True
            yield f"{name} is not finite at {times_s[bad[0]]:.2f} s, in {len(bad)} estimates"
    if broken:
        return
    positive = correlation_eigenvalues(published.covariances) > 0.0
    if not positive.all():
        first = int(np.flatnonzero(~positive)[0])
        yield f"the covariance is not positive at {times_s[first]:.2f} s, in {np.sum(~positive)} estimates"
    moved, turned = steps(published.odometry, published.inertial)
    lasted_s = np.diff(times_s, prepend=times_s[:1])
    most_m = np.maximum(MAX_STEP_M, ROUNDING * FLOW_M_S * lasted_s)
    most_deg = np.maximum(MAX_STEP_DEG, ROUNDING * FLOW_DEG_S * lasted_s)
    # a bias is learnt at one end of a step or the other: the rate between them is known to half of the difference
    bias = published.inertial.gyroscope_bias
    most_deg += 0.5 * lasted_s * np.degrees(np.linalg.norm(np.diff(bias, axis=0, prepend=bias[:1]), axis=1))
    for values, limits, unit in ((moved * 1e3, most_m * 1e3, "mm"), (turned, most_deg, "deg")):
        beyond = np.flatnonzero(values > limits)
        if len(beyond):
            worst = int(np.nanargmax(values / limits))
            change = float(np.linalg.norm(np.diff(published.odometry.velocities[worst - 1 : worst + 1], axis=0)))
            yield (
                f"O steps by up to {values[worst]:.3g} {unit} at {times_s[worst]:.2f} s, where its velocity changes by "
                f"{change:.2f} m/s; {len(beyond)} steps, the first at {times_s[beyond[0]]:.2f} s"
            )
