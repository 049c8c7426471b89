"""Writes a simulation: the recording that a machine would have made, and the truth that no machine has."""

import csv
from collections.abc import Callable, Iterable, Iterator
from heapq import merge
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from holdfast.messages import Array
from holdfast.recording.mcap_writer import McapWriter
from holdfast.recording.origin import SIMULATION
from holdfast.recording.tum import write_tum
from holdfast.sim.datasheets import SimulatedLidar
from holdfast.sim.ros import RosMessages
from holdfast.sim.scenario import BASE
from holdfast.sim.simulation import START_NS, Simulation
from holdfast.sim.transport import Delivered
from holdfast.state import Trajectory

Progress = Callable[[int], None]
"""Is told the arrival [ns] of what was written last."""

_Row = tuple[int, int, str, str, Any]  # arrival, number of the sensor, topic, type, message


def write_recording(simulation: Simulation, path: Path, scans: bool, progress: Progress | None) -> dict[str, int]:
    """Write the recording as ROS 2 MCAP, in the order of arrival, and return the number of messages by topic.

    Raises:
        ConfigError: scans are asked for and embreex is not installed.
        RecordingError: the file cannot be written.
    """
    counts: dict[str, int] = {}
    with McapWriter(path) as writer:
        writer.note(SIMULATION, {"seed": str(simulation.seed), "description": simulation.scenario.description})
        messages = RosMessages(writer.types, simulation.world)
        sensors = simulation.scenario.sensors.present()
        streams: list[Iterable[_Row]] = [[_mounts(simulation, messages)]]
        for number, (name, delivered) in enumerate(simulation.delivered.items(), start=1):
            sheet = sensors[name]
            if isinstance(sheet, SimulatedLidar):
                if scans:
                    streams.append(_scans(simulation, sheet, delivered, number))
                continue
            type_name, encode = messages.encoder(name, sheet, delivered.readings)
            streams.append(_rows(delivered, number, sheet.topic, type_name, encode))
        for count, (arrival_ns, _, topic, type_name, message) in enumerate(merge(*streams, key=lambda row: row[:2])):
            writer.write(topic, message, type_name, arrival_ns)
            counts[topic] = counts.get(topic, 0) + 1
            if progress is not None and count % 1000 == 0:
                progress(arrival_ns)
    return counts


def _rows(
    delivered: Delivered, number: int, topic: str, type_name: str, encode: Callable[[int, int], Any]
) -> Iterator[_Row]:
    """Yield one sensor's messages in the order of their arrival."""
    stamps, arrivals = delivered.stamps_ns.tolist(), delivered.arrivals_ns.tolist()
    for row in np.argsort(delivered.arrivals_ns, kind="stable").tolist():
        yield arrivals[row], number, topic, type_name, encode(row, stamps[row])


def _scans(simulation: Simulation, sheet: SimulatedLidar, delivered: Delivered, number: int) -> Iterator[_Row]:
    """Yield the scans, ray-cast when their turn comes."""
    from holdfast.sim.readings import generator
    from holdfast.sim.scans import Scanner, encode_points

    scanner = Scanner(sheet, simulation.site.mesh())
    starts_s = delivered.readings.times_s

    def encode(row: int, stamp_ns: int) -> bytes:
        moving = simulation.motion.frame(sheet.frame, scanner.column_times_s(starts_s[row]))
        rng = generator(simulation.seed, "scan", str(row))
        scan = scanner.scan(row, moving.R_W_F, moving.p_W, rng)
        return encode_points(scan, stamp_ns, sheet.frame, point_times=sheet.point_times)

    return _rows(delivered, number, sheet.topic, "sensor_msgs/msg/PointCloud2", encode)


def _mounts(simulation: Simulation, messages: RosMessages) -> _Row:
    """Return the static transforms, which come before everything else."""
    poses = {}
    for extrinsic in simulation.scenario.extrinsics:
        T = extrinsic.matrix()
        poses[extrinsic.parent, extrinsic.child] = T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat()
    return START_NS, 0, "/tf_static", "tf2_msgs/msg/TFMessage", messages.transforms(START_NS, poses)


def write_truth(simulation: Simulation, folder: Path) -> None:
    """Write poses of I, B and L in W, velocities, biases, the joint and the errors of all fixes, at true time."""
    folder.mkdir(exist_ok=True)
    times_s = simulation.imu_times_s()
    stamps_ns = START_NS + np.rint(times_s * 1e9).astype(np.int64)
    sensors = simulation.scenario.sensors
    frames = {"imu": sensors.imu.frame, "base": BASE}
    if sensors.lidar is not None:
        frames["lidar"] = sensors.lidar.frame
    columns: dict[str, Array] = {}
    for name, frame in frames.items():
        moving = simulation.motion.frame(frame, times_s)
        quaternions = Rotation.from_matrix(moving.R_W_F).as_quat(canonical=True)
        write_tum(folder / f"{name}_in_world.tum", Trajectory(stamps_ns, moving.p_W, quaternions))
        columns |= _axes(f"{name}_v_W", "m_s", moving.v_W)
        columns |= _axes(f"{name}_angular_velocity", "rad_s", moving.angular_velocity)
    _write_csv(folder / "velocities.csv", stamps_ns, columns)
    for name, bias in simulation.biases.items():
        at_ns = START_NS + np.rint(bias.times_s * 1e9).astype(np.int64)
        axes = _axes("accelerometer", "m_s2", bias.accelerometer) | _axes("gyroscope", "rad_s", bias.gyroscope)
        _write_csv(folder / f"{name}_bias.csv", at_ns, axes)
    if sensors.joint is not None:
        angle_rad, rate_rad_s = simulation.motion.joint(times_s)
        _write_csv(folder / "joint.csv", stamps_ns, {"angle_rad": angle_rad, "rate_rad_s": rate_rad_s})
    for name in ("gnss", "gnss_right"):
        if name in simulation.delivered:
            fixes = simulation.delivered[name]
            values = fixes.readings.values
            columns = _axes("error", "m", values["error"]) | _axes("claimed_sigma", "m", values["sigma"])
            columns |= {"quality": values["quality"], "lying": values["lying"].astype(np.int64)}
            _write_csv(folder / f"{name}_fixes.csv", fixes.stamps_ns, columns)


def _axes(name: str, unit: str, vectors: Array) -> dict[str, Array]:
    return {f"{name}_{axis}_{unit}": vectors[:, k] for k, axis in enumerate("xyz")}


def _write_csv(path: Path, stamps_ns: NDArray[np.int64], columns: dict[str, NDArray[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["stamp_ns", *columns])
        texts = (map(_number, column.tolist()) for column in columns.values())
        writer.writerows(zip(stamps_ns.tolist(), *texts, strict=True))


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.9g}"
