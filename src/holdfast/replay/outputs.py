"""The files of a replay: trajectories, ROS messages and events, written as they come so that nothing is lost."""

import json
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Self

from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.estimator.base import BaseGeometry
from holdfast.estimator.estimator import Estimator, Output
from holdfast.recording.cdr import OdometryEncoder
from holdfast.recording.mcap_writer import McapWriter
from holdfast.recording.tum import TumWriter
from holdfast.replay.frame_transforms import FrameTransforms, translation_and_quaternion
from holdfast.replay.ros import base_odometry, odometry, quaternion_xyzw
from holdfast.state import BaseState, Estimate, Event, Health

ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
DIAGNOSTICS_PERIOD_NS = 1_000_000_000


class Outputs:
    """Writes into a folder what the estimator says; a context manager."""

    def __init__(self, folder: Path, config: Config) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"{folder}: cannot be made a folder for the output ({error.strerror})") from None
        self.folder = folder
        imu = config.sensors.imu
        self._geometry = BaseGeometry(config) if config.has_base() else None
        names = ["imu_in_world", "imu_in_odom", "optimized_in_world", "smoothed_in_world"]
        names += ["base_in_world", "base_in_odom"] if self._geometry is not None else []
        with ExitStack() as stack:
            try:
                self._tracks = {name: stack.enter_context(TumWriter(folder / f"{name}.tum")) for name in names}
                self._mcap = stack.enter_context(McapWriter(folder / "estimates.mcap"))
                self._events = stack.enter_context((folder / "events.jsonl").open("w", encoding="utf-8"))
            except OSError as error:
                raise ConfigError(f"{error.filename or folder}: cannot be written ({error.strerror})") from None
            self._stack = stack.pop_all()
        frames = config.frames
        self._in_world = OdometryEncoder(frames.world, imu.frame)
        self._in_odometry = OdometryEncoder(frames.odometry, imu.frame)
        self._of_base = OdometryEncoder(frames.odometry, frames.base)
        self._transforms = FrameTransforms(config)
        self._rate_density = imu.gyroscope_noise_density**2
        self._last_stamp_ns = 0
        self._last_node_ns = -1
        self._diagnosed_ns = 0
        self._mounted = not config.extrinsics

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def write(self, output: Output) -> None:
        """Write what one message led to."""
        if output.estimate is not None:
            self._write_estimate(output.estimate, output.base)
        # a late measurement updates the window without making a newer node: a track holds each node once
        if output.optimised is not None and output.optimised.stamp_ns > self._last_node_ns:
            self._last_node_ns = output.optimised.stamp_ns
            nav = output.optimised.nav
            track = self._tracks["optimized_in_world"]
            track.append(output.optimised.stamp_ns, nav.position(), quaternion_xyzw(nav.attitude()))
        for stamp_ns, nav in output.smoothed:
            self._tracks["smoothed_in_world"].append(stamp_ns, nav.position(), quaternion_xyzw(nav.attitude()))

    def write_events(self, events: list[Event]) -> None:
        """Write events, one JSON object per line."""
        for event in events:
            self._events.write(json.dumps(asdict(event)) + "\n")
        if events:
            self._events.flush()

    def diagnose(self, estimator: Estimator, now_ns: int) -> None:
        """Write a DiagnosticArray once a second."""
        if now_ns - self._diagnosed_ns < DIAGNOSTICS_PERIOD_NS:
            return
        self._diagnosed_ns = now_ns
        types = self._mcap.types
        report = estimator.health_report()
        values = [("fused", " ".join(report.fused))]
        values += [(f"{sensor} age_s", f"{age_s:.3f}") for sensor, age_s in report.ages_s.items()]
        values += [(f"{sensor} {outcome}", str(count)) for (sensor, outcome), count in sorted(estimator.counts.items())]
        status = types["diagnostic_msgs/msg/DiagnosticStatus"](
            level=0 if report.health is Health.NOMINAL else 1,
            name="holdfast",
            message=report.health if estimator.initialised else f"{report.health}: {estimator.waiting_for}",
            hardware_id="",
            values=[types["diagnostic_msgs/msg/KeyValue"](key=key, value=value) for key, value in values],
        )
        stamp = types["builtin_interfaces/msg/Time"](sec=now_ns // 10**9, nanosec=now_ns % 10**9)
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
        self._mcap.write("/diagnostics", types[DIAGNOSTICS](header=header, status=[status]), DIAGNOSTICS, now_ns)

    def _write_estimate(self, estimate: Estimate, base: BaseState | None) -> None:
        stamp = estimate.stamp_ns
        T_W_I = estimate.nav.pose()
        T_O_I = estimate.T_W_O.inverse() * T_W_I
        period_s = min(max((stamp - self._last_stamp_ns) * 1e-9, 1e-4), 0.1)
        self._last_stamp_ns = stamp
        rate_variance = self._rate_density / period_s
        world, odom = (odometry(estimate, pose, rate_variance) for pose in (T_W_I, T_O_I))
        self._tracks["imu_in_world"].append(stamp, world.position, world.quaternion_xyzw)
        self._tracks["imu_in_odom"].append(stamp, odom.position, odom.quaternion_xyzw)
        self._mcap.write("/holdfast/odometry/world", self._in_world.encode(stamp, *world), ODOMETRY, stamp)
        self._mcap.write("/holdfast/odometry/odom", self._in_odometry.encode(stamp, *odom), ODOMETRY, stamp)
        if base is not None and self._geometry is not None:
            chassis = base_odometry(estimate, base, self._geometry, rate_variance)
            self._tracks["base_in_odom"].append(stamp, chassis.position, chassis.quaternion_xyzw)
            self._tracks["base_in_world"].append(stamp, *translation_and_quaternion(base.T_W_B))
            self._mcap.write("/holdfast/odometry/base", self._of_base.encode(stamp, *chassis), ODOMETRY, stamp)
        if not self._mounted:
            self._mounted = True
            self._mcap.write("/tf_static", self._transforms.mounts(stamp), TRANSFORMS, stamp)
        self._mcap.write("/tf", self._transforms.at(estimate, base), TRANSFORMS, stamp)
