"""Heights of a laser receiver or a barometer."""

from typing import Any

from holdfast.config.assignment import Rule
from holdfast.messages import Height
from holdfast.recording.columns import Columns, positive
from holdfast.recording.decode import POINT, POSE, POSE_COVARIANCE, decoder, point_of, sigma_of
from holdfast.recording.kinds import COMMAND, DERIVED, Kind, register


@decoder
def height_decoder(stamp_ns: int, arrival_ns: int, sensor: str, message: Any) -> Height:
    """Decode z of geometry_msgs/PointStamped, PoseStamped or PoseWithCovarianceStamped."""
    point, covariance = point_of(message)
    sigma_m = None if covariance is None else sigma_of(covariance[2, 2])
    return Height(stamp_ns, arrival_ns, sensor, float(point.z), sigma_m)


def _of_line(stamp_ns: int, arrival_ns: int, sensor: str, v: list[float]) -> Height:
    return Height(stamp_ns, arrival_ns, sensor, v[0], positive(v[1]))


register(
    Kind(
        "height",
        Height,
        {POINT: height_decoder, POSE: height_decoder, POSE_COVARIANCE: height_decoder},
        Columns(("height_m",), _of_line, (("sigma_m",),)),
        rules=(Rule("height", ("height", "altitude", "elevation"), (*DERIVED, *COMMAND), named=True, every=True),),
        gap="the other sensors alone carry the height meanwhile",
        rank=70,
    )
)
