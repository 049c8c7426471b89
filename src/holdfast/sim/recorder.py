"""Writes a simulation: the recording that a machine would have made, and the truth that no machine has."""

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping
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
from holdfast.sim.datasheets import SimulatedSensor
from holdfast.sim.garbage import Garbage
from holdfast.sim.ros import Encode, RosMessages
from holdfast.sim.scenario import BASE, CABIN
from holdfast.sim.sensors import KINDS
from holdfast.sim.sensors.joint import SimulatedJoint
from holdfast.sim.sensors.odometry import SimulatedOdometry
from holdfast.sim.sensors.scanner import SimulatedScanner
from holdfast.sim.simulation import START_NS, Simulation
from holdfast.sim.transport import Delivered
from holdfast.state import Trajectory

Progress = Callable[[int], None]
"""Receives the arrival [ns] of what was written last."""

TURNS_EVERY = 5  # readings of the joint: its transform is published at 20 Hz, as robot_state_publisher does
TRANSFORMS = "tf2_msgs/msg/TFMessage"

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
        sensors, scanners = (simulation.scenario.sensors_of(kind) for kind in (SimulatedSensor, SimulatedScanner))
        streams: list[Iterable[_Row]] = [[_mounts(simulation, messages)]]
        for number, (name, delivered) in enumerate(simulation.delivered.items(), start=1):
            sheet = sensors[name]
            kind = KINDS[sheet.kind]
            if kind.encode is not None:
                garbage = Garbage(simulation.scenario.faults, name, delivered.readings.times_s, simulation.seed)
                encode = garbage.in_place_of(kind.encode(messages, sheet, delivered.readings))
                streams.append(_rows(delivered, number, sheet.topic, kind.message_type, encode))
                if isinstance(sheet, SimulatedJoint) and simulation.scenario.turn_joint is not None:
                    streams.append(_turning(simulation, delivered, number, messages))
            elif scans and name in scanners:
                streams.append(_scans(simulation, name, number))
        for count, (arrival_ns, _, topic, type_name, message) in enumerate(merge(*streams, key=lambda row: row[:2])):
            writer.write(topic, message, type_name, arrival_ns)
            counts[topic] = counts.get(topic, 0) + 1
            if progress is not None and count % 1000 == 0:
                progress(arrival_ns)
    return counts


def _rows(delivered: Delivered, number: int, topic: str, type_name: str, encode: Encode) -> Iterator[_Row]:
    """Yield one sensor's messages in the order of their arrival."""
    stamps, arrivals = delivered.stamps_ns.tolist(), delivered.arrivals_ns.tolist()
    for row in np.argsort(delivered.arrivals_ns, kind="stable").tolist():
        yield arrivals[row], number, topic, type_name, encode(row, stamps[row])


def _scans(simulation: Simulation, name: str, number: int) -> Iterator[_Row]:
    """Yield the scans, ray-cast when their turn comes."""
    from holdfast.sim.readings import generator
    from holdfast.sim.scans import Scanner, encode_points

    scanners, delivered = simulation.scenario.sensors_of(SimulatedScanner), simulation.delivered[name]
    sheet = scanners[name]
    scanner = Scanner(sheet, simulation.site.mesh())
    purpose = ("scan",) if name == next(iter(scanners)) else (name, "scan")
    starts_s, boxes = delivered.readings.times_s, simulation.moving_boxes()

    def encode(row: int, stamp_ns: int) -> bytes:
        times_s = scanner.column_times_s(starts_s[row])
        moving = simulation.motion.frame(sheet.frame, times_s)
        rng = generator(simulation.seed, *purpose, str(row))
        scan = scanner.scan(row, moving.R_W_F, moving.p_W, rng, [box for group in boxes for box in group.at(times_s)])
        return encode_points(scan, stamp_ns, sheet.frame, point_times=sheet.point_times)

    return _rows(delivered, number, sheet.topic, "sensor_msgs/msg/PointCloud2", encode)


