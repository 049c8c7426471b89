"""A Kalman filter of the turn joint: its angle, how fast the chassis turns, and what is wrong with two sensors.

Four scalars and plain floats, because it runs at every sample: (33) and (34) in docs/math.md. The cabin's gyroscope
drives the angle, the base gyroscope measures the chassis, the encoder the angle; each may be late or absent.
"""

from bisect import bisect_right
from math import ceil, remainder, tau

from holdfast.chassis.base_gyro import BaseGyro
from holdfast.state import Outcome

ROTATION_S = 5.0  # how long the chassis goes on rotating, where nothing else is known
RATE_WALK_RAD_S_SQRT_S = 0.1  # how its rotation begins and ends
ANY_RATE_RAD2_S2 = 0.5 * RATE_WALK_RAD_S_SQRT_S**2 * ROTATION_S  # variance of a rate of which nothing is known
LAG_SIGMA_S, LAG_WALK_S_SQRT_S = 0.02, 1e-3  # of the encoder's stamps
MAX_LAG_S = 0.2
LAG_RATE_RAD_S = 0.05  # slower rotation shows noise rather than the lag
STEP_S, MAX_STEPS = 0.05, 500  # a silence is crossed in steps
GATE_SIGMA = 6.0
SILENT_NS = 100_000_000  # after such a silence of the base gyroscope nothing before it is sure any more


