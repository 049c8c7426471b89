"""Absolute poses of a map matcher or of markers."""

from holdfast.config.assignment import Rule
from holdfast.messages import SensorPose
from holdfast.recording.columns import POSE_COLUMNS
from holdfast.recording.decode import POSE_DECODERS
from holdfast.recording.kinds import COMMAND, DERIVED, Kind, register

WORDS = ("localiz", "localis", "amcl", "ndt", "map_match", "matcher", "marker", "apriltag", "aruco")

register(
    Kind(
        "pose",
        SensorPose,
        POSE_DECODERS,
        POSE_COLUMNS,
        rules=(Rule("pose", WORDS, (*DERIVED, *COMMAND, "initial"), named=True, every=True),),
        gap="the position drifts with odometry and IMU meanwhile",
        rank=50,
    )
)
