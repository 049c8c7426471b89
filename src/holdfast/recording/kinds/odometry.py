"""Poses that drift: odometry of a lidar, a camera or wheels."""

from holdfast.config.assignment import Rule
from holdfast.messages import SensorPose
from holdfast.recording.columns import POSE_COLUMNS
from holdfast.recording.decode import ODOMETRY, POSE_DECODERS
from holdfast.recording.kinds import CHASSIS, COMMAND, DERIVED, SATELLITE, WHEEL, Kind, register

VISUAL = ("camera", "visual", "vio", "stereo")

register(
    Kind(
        "odometry",
        SensorPose,
        POSE_DECODERS,
        POSE_COLUMNS,
        rules=(
            Rule(
                "lidar",
                ("lidar", "laser", "icp", "slam", "loam", "lio", "scan", "odom"),
                (*CHASSIS, *DERIVED, *VISUAL, *WHEEL, *SATELLITE, *COMMAND),
                every=True,
            ),
            Rule("camera", VISUAL, (*DERIVED, *COMMAND), named=True, every=True),
            Rule("wheels", WHEEL, (*DERIVED, *VISUAL, *COMMAND), named=True, every=True, types=(ODOMETRY,)),
        ),
        gap="the other sensors alone carry the estimate meanwhile",
        rank=30,
    )
)
