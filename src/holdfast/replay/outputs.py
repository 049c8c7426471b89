"""The files of a replay: trajectories, ROS messages and events, written as they come so that nothing is lost."""

import json
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Self

from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.recording.mcap_writer import McapWriter
from holdfast.recording.tum import TumWriter
from holdfast.ros.frame_transforms import translation_and_quaternion
from holdfast.ros.messages import (
    DIAGNOSTICS,
    DIAGNOSTICS_PERIOD_NS,
    EstimateMessages,
    Observed,
    RosMessage,
    bias_status,
    diagnostic_array,
    estimator_status,
)
from holdfast.ros.outputs import quaternion_xyzw
from holdfast.state import BaseState, Estimate, Event, Output

ESTIMATES, EVENTS, SUMMARY = "estimates.mcap", "events.jsonl", "summary.json"


class Outputs:
    """Writes the estimator's output into a folder; a context manager."""

    def __init__(self, folder: Path, config: Config) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"{folder}: cannot be made a folder for the output ({error.strerror})") from None
        self.folder = folder
        names = ["imu_in_world", "imu_in_odom", "optimized_in_world", "smoothed_in_world"]
        names += ["base_in_world", "base_in_odom"] if config.has_base() else []
        with ExitStack() as stack:
            try:
                self._tracks = {name: stack.enter_context(TumWriter(folder / f"{name}.tum")) for name in names}
                self._mcap = stack.enter_context(McapWriter(folder / ESTIMATES))
                self._events = stack.enter_context((folder / EVENTS).open("w", encoding="utf-8"))
            except OSError as error:
                raise ConfigError(f"{error.filename or folder}: cannot be written ({error.strerror})") from None
            self._stack = stack.pop_all()
        self._messages = EstimateMessages(config)
        self._last_node_ns = -1
        self._newest: Estimate | None = None
        self._diagnosed_ns = 0
        self._mounted = not self._messages.has_mounts

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def write(self, output: Output) -> None:
        """Write the output of one message."""
        if output.estimate is not None:
            self._newest = output.estimate
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

    def diagnose(self, estimator: Observed, now_ns: int) -> None:
        """Write a DiagnosticArray once a second."""
        if now_ns - self._diagnosed_ns < DIAGNOSTICS_PERIOD_NS:
            return
        self._diagnosed_ns = now_ns
        statuses = [estimator_status(estimator)]
        if self._newest is not None:
            statuses.append(bias_status(self._newest))
        message = diagnostic_array(self._mcap.types, now_ns, statuses)
        self._mcap.write("/diagnostics", message, DIAGNOSTICS, now_ns)

    def _write_estimate(self, estimate: Estimate, base: BaseState | None) -> None:
        stamp = estimate.stamp_ns
        T_W_I = estimate.nav.pose()
        self._tracks["imu_in_world"].append(stamp, *translation_and_quaternion(T_W_I))
        self._tracks["imu_in_odom"].append(stamp, *translation_and_quaternion(estimate.T_W_O.inverse() * T_W_I))
        if base is not None and "base_in_odom" in self._tracks:
            self._tracks["base_in_odom"].append(stamp, *translation_and_quaternion(base.T_O_B))
            self._tracks["base_in_world"].append(stamp, *translation_and_quaternion(base.T_W_B))
        if not self._mounted:
            self._mounted = True
            self._write_message(self._messages.mounts(stamp), stamp)
        for message in self._messages.of(estimate, base):
            self._write_message(message, stamp)

    def _write_message(self, message: RosMessage, stamp_ns: int) -> None:
        self._mcap.write(message.topic, message.data, message.type_name, stamp_ns)
