"""Health in one word, and what is being fused: from what entered the graph and when."""

from holdfast.config.model import Config
from holdfast.state import Health, HealthReport

FUSED_NS = 1_000_000_000  # what entered so recently counts as being fused
RESET_NS = 1_000_000_000  # a reset is told for so long
RECOVERY_NS = 2_000_000_000  # after GNSS is regained the world may still move for so long
FUSING = ("gnss", "gnss_right", "heading", "lidar")
NEVER = -1


class HealthMonitor:
    """Keeps when each sensor last entered the graph, and the latest resets and recoveries."""

    def __init__(self, config: Config) -> None:
        sensors = config.sensors
        self._expected = [name for name in FUSING if getattr(sensors, name) is not None]
        self._lidar_silence_ns = 0 if sensors.lidar is None else round(2e9 * sensors.lidar.max_interval_s)
        self._entered: dict[str, int] = {}
        self._started_ns: int | None = None
        self._reset_ns = self._recovered_ns = -RESET_NS - RECOVERY_NS

    def start(self, stamp_ns: int) -> None:
        """The first state is there."""
        self._started_ns = stamp_ns
        self._entered.clear()

    def stop(self) -> None:
        """The estimator starts over."""
        self._started_ns = None

    def entered(self, sensor: str, stamp_ns: int) -> None:
        """A measurement entered the graph."""
        self._entered[sensor] = max(stamp_ns, self._entered.get(sensor, stamp_ns))

    def reset(self, stamp_ns: int) -> None:
        """The optimiser failed and the graph was anchored anew."""
        self._reset_ns = stamp_ns

    def recovered(self, stamp_ns: int) -> None:
        """GNSS was regained."""
        self._recovered_ns = stamp_ns

    def snapshot(self) -> tuple[int, ...]:
        """Return what there is to know, for the monitor of another process: see `restore`."""
        started_ns = NEVER if self._started_ns is None else self._started_ns
        return (started_ns, self._reset_ns, self._recovered_ns, *(self._entered.get(name, NEVER) for name in FUSING))

    def restore(self, snapshot: tuple[int, ...]) -> None:
        """Know what another monitor knew."""
        started_ns, self._reset_ns, self._recovered_ns, *entered = snapshot
        self._started_ns = None if started_ns == NEVER else started_ns
        self._entered = {name: stamp for name, stamp in zip(FUSING, entered, strict=True) if stamp != NEVER}

    def assess(self, now_ns: int, *, hears_imu: bool, is_lost: bool, antenna_lost: bool) -> Health:
        """Return the health at a time.

        Args:
            now_ns: of the estimate.
            hears_imu: the estimate comes from the IMU.
            is_lost: no antenna is trusted.
            antenna_lost: at least one is not.
        """
        if self._started_ns is None:
            return Health.INITIALISING
        truths = {
            Health.OPTIMISER_RESET: now_ns - self._reset_ns < RESET_NS,
            Health.IMU_GAP: not hears_imu,
            Health.FALLBACK: is_lost,
            Health.RECOVERING: now_ns - self._recovered_ns < RECOVERY_NS,
            Health.LIDAR_LOST: self._is_lidar_lost(now_ns),
            Health.GNSS_DEGRADED: antenna_lost,
        }
        return next((health for health, is_true in truths.items() if is_true), Health.NOMINAL)

    def report(self, now_ns: int, health: Health) -> HealthReport:
        """Return the health with what it rests on."""
        ages_ns = {name: now_ns - self._entered[name] for name in self._expected if name in self._entered}
        fused = tuple(name for name, age_ns in ages_ns.items() if age_ns < FUSED_NS)
        return HealthReport(now_ns, health, ("imu", *fused), {name: age * 1e-9 for name, age in ages_ns.items()})

    def _is_lidar_lost(self, now_ns: int) -> bool:
        if "lidar" not in self._expected or self._started_ns is None:
            return False
        return now_ns - self._entered.get("lidar", self._started_ns) > self._lidar_silence_ns
