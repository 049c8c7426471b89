"""Health in one word, and what is being fused: from what entered the graph and when."""

from collections.abc import Collection

from holdfast.config.model import Config
from holdfast.config.sensors import DriftingConfig, InertialConfig, JointConfig, PositionConfig
from holdfast.events import Health, HealthReport

FUSED_NS = 1_000_000_000  # what entered so recently counts as being fused
RESET_NS = 1_000_000_000  # a reset is reported for so long
RECOVERY_NS = 2_000_000_000  # after GNSS is regained the world may still move for so long
NEVER_NS = -1
NOISE_STEPS = 1000


class HealthMonitor:
    """Keeps when each sensor last entered the graph, and the latest resets and recoveries."""

    def __init__(self, config: Config) -> None:
        sensors = config.sensors
        self.names = [name for name, one in sensors.items() if not isinstance(one, InertialConfig | JointConfig)]
        self._imu = config.imu_name
        self._receivers = frozenset(config.sensors_of(PositionConfig))
        self._silence_ns = {name: round(one.silence_s * 1e9) for name, one in config.sensors_of(DriftingConfig).items()}
        self._entered_ns: dict[str, int] = {}
        self._noise: dict[str, float] = {}
        self._started_ns: int | None = None
        self._doubts_arms = False
        self._reset_ns = self._recovered_ns = -RESET_NS - RECOVERY_NS

    def start(self, stamp_ns: int, *, doubts_arms: bool = False) -> None:
        """The first state is there; whether lever arms are in doubt."""
        self._started_ns, self._doubts_arms = stamp_ns, doubts_arms
        self._entered_ns.clear()

    def stop(self) -> None:
        """The estimator starts over."""
        self._started_ns = None

    def entered(self, sensor: str, stamp_ns: int) -> None:
        """A measurement entered the graph."""
        self._entered_ns[sensor] = max(stamp_ns, self._entered_ns.get(sensor, stamp_ns))

    def note_noise(self, sensor: str, ratio: float) -> None:
        """The noise of a sensor is so many times what it claims."""
        self._noise[sensor] = ratio

    def noise(self, sensor: str) -> float:
        """Return how many times larger the noise of a sensor is than it claims."""
        return self._noise.get(sensor, 1.0)

    def reset(self, stamp_ns: int) -> None:
        """The optimiser failed and the graph was anchored anew."""
        self._reset_ns = stamp_ns

    def recovered(self, stamp_ns: int) -> None:
        """GNSS was regained."""
        self._recovered_ns = stamp_ns

    def snapshot(self) -> tuple[int, ...]:
        """Return what there is to know, for the monitor of another process: 3 stamps, a flag, 2 numbers per sensor."""
        started_ns = NEVER_NS if self._started_ns is None else self._started_ns
        entered_ns = (self._entered_ns.get(name, NEVER_NS) for name in self.names)
        noise = (round(self.noise(name) * NOISE_STEPS) for name in self.names)
        return (started_ns, self._reset_ns, self._recovered_ns, int(self._doubts_arms), *entered_ns, *noise)

    def restore(self, snapshot: tuple[int, ...]) -> None:
        """Know what another monitor knew."""
        started_ns, self._reset_ns, self._recovered_ns, doubts_arms, *rest = snapshot
        self._doubts_arms = bool(doubts_arms)
        entered_ns, noise = rest[: len(self.names)], rest[len(self.names) :]
        self._noise = {name: number / NOISE_STEPS for name, number in zip(self.names, noise, strict=True)}
        self._started_ns = None if started_ns == NEVER_NS else started_ns
        known = zip(self.names, entered_ns, strict=True)
        self._entered_ns = {name: stamp_ns for name, stamp_ns in known if stamp_ns != NEVER_NS}

    def assess(self, now_ns: int, *, has_imu: bool, is_lost: bool, lost: Collection[str]) -> Health:
        """Return the health at a time.

        Args:
            now_ns: of the estimate.
            has_imu: the estimate comes from the IMU.
            is_lost: no receiver of positions is trusted.
            lost: the sensors that are not trusted.
        """
        if self._started_ns is None:
            return Health.INITIALISING
        has_odometry = not self._silence_ns or not all(self._is_silent(one, now_ns, lost) for one in self._silence_ns)
        truths = (
            (now_ns - self._reset_ns < RESET_NS, Health.OPTIMISER_RESET),
            (not has_imu, Health.IMU_GAP),
            (is_lost, Health.FALLBACK),
            (now_ns - self._recovered_ns < RECOVERY_NS, Health.RECOVERING),
            (not has_odometry, Health.ODOMETRY_LOST),
            (not self._receivers.isdisjoint(lost), Health.GNSS_DEGRADED),
            (self._doubts_arms, Health.LEVER_ARM),
            (not self._receivers.issuperset(lost), Health.SENSOR_LOST),
        )
        return next((health for is_true, health in truths if is_true), Health.NOMINAL)

    def report(self, now_ns: int, health: Health) -> HealthReport:
        """Return the health with what it rests on."""
        ages_ns = {name: now_ns - self._entered_ns[name] for name in self.names if name in self._entered_ns}
        fused = tuple(name for name, age_ns in ages_ns.items() if age_ns < FUSED_NS)
        ages_s = {name: age_ns * 1e-9 for name, age_ns in ages_ns.items()}
        noise = {name: ratio for name, ratio in self._noise.items() if ratio != 1.0}
        return HealthReport(now_ns, health, (self._imu, *fused), ages_s, noise)

    def _is_silent(self, odometry: str, now_ns: int, lost: Collection[str]) -> bool:
        """Whether nothing of an odometry enters; of one that is slow nothing is missing until it is lost."""
        if self._started_ns is None or (odometry in self._entered_ns and odometry not in lost):
            return False
        return now_ns - self._entered_ns.get(odometry, self._started_ns) > self._silence_ns[odometry]
