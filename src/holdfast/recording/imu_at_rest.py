"""What an IMU is like, by its quietest moment: spread, white noise, gravity, resolution."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from holdfast.config.model import StandstillConfig
from holdfast.geometry.earth import STANDARD_GRAVITY_M_S2
from holdfast.messages import Array

WINDOW_S = 2.0
SHAKEN = 10.0  # times the bounds of standstill: an idling engine shakes less, a motion more
MIN_SAMPLES = 20
SAME_READING = 1e-12  # differences below are round-off
FORCE_IN_G, OFTEN = (0.8, 1.3), 0.9  # in so many of all stretches of two seconds
NO_FORCE_M_S2 = 0.8  # nothing on the ground is quiet with less
UNITS_OF_GRAVITY = {STANDARD_GRAVITY_M_S2: "g", STANDARD_GRAVITY_M_S2 / 1000.0: "mg"}
Axes = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ImuAtRest:
    """The quietest two seconds of an IMU, if it was quiet enough to stand or to roll smoothly.

    Noise densities are those of the differences of successive samples (the Allan deviation at one sample), of the worst
    axis, and at least what the resolution makes; motion hardly enters them, vibration does.

    Attributes:
        at_s: when the window begins, after the start of the recording.
        rate_spread_rad_s: standard deviation of the gyroscope, per axis.
        force_spread_m_s2: that of the accelerometer.
        mean_rate_rad_s: per axis; at standstill the gyroscope's bias.
        mean_force_m_s2: length of the mean specific force.
        rate_step_rad_s: smallest difference between two readings of the whole recording: the resolution.
        force_step_m_s2: that of the accelerometer.
    """

    at_s: float
    rate_spread_rad_s: Axes
    force_spread_m_s2: Axes
    mean_rate_rad_s: Axes
    mean_force_m_s2: float
    gyroscope_noise_density: float
    accelerometer_noise_density: float
    rate_step_rad_s: float
    force_step_m_s2: float

    def is_without_gravity(self) -> bool:
        """Whether gravity was taken off the specific force."""
        return self.mean_force_m_s2 < NO_FORCE_M_S2

    def summary(self) -> str:
        """Return it in one line."""
        return (
            f"quietest at {self.at_s:.1f} s: spread {max(self.rate_spread_rad_s):.2g} rad/s and "
            f"{max(self.force_spread_m_s2):.2g} m/s^2, mean specific force {self.mean_force_m_s2:.2f} m/s^2"
        )

    def notes(self) -> tuple[str, ...]:
        """Return it in a few lines."""
        return (
            f"quietest {WINDOW_S:g} s, from {self.at_s:.1f} s: spread {_row(self.rate_spread_rad_s)} rad/s, "
            f"{_row(self.force_spread_m_s2)} m/s^2",
            f"mean specific force there {self.mean_force_m_s2:.3f} m/s^2; mean rate (the gyroscope's bias if it stood) "
            f"{_row(self.mean_rate_rad_s)} rad/s",
            f"resolution {self.rate_step_rad_s:.2g} rad/s, {self.force_step_m_s2:.2g} m/s^2",
        )


def imu_at_rest(stamps_ns: NDArray[np.int64], values: Array, start_ns: int) -> ImuAtRest | None:
    """Find the quietest two seconds of an IMU.

    Args:
        stamps_ns: (N,).
        values: (N, 6) angular velocity [rad/s] and specific force [m/s^2].
        start_ns: of the recording.

    Returns:
        None where there are none, or where the IMU is never quiet.
    """
    kept = np.asarray(np.isfinite(values).all(axis=1))
    kept[1:] &= (values[1:] != values[:-1]).any(axis=1)  # repeats are no readings
    stamps_ns, values = stamps_ns[kept], values[kept]
    if len(values) < MIN_SAMPLES or stamps_ns[-1] <= stamps_ns[0]:
        return None
    period_s = float(np.median(np.diff(stamps_ns))) * 1e-9
    size = _window_size(period_s)
    windows = values[: len(values) // size * size].reshape(-1, size, 6)
    times_ns = stamps_ns[: len(windows) * size].reshape(-1, size)
    if not len(windows):
        return None
    bounds = StandstillConfig()
    allowed = np.repeat([bounds.max_angular_rate_rad_s, bounds.max_acceleration], 3)
    shaken = (windows.std(axis=1) / allowed).max(axis=1)
    shaken[times_ns[:, -1] - times_ns[:, 0] > 1.5e9 * size * period_s] = np.inf  # a gap is in it
    k = int(shaken.argmin())
    if not shaken[k] < SHAKEN:
        return None
    spread, mean = windows[k].std(axis=0), windows[k].mean(axis=0)
    steps = np.array([_step(values[:, :3]), _step(values[:, 3:])])
    white = np.sqrt((np.diff(windows[k], axis=0) ** 2).mean(axis=0) / 2.0).reshape(2, 3).max(axis=1)
    density = np.maximum(white, steps / np.sqrt(12.0)) * np.sqrt(period_s)
    return ImuAtRest(
        at_s=max(0.0, float(times_ns[k, 0] - start_ns) * 1e-9),
        rate_spread_rad_s=_axes(spread[:3]),
        force_spread_m_s2=_axes(spread[3:]),
        mean_rate_rad_s=_axes(mean[:3]),
        mean_force_m_s2=float(np.linalg.norm(mean[3:])),
        gyroscope_noise_density=float(density[0]),
        accelerometer_noise_density=float(density[1]),
        rate_step_rad_s=float(steps[0]),
        force_step_m_s2=float(steps[1]),
    )


def force_unit_m_s2(times_s: Array, values: Array) -> float:
    """Return what a unit of an accelerometer is, as gravity shows: 1, or that of a driver that gives g or mg.

    Without gravity, or in m/s^2, hardly any machine accelerates by one for seconds on end.

    Args:
        times_s: (N,) stamps.
        values: (N, 6) of gyroscope and accelerometer.
    """
    forces = values[np.isfinite(values).all(axis=1), 3:]
    size = max(1, min(_window_size(float(np.median(np.diff(times_s)))), len(forces))) if len(times_s) > 1 else 1
    means = forces[: len(forces) // size * size].reshape(-1, size, 3).mean(axis=1)
    for unit_m_s2 in UNITS_OF_GRAVITY:
        in_g = np.linalg.norm(means, axis=1) * unit_m_s2 / STANDARD_GRAVITY_M_S2
        if len(in_g) and np.mean((in_g > FORCE_IN_G[0]) & (in_g < FORCE_IN_G[1])) > OFTEN:
            return unit_m_s2
    return 1.0


def _window_size(period_s: float) -> int:
    """Return how many samples fill two seconds, 20 at least."""
    return max(MIN_SAMPLES, round(WINDOW_S / max(period_s, 1e-6)))


def _step(readings: Array) -> float:
    """Return the smallest difference between readings (N, 3) of one axis; 0 if none differ."""
    steps = np.concatenate([np.diff(np.unique(axis)) for axis in readings.T])
    return float(steps.min(initial=np.inf, where=steps > SAME_READING)) if (steps > SAME_READING).any() else 0.0


def _axes(values: Array) -> Axes:
    x, y, z = values.tolist()
    return x, y, z


def _row(axes: Axes) -> str:
    return " ".join(f"{value:.2g}" for value in axes)
