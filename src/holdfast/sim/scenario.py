"""A scenario: which machine does what, on which site, with which sensors, and what goes wrong when.

A scenario file names a machine and a site; their files supply every key that the scenario does not give itself.
"""

from collections.abc import Iterator
from copy import deepcopy
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, Self, TypeVar

from pydantic import Field, model_validator

from holdfast.config.document import Document, read_document
from holdfast.config.extrinsics import Extrinsic
from holdfast.config.frames import Datum
from holdfast.config.load import read_yaml, validate
from holdfast.config.section import Section, Vector3, quantity
from holdfast.errors import ConfigError
from holdfast.sim.datasheets import Sheet, SimulatedSensor
from holdfast.sim.fault import Fault
from holdfast.sim.faults import affected_kinds, can_happen
from holdfast.sim.movers import Arm, Mover, Part
from holdfast.sim.sensors import KINDS, AnySheet, names_sensors
from holdfast.sim.sensors.imu import SimulatedImu

SHORTEST_S, LONGEST_S = 1.0, 36_000.0  # of a recording: longer than the one, at most the other
Point = tuple[float, float]
Kind = TypeVar("Kind", bound=Sheet)


class Chassis(Section):
    """Where the wheels stand below the chassis frame B, whose origin lies on the ground in their middle."""

    wheelbase_m: float = quantity("m", gt=0.5, le=20, doc="front to rear axle")
    track_m: float = quantity("m", gt=0.5, le=20, doc="left to right wheel")


class Drive(Section):
    """What the driver never exceeds."""

    speed_m_s: float = quantity("m/s", 1.5, gt=0, le=30, doc="of the chassis")
    acceleration_m_s2: float = quantity("m/s^2", 0.6, gt=0, le=10, doc="of the chassis")
    yaw_rate_rad_s: float = quantity("rad/s", 0.35, gt=0, le=3, doc="of the chassis")
    yaw_acceleration_rad_s2: float = quantity("rad/s^2", 0.4, gt=0, le=10, doc="of the chassis")
    slew_rate_rad_s: float = quantity("rad/s", 0.6, gt=0, le=3, doc="of the cabin on the chassis")
    slew_acceleration_rad_s2: float = quantity("rad/s^2", 0.6, gt=0, le=10, doc="of the cabin on the chassis")


class TurnJoint(Section):
    """Where the cabin C turns on the chassis B: about the z axis of B through this point."""

    position_m: Vector3 = quantity("m", doc="origin of C in B")


class Engine(Section):
    """Vibration of the cabin on its mounts and shaking of the machine by its arm."""

    frequency_hz: float = quantity("Hz", 28.0, gt=1, le=200, doc="first order of the vibration")
    idle_acceleration_m_s2: float = quantity("m/s^2", 0.08, ge=0, le=20, doc="amplitude while standing, per axis")
    work_acceleration_m_s2: float = quantity("m/s^2", 0.4, ge=0, le=20, doc="amplitude at work, per axis")
    arm_tilt_deg: float = quantity("deg", 0.4, ge=0, le=10, doc="the arm at work tilts and shakes the chassis so much")


class Ground(Section):
    """Natural terrain around the origin, without what people heaped or dug."""

    size_m: float = quantity("m", 160.0, gt=20, le=2000, doc="side of the square that is modelled")
    slope_deg: Point = quantity("deg", (0.0, 0.0), doc="rise to the east and to the north")
    undulation_m: float = quantity("m", 0.5, ge=0, le=20, doc="sigma of the hills")
    undulation_length_m: float = quantity("m", 40.0, gt=5, doc="length of the hills")
    roughness_m: float = quantity("m", 0.015, ge=0, le=0.5, doc="sigma of what the wheels feel")
    roughness_length_m: float = quantity("m", 2.5, ge=1, doc="length of what the wheels feel")
    resolution_m: float = quantity("m", 0.4, gt=0.02, le=5, doc="side of a cell of the mesh")
    seed: int = Field(1, ge=0, description="of the random hills")


class Heap(Section):
    """A spoil heap, or with negative height a pit."""

    center_m: Point = quantity("m", doc="east, north")
    radius_m: float = quantity("m", gt=0, doc="to its foot")
    height_m: float = quantity("m", doc="above the ground; negative: a pit")


class Trench(Section):
    """A trench with sloped ends and walls."""

    start_m: Point = quantity("m", doc="east, north")
    end_m: Point = quantity("m", doc="east, north")
    width_m: float = quantity("m", 1.2, gt=0.2, doc="between the walls")
    depth_m: float = quantity("m", 1.5, gt=0, doc="below the ground")


class Box(Section):
    """A container, a wall or a building without a roof of its own: a box on the ground."""

    center_m: Point = quantity("m", doc="east, north")
    size_m: Vector3 = quantity("m", doc="length, width, height")
    yaw_deg: float = quantity("deg", 0.0, doc="of its length")
    roof_m: float = quantity("m", 0.0, ge=0, doc="height of a gable roof on top")