def _mounts(simulation: Simulation, messages: RosMessages) -> _Row:
    """Return the static transforms, which come before everything else."""
    poses = {}
    for extrinsic in simulation.scenario.extrinsics:
        T = extrinsic.matrix()
        poses[extrinsic.parent, extrinsic.child] = T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat()
    return START_NS, 0, "/tf_static", TRANSFORMS, messages.transforms(START_NS, poses)


def _turning(simulation: Simulation, delivered: Delivered, number: int, messages: RosMessages) -> Iterator[_Row]:
    """Yield the cabin on the chassis by what the encoder reads, when that has arrived."""
    assert simulation.scenario.turn_joint is not None
    position_m = np.array(simulation.scenario.turn_joint.position_m)
    half_rad = 0.5 * delivered.readings.values["angle_rad"]

    for row in np.argsort(delivered.arrivals_ns, kind="stable")[::TURNS_EVERY].tolist():
        rotation = np.array((0.0, 0.0, np.sin(half_rad[row]), np.cos(half_rad[row])))
        message = messages.transforms(int(delivered.stamps_ns[row]), {(BASE, CABIN): (position_m, rotation)})
        yield int(delivered.arrivals_ns[row]), number, "/tf", TRANSFORMS, message


def write_truth(simulation: Simulation, folder: Path) -> None:
    """Write the truth, at true time.

    That is poses of I, B and the odometries in W, velocities, biases, the joint, constants such as scale factors, and
    under the stamps of their messages the errors of positions.
    """
    folder.mkdir(exist_ok=True)
    times_s = simulation.imu_times_s()
    stamps_ns = START_NS + np.rint(times_s * 1e9).astype(np.int64)
    scenario = simulation.scenario
    frames = {"imu": scenario.imu.frame, "base": BASE}
    frames |= {name: sheet.frame for name, sheet in scenario.sensors_of(SimulatedOdometry).items()}
    columns: dict[str, Array] = {}
    for name, frame in frames.items():
        moving = simulation.motion.frame(frame, times_s)
        quaternions = Rotation.from_matrix(moving.R_W_F).as_quat(canonical=True)
        write_tum(folder / f"{name}_in_world.tum", Trajectory(stamps_ns, moving.p_W, quaternions))
        columns |= _axes(f"{name}_v_W", "m_s", moving.v_W)
        columns |= _axes(f"{name}_angular_velocity", "rad_s", moving.angular_velocity)
    _write_csv(folder / "velocities.csv", stamps_ns, columns)
    for name, readings in simulation.measured.items():
        if "gyroscope_bias" in readings.values:
            at_ns = START_NS + np.rint(readings.times_s * 1e9).astype(np.int64)
            columns = _axes("accelerometer", "m_s2", readings.values["accelerometer_bias"])
            columns |= _axes("gyroscope", "rad_s", readings.values["gyroscope_bias"])
            _write_csv(folder / f"{name}_bias.csv", at_ns, columns)
    if scenario.sensors_of(SimulatedJoint):
        angle_rad, rate_rad_s = simulation.motion.joint(times_s)
        _write_csv(folder / "joint.csv", stamps_ns, {"angle_rad": angle_rad, "rate_rad_s": rate_rad_s})
    for name, delivered in simulation.delivered.items():
        if "faulty" in delivered.readings.values:
            _write_csv(folder / f"{name}_fixes.csv", delivered.stamps_ns, _errors(delivered.readings.values))
    constants = [(name, *item) for name, readings in simulation.measured.items() for item in readings.constants.items()]
    lines = [f"{sensor},{constant},{value:.9g}\n" for sensor, constant, value in constants]
    (folder / "constants.csv").write_text("".join(["sensor,constant,value\n", *lines]), encoding="utf-8")


def _errors(values: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the columns of what is wrong with positions."""
    columns = _axes("error", "m", values["error"]) | _axes("claimed_sigma", "m", values["sigma"])
    quality = {"quality": values["quality"]} if "quality" in values else {}
    return columns | quality | {"lying": values["faulty"].astype(np.int64)}


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
