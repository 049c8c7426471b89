"""A Kalman filter of the turn joint: its angle, how fast the chassis turns about its axis, and the base gyro's bias.

Three scalars and plain floats, because it runs at every sample: (33) to (35) in docs/math.md. The cabin's gyroscope
drives the angle, the base gyroscope measures the chassis, the encoder the angle; each may be late or absent.
"""

from bisect import bisect_right
from math import ceil, remainder, tau

from holdfast.state import Outcome

TURN_S = 5.0  # how long a turn of the chassis lasts
TURN_DENSITY = 0.1  # [rad/s^2/sqrt(Hz)], how it begins and ends
ANY_RATE = 0.5 * TURN_DENSITY**2 * TURN_S  # [rad^2/s^2], variance of the rate of which nothing is known
STEP_S, MAX_STEPS = 0.05, 500  # a silence is crossed in steps
GATE_SIGMA = 6.0
SILENT_NS = 100_000_000  # after such a silence of the base gyroscope nothing before it is sure any more


class JointFilter:
    """Angle q, rate w of the chassis about the joint's axis, bias b of the base gyroscope about it.

    Args:
        bias_variance: of b at power-on [rad^2/s^2].
        bias_walk: growth of it per second [rad^2/s^3].
        memory_ns: how late a measurement may be.
        believe_after_ns: readings of the angle that contradict the prediction for so long are right after all.
    """

    def __init__(self, bias_variance: float, bias_walk: float, memory_ns: int, believe_after_ns: int) -> None:
        self.stamp_ns: int | None = None
        self.angle_rad = 0.0
        self.rate_rad_s = 0.0
        self.bias_rad_s = 0.0
        self.is_known = False  # whether there was a reading of the angle
        self._bias_walk = bias_walk
        self._memory_ns, self._believe_after_ns = memory_ns, believe_after_ns
        # variances and covariances: angle, angle-rate, angle-bias, rate, rate-bias, bias
        self._P = (0.0, 0.0, 0.0, ANY_RATE, 0.0, bias_variance)
        self._refused_ns: int | None = None  # since when readings are refused
        self._rate_ns: int | None = None  # newest of the base gyroscope
        self._stamps: list[int] = []  # of the recent past, and by how much the joint has turned since the start
        self._turns: list[float] = []

    @property
    def angle_variance(self) -> float:
        """Variance of the angle [rad^2]."""
        return self._P[0]

    @property
    def rate_variance(self) -> float:
        """Variance of the chassis' rate [rad^2/s^2]."""
        return self._P[3]

    @property
    def bias_variance(self) -> float:
        """Variance of the bias [rad^2/s^2]."""
        return self._P[5]

    def predict(self, stamp_ns: int, cabin_rate_rad_s: float, cabin_density2: float) -> None:
        """Go on to a later time, over which the cabin turned at a rate about the axis: (33).

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
        keep = max(0.0, 1.0 - dt / TURN_S)
        qq, qw, qb, ww, wb, bb = self._P
        rate, turned = self.rate_rad_s, 0.0
        for _ in range(steps):
            turned += (cabin_rate_rad_s - rate) * dt
            rate *= keep
            qq += dt * (dt * ww - 2.0 * qw + cabin_density2)
            qb -= dt * wb
            qw = keep * (qw - dt * ww)
            ww = keep * keep * ww + TURN_DENSITY**2 * dt
            wb *= keep
            bb += self._bias_walk * dt
        self._P = (qq, qw, qb, ww, wb, bb)
        self.angle_rad += turned
        self.rate_rad_s = rate
        self.stamp_ns = stamp_ns
        self._remember(turned)

    def add_rate(self, stamp_ns: int, rate_rad_s: float, variance: float) -> None:
        """Take in what the base gyroscope measured, at the filter's time or before: (34)."""
        _, qw, qb, ww, wb, bb = self._P
        S = ww + 2.0 * wb + bb + variance + TURN_DENSITY**2 * self._late_s(stamp_ns)
        self._correct((rate_rad_s - self.rate_rad_s - self.bias_rad_s) / S, S, (qw + qb, ww + wb, wb + bb))
        if self._rate_ns is None or stamp_ns - self._rate_ns > SILENT_NS:
            del self._stamps[:-1], self._turns[:-1]
        self._rate_ns = stamp_ns

    def add_angle(self, stamp_ns: int, angle_rad: float, variance: float, turn_rad: float) -> Outcome:
        """Take in a reading of the encoder, at the filter's time or before; whole turns do not matter: (34).

        What the joint turned since the stamp is added to the reading; what is unsure of that is the chassis' rate.

        Args:
            stamp_ns: of the reading.
            angle_rad: of the joint.
            variance: of the reading [rad^2].
            turn_rad: what `turn_until` says of the stamp.
        """
        if stamp_ns < self._stamps[0]:
            return Outcome.LATE
        angle_rad += self._turns[-1] - turn_rad
        late_s = self._late_s(stamp_ns)
        if not self.is_known:
            self.is_known = True
            return self._start_at(angle_rad, variance, late_s)
        qq, qw, qb, ww, wb, _ = self._P
        covariances = (qq + late_s * qw, qw + late_s * ww, qb + late_s * wb)
        S = covariances[0] + late_s * covariances[1] + variance
        innovation = remainder(angle_rad - self.angle_rad, tau)
        if innovation * innovation > GATE_SIGMA**2 * S:
            self._refused_ns = stamp_ns if self._refused_ns is None else self._refused_ns
            if stamp_ns - self._refused_ns < self._believe_after_ns:
                return Outcome.INNOVATION
            return self._start_at(self.angle_rad + innovation, variance, late_s)
        self._refused_ns = None
        self._correct(innovation / S, S, covariances)
        return Outcome.USED

    def turn_until(self, stamp_ns: int) -> float:
        """Return by how much the joint has turned until a time, as the gyroscopes say, since long ago [rad]."""
        stamps, turns = self._stamps, self._turns
        k = bisect_right(stamps, stamp_ns)
        if k in (0, len(stamps)):
            return turns[min(k, len(stamps) - 1)]
        share = (stamp_ns - stamps[k - 1]) / (stamps[k] - stamps[k - 1])
        return turns[k - 1] + share * (turns[k] - turns[k - 1])

    def _start_at(self, angle_rad: float, variance: float, late_s: float) -> Outcome:
        """Let a reading alone say what the angle is, carried on for some time; the rate may be as wrong as it was."""
        self._refused_ns = None
        self.angle_rad = angle_rad
        self._P = (variance + late_s**2 * ANY_RATE, -late_s * ANY_RATE, 0.0, ANY_RATE, 0.0, self._P[5])
        return Outcome.USED

    def _correct(self, share: float, S: float, covariances: tuple[float, float, float]) -> None:
        """Correct by an innovation over its variance S, given its covariances with angle, rate and bias."""
        a, c, d = covariances
        qq, qw, qb, ww, wb, bb = self._P
        self.angle_rad += a * share
        self.rate_rad_s += c * share
        self.bias_rad_s += d * share
        self._P = (qq - a * a / S, qw - a * c / S, qb - a * d / S, ww - c * c / S, wb - c * d / S, bb - d * d / S)

    def _late_s(self, stamp_ns: int) -> float:
        assert self.stamp_ns is not None
        return max(0, self.stamp_ns - stamp_ns) * 1e-9

    def _remember(self, turned_rad: float) -> None:
        assert self.stamp_ns is not None
        stamps, turns = self._stamps, self._turns
        turns.append((turns[-1] if turns else 0.0) + turned_rad)
        stamps.append(self.stamp_ns)
        if stamps[0] < self.stamp_ns - 2 * self._memory_ns:
            k = bisect_right(stamps, self.stamp_ns - self._memory_ns) - 1
            if k > 0:
                del stamps[:k], turns[:k]