class Tree(Section):
    """A tree: a trunk and an ellipsoid of leaves that shades GNSS."""

    center_m: Point = quantity("m", doc="east, north")
    height_m: float = quantity("m", 9.0, gt=1, le=60, doc="to the top of the crown")
    crown_radius_m: float = quantity("m", 2.5, gt=0.2, le=20, doc="of the crown, horizontally")
    trunk_radius_m: float = quantity("m", 0.2, gt=0.02, le=2, doc="of the trunk")


class Objects(Section):
    """What stands on the ground and what was dug into it."""

    heaps: tuple[Heap, ...] = ()
    trenches: tuple[Trench, ...] = ()
    boxes: tuple[Box, ...] = ()
    trees: tuple[Tree, ...] = ()


class Dig(Section):
    """Digging: slew to the side, dump, slew back, with a shaking arm."""

    cycles: int = Field(ge=1, le=1000, description="number of buckets")
    swing_deg: float = quantity("deg", 100.0, ge=-180, le=180, doc="from the trench to the heap")
    dig_s: float = quantity("s", 6.0, gt=0, doc="time in the trench")
    dump_s: float = quantity("s", 3.0, gt=0, doc="time over the heap")


class Activity(Section):
    """One thing that the machine does; give exactly one key (`speed_m_s` may go with `drive_to_m`)."""

    stand_s: float | None = quantity("s", None, gt=0, doc="stand still, the engine idling")
    drive_to_m: tuple[Point, ...] | None = Field(None, description="waypoints, east and north [m]")
    speed_m_s: float | None = quantity("m/s", None, gt=0, doc="slower than the machine can")
    slew_to_deg: float | None = quantity("deg", None, doc="rotate the cabin to this angle; beyond 180 it goes on")
    dig: Dig | None = None
    repeat: int | None = Field(None, ge=1, le=10_000, description="do what `of` lists so many times")
    of: tuple["Activity", ...] = ()

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        kinds = ("stand_s", "drive_to_m", "slew_to_deg", "dig", "repeat")
        given = [kind for kind in kinds if getattr(self, kind) is not None]
        if len(given) != 1:
            raise ValueError(f"an activity has one of {', '.join(kinds)}; this one has {', '.join(given) or 'none'}")
        if self.speed_m_s is not None and self.drive_to_m is None:
            raise ValueError("speed_m_s goes with drive_to_m only")
        if bool(self.of) != (self.repeat is not None):
            raise ValueError("repeat needs `of`, a list of activities, and `of` needs repeat")
        return self


class Start(Section):
    """Where and how the machine begins."""

    position_m: Point = quantity("m", (0.0, 0.0), doc="of the chassis: east, north")
    heading_deg: float = quantity("deg", 0.0, doc="yaw of the chassis: 0 is east, counter-clockwise")
    cabin_deg: float = quantity("deg", 0.0, doc="angle of the turn joint")
    speed_m_s: float = quantity("m/s", 0.0, ge=0, doc="of the chassis: the recording begins in motion")


