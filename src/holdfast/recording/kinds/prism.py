"""Positions of a prism, measured by a total station."""

from typing import Any

import numpy as np

from holdfast.config.assignment import Rule
from holdfast.messages import PointPosition
from holdfast.recording.columns import Columns, axes, diagonal
from holdfast.recording.decode import POINT, POSE_COVARIANCE, decoder, known_covariance, point_of, xyz
from holdfast.recording.kinds import COMMAND, DERIVED, Kind, register


@decoder
def position_decoder(stamp_ns: int, arrival_ns: int, sensor: str, message: Any) -> PointPosition:
    """Decode geometry_msgs/PointStamped or the position of geometry_msgs/PoseWithCovarianceStamped."""
    point, covariance = point_of(message)
    known = None if covariance is None else known_covariance(covariance[:3, :3], 3)
    return PointPosition(stamp_ns, arrival_ns, sensor, xyz(point), known)


def _of_line(stamp_ns: int, arrival_ns: int, sensor: str, v: list[float]) -> PointPosition:
    return PointPosition(stamp_ns, arrival_ns, sensor, np.array(v[:3]), diagonal(v[3:]))


register(
    Kind(
        "prism",
        PointPosition,
        {POINT: position_decoder, POSE_COVARIANCE: position_decoder},
        Columns(axes("?_m"), _of_line, (axes("sigma_?_m"),)),
        rules=(
            Rule("prism", ("prism", "total_station", "leica", "tps"), (*DERIVED, *COMMAND), named=True, every=True),
        ),
        gap="the position drifts with odometry and IMU meanwhile",
        rank=60,
    )
)
