"""Why an estimator never started: what was missing, what came, what was refused, and the key to change."""

from collections.abc import Mapping

from holdfast.config.model import Config
from holdfast.events import Outcome
from holdfast.replay.published import by_sensor

KEYS: Mapping[str, tuple[str, ...]] = {  # outcome -> the keys of a sensor's section that decide it
    Outcome.LARGE_COVARIANCE: ("max_sigma_m",),
    Outcome.LOW_STATUS: ("min_status",),
    Outcome.NO_COVARIANCE: ("default_sigma_m",),
    Outcome.OUT_OF_RANGE: ("accelerometer_range", "gyroscope_range"),
}


def never_started(waiting_for: str, counts: Mapping[tuple[str, Outcome], int], config: Config) -> str:
    """Return the reason with the counts of every sensor, in one line.

    Args:
        waiting_for: what kept the estimator from starting.
        counts: of measurements by sensor and outcome.
        config: of the estimator.
    """
    found = by_sensor(counts)
    parts = [
        f"{name}: {_outcomes(name, found.get(name, {}), config)}" for name, one in config.sensors.items() if one.topic
    ]
    return f"{waiting_for}. Received: {'; '.join(parts)}"


def _outcomes(name: str, outcomes: Mapping[str, int], config: Config) -> str:
    section = config.sensors[name]
    texts = []
    for outcome, count in outcomes.items():
        keys = [
            f"sensors.{name}.{key} = {getattr(section, key)}" for key in KEYS.get(outcome, ()) if hasattr(section, key)
        ]
        texts.append(f"{count} {outcome}" + (f" ({', '.join(keys)})" if keys else ""))
    return ", ".join(texts) or "nothing"