@names_sensors
class Scenario(Section):
    """The whole scenario, its machine and its site."""

    description: str = ""
    machine: str = Field(description="a shipped machine, or a YAML file beside the scenario")
    site: str = Field(description="a shipped site, or a YAML file beside the scenario")
    duration_s: float = quantity("s", gt=SHORTEST_S, le=LONGEST_S, doc="length of the recording")
    start: Start = Start()
    activities: tuple[Activity, ...] = Field((), description="one after the other; then the machine stands")
    faults: tuple[Fault, ...] = ()
    earth_rotation: bool = Field(False, description="the IMUs feel the rotation of the earth")
    like: str | None = Field(None, description="another scenario, whose keys hold where this one has none")
    written: dict[str, Any] = Field({}, description="keys of the configuration that its owner wrote otherwise")
    # of the machine
    chassis: Chassis
    drive: Drive = Drive()
    turn_joint: TurnJoint | None = Field(None, description="without it the cabin is the chassis")
    engine: Engine = Engine()
    extrinsics: tuple[Extrinsic, ...] = Field(description="sensor frames in `cabin` or `base_link`")
    sensors: dict[str, AnySheet] = Field(description="name -> its datasheet, with `kind`; null takes one away")
    body: tuple[Part, ...] = Field((), description="parts of the machine that its own lidar sees")
    arm: Arm | None = Field(None, description="boom, stick and bucket that the lidar sees; without it there are none")
    absent: tuple[str, ...] = Field((), description="sensors that the machine's file lists and this machine lacks")
    # of the site
    datum: Datum
    ground: Ground = Ground()
    objects: Objects = Objects()
    traffic: tuple[Mover, ...] = Field((), description="people and trucks that the lidar sees")

    @property
    def imu_name(self) -> str:
        """The name of the IMU that is estimated: the first one."""
        return next(iter(self.sensors_of(SimulatedImu)))

    @property
    def imu(self) -> SimulatedImu:
        """The IMU that is estimated."""
        return self.sensors_of(SimulatedImu)[self.imu_name]

    def sensors_of(self, sheet: type[Kind]) -> dict[str, Kind]:
        """Return the sensors of one kind, by name, in the order of the file."""
        return {name: sensor for name, sensor in self.sensors.items() if isinstance(sensor, sheet)}

    @model_validator(mode="after")
    def _check(self) -> Self:
        faults = [*self._faults_of_sensors(), *self._faults_of_faults()]
        if faults:
            raise ValueError("\n".join(faults))
        return self

    def _faults_of_sensors(self) -> Iterator[str]:
        frames = {extrinsic.child for extrinsic in self.extrinsics} | {BASE, CABIN}
        for index, extrinsic in enumerate(self.extrinsics):
            if extrinsic.parent not in (BASE, CABIN):
                yield f"extrinsics: parent of entry {index + 1} must be {BASE} or {CABIN}"
        for number, part in enumerate(self.body, start=1):
            if part.frame not in (BASE, CABIN):
                yield f"body: frame of entry {number} must be {BASE} or {CABIN}"
        if not self.sensors_of(SimulatedImu):
            yield "sensors: needs a sensor with `kind: imu`"
        for name, sensor in self.sensors.items():
            if sensor.frame not in frames:
                yield f"sensors.{name}.frame: {sensor.frame!r} is not among {', '.join(sorted(frames))}"
        for name, sensor in self.sensors.items():
            yield from KINDS[sensor.kind].mistakes(name, sensor, self.sensors)

    def _faults_of_faults(self) -> Iterator[str]:
        present = self.sensors_of(SimulatedSensor)
        for number, fault in enumerate(self.faults, start=1):
            absent = [name for name in fault.sensors if name not in present]
            if absent:
                yield f"faults: the machine has no {', '.join(absent)}, which entry {number} names"
            strange = [n for n in fault.sensors if n in present and not can_happen(fault.kind, present[n].kind)]
            if strange:
                allowed = ", ".join(affected_kinds(fault.kind))
                yield f"faults: {fault.kind} of entry {number} cannot happen to {', '.join(strange)} (kinds: {allowed})"


BASE, CABIN = "base_link", "cabin"
FOLDERS = {"machine": "machines", "site": "sites"}


def shipped(folder: str) -> list[str]:
    """Return the names of the shipped `scenarios`, `machines` or `sites`."""
    entries = resources.files("holdfast.sim").joinpath(folder).iterdir()
    return sorted(entry.name.removesuffix(".yaml") for entry in entries if entry.name.endswith(".yaml"))


def load_scenario(name_or_path: str, overrides: dict[str, Any] | None = None) -> Scenario:
    """Read a shipped scenario by name, or a scenario file.

    Args:
        name_or_path: such as `construction` or `site/monday.yaml`.
        overrides: keys that replace those of the file.

    Raises:
        ConfigError: there is no such scenario, or it holds mistakes; the text has one line per mistake.
    """
    document = _read("scenarios", name_or_path, Path())
    document.data |= overrides or {}
    beside = Path(name_or_path).parent
    if isinstance(like := document.data.get("like"), str):
        document.data = merged(_read("scenarios", like, beside).data, document.data)
    for key, folder in FOLDERS.items():
        name = document.data.get(key)
        if isinstance(name, str):
            document.data = merged(_read(folder, name, beside).data, document.data)
    _take_away_absent(document.data)
    return validate(document, Scenario)


def _take_away_absent(data: dict[str, Any]) -> None:
    """Leave out the sensors that are null or listed as absent, and list them all."""
    sensors, absent = data.get("sensors"), data.get("absent", [])
    if isinstance(sensors, dict) and isinstance(absent, list):
        data["absent"] = [name for name, sheet in sensors.items() if sheet is None or name in absent]
        data["sensors"] = {name: sheet for name, sheet in sensors.items() if name not in data["absent"]}


def _read(folder: str, name: str, beside: Path) -> Document:
    if name in shipped(folder):
        return deepcopy(_shipped_document(folder, name))
    if not name.endswith((".yaml", ".yml")):
        raise ConfigError(
            f"{name}: no such {folder.removesuffix('s')} (allowed: {', '.join(shipped(folder))}, or a .yaml file)"
        )
    path = beside / name
    return read_document(read_yaml(path, f"shipped are {', '.join(shipped(folder))}"), str(path))


@cache
def _shipped_document(folder: str, name: str) -> Document:
    """Read a file of the package, once: of what a scenario takes, most is spent on YAML."""
    file: Traversable = resources.files("holdfast.sim").joinpath(folder, f"{name}.yaml")
    return read_document(file.read_text(encoding="utf-8"), f"{folder}/{name}.yaml")


def merged(below: Any, above: Any) -> Any:
    """Return `above` with what only `below` has; lists and plain values of `above` replace those of `below`."""
    if not (isinstance(below, dict) and isinstance(above, dict)):
        return above
    return below | {key: merged(below.get(key), value) for key, value in above.items()}