class JointFilter:
    """Angle q, rate w of the chassis about the joint's axis, bias b of the base gyroscope, lag l of the encoder.

    Args:
        gyro: the base gyroscope; without one b and l cannot be observed.
        memory_ns: how late a measurement may be.
        accept_after_ns: readings of the angle that contradict the prediction for so long are accepted.
    """

    def __init__(self, gyro: BaseGyro | None, memory_ns: int, accept_after_ns: int) -> None:
        self.stamp_ns: int | None = None
        self.angle_rad = self.rate_rad_s = self.bias_rad_s = self.lag_s = 0.0
        self.is_known = False  # whether there was a reading of the angle
        bias_variance, self._bias_walk, lag_variance, self._lag_walk = 0.0, 0.0, 0.0, 0.0
        if gyro is not None:
            bias_variance, self._bias_walk = gyro.bias_variance, gyro.walk_variance
            lag_variance, self._lag_walk = LAG_SIGMA_S**2, LAG_WALK_S_SQRT_S**2
        self._memory_ns, self._accept_after_ns = memory_ns + round(MAX_LAG_S * 1e9), accept_after_ns
        # the upper triangle of the covariance of q, w, b, l, row by row
        self._P = (0.0, 0.0, 0.0, 0.0, ANY_RATE_RAD2_S2, 0.0, 0.0, bias_variance, 0.0, lag_variance)
        self._refused_ns: int | None = None  # since when readings are refused
        self._rate_ns: int | None = None  # newest of the base gyroscope
        self._stamps: list[int] = []  # of the recent past, and by how much the joint has turned since the start
        self._rotations_rad: list[float] = []
        self._joint_rate_rad_s = 0.0

    @property
    def angle_variance(self) -> float:
        """Variance of the angle [rad^2]."""
        return max(self._P[0], 0.0)

    @property
    def rate_variance(self) -> float:
        """Variance of the chassis' rate [rad^2/s^2]."""
        return max(self._P[4], 0.0)

    @property
    def bias_variance(self) -> float:
        """Variance of the bias [rad^2/s^2]."""
        return max(self._P[7], 0.0)

    def predict(self, stamp_ns: int, cabin_rate_rad_s: float, cabin_density2: float) -> None:
        """Go on to a later time, over which the cabin rotated at a rate about the axis: (33).

        Args:
            stamp_ns: the time; an earlier one changes nothing.
            cabin_rate_rad_s: mean rate of the cabin, its bias removed.
            cabin_density2: noise of that rate [rad^2/s].
        """
        if self.stamp_ns is None:
            self.stamp_ns = stamp_ns
            self._remember(0.0)
            return
        whole_s = (stamp_ns - self.stamp_ns) * 1e-9
        if whole_s <= 0.0:
            return
        steps = 1 if whole_s <= STEP_S else min(ceil(whole_s / STEP_S), MAX_STEPS)
        dt = whole_s / steps
        keep = 1.0 if self._has_gyro(stamp_ns) else max(0.0, 1.0 - dt / ROTATION_S)
        qq, qw, qb, ql, ww, wb, wl, bb, bl, ll = self._P
        rate, turned = self.rate_rad_s, 0.0
        for _ in range(steps):
            turned += (cabin_rate_rad_s - rate) * dt
            rate *= keep
            qq += dt * (dt * ww - 2.0 * qw + cabin_density2)
            qb -= dt * wb
            ql -= dt * wl
            qw = keep * (qw - dt * ww)
            ww = keep * keep * ww + RATE_WALK_RAD_S_SQRT_S**2 * dt
            wb *= keep
            wl *= keep
        bb += self._bias_walk * whole_s
        ll += self._lag_walk * whole_s
        self._P = (qq, qw, qb, ql, ww, wb, wl, bb, bl, ll)
        self.angle_rad += turned
        self.rate_rad_s = rate
        self.stamp_ns = stamp_ns
        self._joint_rate_rad_s = cabin_rate_rad_s - rate
        self._remember(turned)

    def add_rate(self, stamp_ns: int, rate_rad_s: float, variance: float) -> None:
        """Take in what the base gyroscope measured, at the filter's time or before: (34)."""
        _, qw, qb, _, ww, wb, wl, bb, bl, _ = self._P
        S = ww + 2.0 * wb + bb + variance + RATE_WALK_RAD_S_SQRT_S**2 * self._since_s(stamp_ns)
        self._correct((rate_rad_s - self.rate_rad_s - self.bias_rad_s) / S, S, (qw + qb, ww + wb, wb + bb, wl + bl))
        if self._rate_ns is None or stamp_ns - self._rate_ns > SILENT_NS:
            del self._stamps[:-1], self._rotations_rad[:-1]
        self._rate_ns = max(stamp_ns, self._rate_ns or stamp_ns)

    def rotation_until(self, stamp_ns: int) -> float:
        """Return by how much the joint had turned when a reading with a stamp was taken, since long ago [rad]."""
        stamps, rotations = self._stamps, self._rotations_rad
        taken_ns = stamp_ns - round(self.lag_s * 1e9)
        k = bisect_right(stamps, taken_ns)
        if k == len(stamps):
            return rotations[-1] + self._joint_rate_rad_s * (taken_ns - stamps[-1]) * 1e-9
        if k == 0:
            return rotations[0]
        fraction = (taken_ns - stamps[k - 1]) / (stamps[k] - stamps[k - 1])
        return rotations[k - 1] + fraction * (rotations[k] - rotations[k - 1])

    def add_angle(self, stamp_ns: int, angle_rad: float, variance: float, rotation_rad: float) -> Outcome:
        """Take in a reading of the encoder, at the filter's time or before; whole rotations do not matter: (34).

        What the joint turned since it was taken is added to the reading.

        Args:
            stamp_ns: of the reading.
            angle_rad: of the joint.
            variance: of the reading [rad^2].
            rotation_rad: what `rotation_until` says of the stamp.
        """
        taken_ns = stamp_ns - round(self.lag_s * 1e9)
        if taken_ns < self._stamps[0]:
            return Outcome.LATE
        since_s = self._since_s(taken_ns)
        angle_rad += self._rotations_rad[-1] - rotation_rad
        if not self.is_known:
            self.is_known = True
            return self._start_at(angle_rad, variance, since_s)
        qq, qw, qb, ql, ww, wb, wl, _, bl, ll = self._P
        joint_rate = self._joint_rate_rad_s
        shows_lag = abs(joint_rate) > LAG_RATE_RAD_S and self._has_gyro(stamp_ns)
        if not shows_lag:
            joint_rate = 0.0
        a = qq + since_s * qw - joint_rate * ql
        c = qw + since_s * ww - joint_rate * wl
        d = qb + since_s * wb - joint_rate * bl
        e = ql + since_s * wl - joint_rate * ll
        S = a + since_s * c - joint_rate * e + variance
        innovation = remainder(angle_rad - self.angle_rad, tau)
        if innovation * innovation > GATE_SIGMA**2 * S:
            self._refused_ns = stamp_ns if self._refused_ns is None else self._refused_ns
            if stamp_ns - self._refused_ns < self._accept_after_ns:
                return Outcome.INNOVATION
            return self._start_at(self.angle_rad + innovation, variance, since_s)
        self._refused_ns = None
        self._correct(innovation / S, S, (a, c, d, e), moves_lag=shows_lag)
        return Outcome.USED

    def _start_at(self, angle_rad: float, variance: float, since_s: float) -> Outcome:
        """Let a reading alone say what the angle is, carried on for some time; the rate may be as wrong as it was."""
        self._refused_ns = None
        self.angle_rad = angle_rad
        *_, bb, _, ll = self._P
        qw, ql = -since_s * ANY_RATE_RAD2_S2, self._joint_rate_rad_s * ll
        qq = variance - since_s * qw + self._joint_rate_rad_s * ql
        self._P = (qq, qw, 0.0, ql, ANY_RATE_RAD2_S2, 0.0, 0.0, bb, 0.0, ll)
        return Outcome.USED

    def _correct(
        self, weighted: float, S: float, covariances: tuple[float, float, float, float], *, moves_lag: bool = False
    ) -> None:
        """Correct by an innovation over its variance S, given its covariances with the state.

        A lag that is not moved keeps its variance, too (Schmidt's consider filter).
        """
        a, c, d, e = covariances
        qq, qw, qb, ql, ww, wb, wl, bb, bl, ll = self._P
        self.angle_rad += a * weighted
        self.rate_rad_s += c * weighted
        self.bias_rad_s += d * weighted
        if moves_lag:
            self.lag_s = min(max(self.lag_s + e * weighted, -MAX_LAG_S), MAX_LAG_S)
            ll -= e * e / S
        A, C, D = a / S, c / S, d / S
        row_q, row_w = (qq - a * A, qw - c * A, qb - d * A, ql - e * A), (ww - c * C, wb - d * C, wl - e * C)
        self._P = row_q + row_w + (bb - d * D, bl - e * D, ll)

    def _has_gyro(self, stamp_ns: int) -> bool:
        """Whether the base gyroscope says how the chassis rotates; else a lag of the encoder looks like a rotation."""
        return self._rate_ns is not None and stamp_ns - self._rate_ns < SILENT_NS

    def _since_s(self, stamp_ns: int) -> float:
        assert self.stamp_ns is not None
        return max(0, self.stamp_ns - stamp_ns) * 1e-9

    def _remember(self, turned_rad: float) -> None:
        assert self.stamp_ns is not None
        stamps, rotations = self._stamps, self._rotations_rad
        rotations.append((rotations[-1] if rotations else 0.0) + turned_rad)
        stamps.append(self.stamp_ns)
        if stamps[0] < self.stamp_ns - 2 * self._memory_ns:
            k = bisect_right(stamps, self.stamp_ns - self._memory_ns) - 1
            if k > 0:
                del stamps[:k], rotations[:k]
