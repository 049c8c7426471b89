"""The files of a replay: trajectories, ROS messages and events, written in small blocks so that little can be lost."""

import json
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Self

import gtsam

from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.event_log import MeasurementRecord
from holdfast.events import Event
from holdfast.measured_fields import NEVER_NS
from holdfast.recording.mcap_writer import McapWriter
from holdfast.recording.tum import TumWriter
from holdfast.replay.measurements import MEASUREMENTS, MeasurementWriter
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
from holdfast.ros.rows import Poses, Rows
from holdfast.state import BaseState, Estimate, Output

BLOCK = 64  # estimates that are written at once, and may be lost if the run is killed
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
                self._measurements = stack.enter_context(MeasurementWriter(folder / MEASUREMENTS))
                self._events = stack.enter_context((folder / EVENTS).open("w", encoding="utf-8"))
            except OSError as error:
                raise ConfigError(f"{error.filename or folder}: cannot be written ({error.strerror})") from None
            self._stack = stack.pop_all()
        self._messages = EstimateMessages(config)
        self._estimates: list[Estimate] = []  # that wait to be written, with what came along
        self._bases: list[BaseState] = []
        self._optimised: list[tuple[int, gtsam.NavState]] = []
        self._smoothed: list[tuple[int, gtsam.NavState]] = []
        self._last_node_ns = NEVER_NS
        self._newest: Estimate | None = None
        self._diagnosed_ns = NEVER_NS
        self._mounted = not self._messages.has_mounts

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._stack:
            self._write_pending()

    def write(self, output: Output) -> None:
        """Write the output of one message, or keep it until there is enough for a block."""
        if output.estimate is not None:
            if (output.base is None) == bool(self._bases):  # a block has the chassis at every estimate or at none
                self._write_pending()
            self._estimates.append(output.estimate)
            if output.base is not None:
                self._bases.append(output.base)
        # a late measurement updates the window without making a newer node: a track holds each node once
        if output.optimised is not None and output.optimised.stamp_ns > self._last_node_ns:
            self._last_node_ns = output.optimised.stamp_ns
            self._optimised.append((self._last_node_ns, output.optimised.nav))
        self._smoothed += output.smoothed
        if len(self._estimates) >= BLOCK:
            self._write_pending()

    def write_events(self, events: list[Event]) -> None:
        """Write events, one JSON object per line."""
        for event in events:
            self._events.write(json.dumps(asdict(event)) + "\n")
        if events:
            self._events.flush()

    def write_measurements(self, records: Iterable[MeasurementRecord], outcome: str = "") -> None:
        """Write what became of measurements; `outcome` stands in for theirs."""
        self._measurements.write(records, outcome)

    def diagnose(self, estimator: Observed, now_ns: int) -> None:
        """Write a DiagnosticArray once a second."""
        if now_ns - self._diagnosed_ns < DIAGNOSTICS_PERIOD_NS:
            return
        self._diagnosed_ns = now_ns
        self._write_pending()
        statuses = [estimator_status(estimator)]
        if self._newest is not None:
            statuses.append(bias_status(self._newest))
        message = diagnostic_array(self._mcap.types, now_ns, statuses)
        self._mcap.write("/diagnostics", message, DIAGNOSTICS, now_ns)

    def _write_pending(self) -> None:
        self._measurements.flush()
        if self._estimates:
            self._newest = self._estimates[-1]
            self._write_estimates(Rows.of(self._estimates, self._bases))
            self._estimates, self._bases = [], []
        for name, nodes in (("optimized_in_world", self._optimised), ("smoothed_in_world", self._smoothed)):
            if nodes:
                self._append(name, [stamp_ns for stamp_ns, _ in nodes], Poses.of(nav.pose() for _, nav in nodes))
                nodes.clear()

    def _write_estimates(self, rows: Rows) -> None:
        stamps = rows.stamps_ns
        self._append("imu_in_world", stamps, rows.T_W_I)
        self._append("imu_in_odom", stamps, rows.T_O_I)
        if len(rows.chassis):
            self._append("base_in_odom", stamps, rows.T_O_B)
            self._append("base_in_world", stamps, rows.T_W_B)
        if not self._mounted:
            self._mounted = True
            self._write_messages(stamps[0], [self._messages.mounts(stamps[0])])
        for stamp_ns, messages in zip(stamps, self._messages.of(rows), strict=True):
            self._write_messages(stamp_ns, messages)

    def _append(self, name: str, stamps_ns: list[int], poses: Poses) -> None:
        self._tracks[name].extend(stamps_ns, poses.translations, poses.quaternions)

    def _write_messages(self, stamp_ns: int, messages: Iterable[RosMessage]) -> None:
        for message in messages:
            self._mcap.write(message.topic, message.data, message.type_name, stamp_ns)
