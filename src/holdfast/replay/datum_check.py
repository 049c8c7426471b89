"""Whether the datum of the configuration lies where the receivers are: far from it, up in W is not up."""

from math import asin, degrees

import numpy as np

from holdfast.config.model import Config
from holdfast.events import Outcome
from holdfast.geometry.earth import SEMI_MAJOR_AXIS_M, Geodetic, LocalFrame
from holdfast.messages import GnssFix, Message
from holdfast.sensors.gnss import GnssModel, point_of
from holdfast.sensors.registry import sensors_of

FAR_M = 100_000.0  # up is 0.9 deg off there


class DatumCheck:
    """Looks at the fixes until one of them is near the datum; without a configured one at none."""

    def __init__(self, config: Config) -> None:
        datum = config.frames.datum
        self._receivers: dict[str, GnssModel] = {}
        if datum is not None:
            self._datum = datum.point
            self._receivers = {name: one for name, one in sensors_of(config).items() if isinstance(one, GnssModel)}
        self._nearest: tuple[float, Geodetic] | None = None

    def add(self, message: Message) -> None:
        """Look at a message; only usable fixes count."""
        receiver = self._receivers.get(message.sensor)
        if receiver is None or not isinstance(message, GnssFix) or receiver.check(message) is not Outcome.USED:
            return
        point = point_of(message)
        distance_m = _distance_m(self._datum, point)
        if self._nearest is None or distance_m < self._nearest[0]:
            self._nearest = distance_m, point
        if distance_m < FAR_M:
            self._receivers = {}

    @property
    def warning(self) -> str | None:
        """Say that all fixes until now are far from the datum, None if they are not."""
        if self._nearest is None or self._nearest[0] < FAR_M:
            return None
        distance_m, point = self._nearest
        tilt_deg = degrees(2.0 * asin(min(1.0, distance_m / (2.0 * SEMI_MAJOR_AXIS_M))))
        swapped = self._datum._replace(latitude_deg=self._datum.longitude_deg, longitude_deg=self._datum.latitude_deg)
        is_swapped = abs(swapped.latitude_deg) <= 90.0 and _distance_m(swapped, point) < FAR_M
        question = "are latitude and longitude swapped?" if is_swapped else "is it that of another site?"
        return (
            f"frames.datum: every fix is {distance_m * 1e-3:,.0f} km or more from it, the nearest at "
            f"{point.latitude_deg:.4f}, {point.longitude_deg:.4f}; up in the world is {tilt_deg:.1f} deg off there: "
            f"{question}"
        )


def _distance_m(datum: Geodetic, point: Geodetic) -> float:
    return float(np.linalg.norm(LocalFrame(datum).to_enu(point)))
