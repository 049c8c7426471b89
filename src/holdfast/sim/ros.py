"""Readings as standard ROS 2 messages."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from holdfast.geometry.earth import LocalFrame
from holdfast.messages import FixStatus
from holdfast.sim.datasheets import SimulatedImu, SimulatedJoint, SimulatedSensor
from holdfast.sim.gnss import Quality
from holdfast.sim.readings import Readings

NS_PER_S = 1_000_000_000
ABSENT = np.array([-1.0, *[0.0] * 8])  # REP-145: this field is not measured
DIAGONAL_KNOWN = 2  # NavSatFix.position_covariance_type
STATUS = {Quality.NONE: FixStatus.NO_FIX, Quality.SINGLE: FixStatus.FIX, Quality.RTK_FLOAT: FixStatus.GBAS}
GPS_GLONASS_GALILEO = 1 | 2 | 8

Encode = Callable[[int, int], Any]
"""Makes the message of a row with a stamp [ns]."""


class RosMessages:
    """Makes message objects of the types of a typestore."""

    def __init__(self, types: Mapping[str, Any], world: LocalFrame) -> None:
        self._types = types
        self._world = world

    def encoder(self, name: str, sheet: SimulatedSensor, readings: Readings) -> tuple[str, Encode]:
        """Return the type of a sensor's messages, and what makes one of a row and a stamp."""
        if isinstance(sheet, SimulatedImu):
            return "sensor_msgs/msg/Imu", self._imu(sheet, readings)
        if isinstance(sheet, SimulatedJoint):
            return "sensor_msgs/msg/JointState", self._joint(sheet, readings)
        if name == "heading":
            return "sensor_msgs/msg/Imu", self._heading(sheet, readings)
        if name == "lidar":
            return "nav_msgs/msg/Odometry", self._odometry(sheet, readings)
        return "sensor_msgs/msg/NavSatFix", self._fix(sheet, readings)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        """Return a std_msgs/Header."""
        time = self._types["builtin_interfaces/msg/Time"](sec=stamp_ns // NS_PER_S, nanosec=stamp_ns % NS_PER_S)
        return self._types["std_msgs/msg/Header"](stamp=time, frame_id=frame_id)

    def transforms(self, stamp_ns: int, poses: Mapping[tuple[str, str], tuple[Any, Any]]) -> Any:
        """Return a tf2_msgs/TFMessage of (parent, child) -> (translation, quaternion x, y, z, w)."""
        stamped, transform = (self._types[f"geometry_msgs/msg/{name}"] for name in ("TransformStamped", "Transform"))
        return self._types["tf2_msgs/msg/TFMessage"](
            transforms=[
                stamped(
                    header=self.header(stamp_ns, parent),
                    child_frame_id=child,
                    transform=transform(translation=self._vector(place), rotation=self._quaternion(turn)),
                )
                for (parent, child), (place, turn) in poses.items()
            ]
        )

    def _vector(self, values: Any) -> Any:
        x, y, z = values
        return self._types["geometry_msgs/msg/Vector3"](x=float(x), y=float(y), z=float(z))

    def _quaternion(self, values: Any) -> Any:
        x, y, z, w = values
        return self._types["geometry_msgs/msg/Quaternion"](x=float(x), y=float(y), z=float(z), w=float(w))

    def _imu(self, sheet: SimulatedImu, readings: Readings) -> Encode:
        imu, no_orientation = self._types["sensor_msgs/msg/Imu"], self._quaternion((0.0, 0.0, 0.0, 1.0))
        rates, forces = readings.values["angular_velocity"].tolist(), readings.values["specific_force"].tolist()
        of_rate = np.eye(3).ravel() * sheet.gyroscope_noise_density**2 * sheet.rate_hz
        of_force = np.eye(3).ravel() * sheet.accelerometer_noise_density**2 * sheet.rate_hz
        return lambda row, stamp_ns: imu(
            header=self.header(stamp_ns, sheet.frame),
            orientation=no_orientation,
            orientation_covariance=ABSENT,
            angular_velocity=self._vector(rates[row]),
            angular_velocity_covariance=of_rate,
            linear_acceleration=self._vector(forces[row]),
            linear_acceleration_covariance=of_force,
        )

    def _heading(self, sheet: SimulatedSensor, readings: Readings) -> Encode:
        imu, nothing = self._types["sensor_msgs/msg/Imu"], self._vector((0.0, 0.0, 0.0))
        half, sigmas = readings.values["yaw_rad"] / 2.0, readings.values["sigma_rad"]
        unknown = np.pi**2

        def encode(row: int, stamp_ns: int) -> Any:
            return imu(
                header=self.header(stamp_ns, sheet.frame),
                orientation=self._quaternion((0.0, 0.0, np.sin(half[row]), np.cos(half[row]))),
                orientation_covariance=np.diag([unknown, unknown, sigmas[row] ** 2]).ravel(),
                angular_velocity=nothing,
                angular_velocity_covariance=ABSENT,
                linear_acceleration=nothing,
                linear_acceleration_covariance=ABSENT,
            )

        return encode

    def _joint(self, sheet: SimulatedJoint, readings: Readings) -> Encode:
        state, angles = self._types["sensor_msgs/msg/JointState"], readings.values["angle_rad"]
        nothing = np.zeros(0)
        return lambda row, stamp_ns: state(
            header=self.header(stamp_ns, sheet.frame),
            name=[sheet.joint_name],
            position=angles[row : row + 1],
            velocity=nothing,
            effort=nothing,
        )

    def _fix(self, sheet: SimulatedSensor, readings: Readings) -> Encode:
        fix, status = (self._types[f"sensor_msgs/msg/{name}"] for name in ("NavSatFix", "NavSatStatus"))
        columns = (readings.values[name] for name in ("position", "sigma", "quality"))
        positions, sigmas, qualities = columns

        def encode(row: int, stamp_ns: int) -> Any:
            point = self._world.to_geodetic(positions[row])
            quality = STATUS.get(qualities[row], FixStatus.GBAS)
            return fix(
                header=self.header(stamp_ns, sheet.frame),
                status=status(status=int(quality), service=GPS_GLONASS_GALILEO),
                latitude=point.latitude_deg,
                longitude=point.longitude_deg,
                altitude=point.altitude_m,
                position_covariance=np.diag(sigmas[row] ** 2).ravel(),
                position_covariance_type=DIAGONAL_KNOWN,
            )

        return encode

    def _odometry(self, sheet: SimulatedSensor, readings: Readings) -> Encode:
        names = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovariance", "geometry_msgs/msg/Pose")
        odometry, with_covariance, pose = (self._types[name] for name in names)
        point, twist = (self._types[f"geometry_msgs/msg/{name}"] for name in ("Point", "Twist"))
        positions, quaternions = readings.values["position"].tolist(), readings.values["quaternion"].tolist()
        covariances = readings.values["covariance"]
        unknown_twist = self._types["geometry_msgs/msg/TwistWithCovariance"](
            twist=twist(linear=self._vector((0.0, 0.0, 0.0)), angular=self._vector((0.0, 0.0, 0.0))),
            covariance=np.zeros(36),
        )

        def encode(row: int, stamp_ns: int) -> Any:
            x, y, z = positions[row]
            return odometry(
                header=self.header(stamp_ns, f"{sheet.frame}_odom"),
                child_frame_id=sheet.frame,
                pose=with_covariance(
                    pose=pose(position=point(x=x, y=y, z=z), orientation=self._quaternion(quaternions[row])),
                    covariance=np.diag(covariances[row]).ravel(),
                ),
                twist=unknown_twist,
            )

        return encode
