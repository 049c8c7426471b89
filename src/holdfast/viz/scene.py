"""ROS messages as a scene in Rerun: tracks, frames, covariance in space, and time series beside it.

Messages are gathered and sent in columns, thinned out in time: a scene costs little whatever their rate.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.geometry.rotations import quaternions_xyzw
from holdfast.messages import Array
from holdfast.viz.clouds import MAP_S, Clouds

NS_PER_S = 1_000_000_000
TIMELINE = "time"
TRACK_NS = 50_000_000
CLOUD_NS = 200_000_000
ELLIPSOID_NS = 200_000_000
ELLIPSOID_SIGMAS = 3.0
AXIS_M = 0.8
COLOURS = [(51, 136, 221), (238, 119, 51), (34, 170, 120), (204, 68, 136), (150, 120, 220), (150, 150, 60)]
LEVELS = {10: "DEBUG", 20: "INFO", 30: "WARN", 40: "ERROR", 50: "CRITICAL"}
CLOUD = "sensor_msgs/msg/PointCloud2"
ODOMETRY, FIX = "nav_msgs/msg/Odometry", "sensor_msgs/msg/NavSatFix"
DATUM = "/datum"
TRANSFORMS, DIAGNOSTICS, LOG = "tf2_msgs/msg/TFMessage", "diagnostic_msgs/msg/DiagnosticArray", "rcl_interfaces/msg/Log"


@dataclass(slots=True)
class Track:
    """Poses of one topic that were not sent yet, in the order in which they came."""

    frame_id: str
    colour: tuple[int, int, int]
    stamps_ns: list[int] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)  # (7,) position [m], quaternion x, y, z, w
    covariances: list[Array] = field(default_factory=list)  # (3, 3) of the position [m^2]
    speeds_m_s: list[float] = field(default_factory=list)
    last_ns: int = -1
    last_position: Array | None = None


class Scene:
    """Draws messages into a recording of Rerun.

    Args:
        recording: where to draw.
        datum: origin of the world, until a topic `.../datum` gives another.
        awaits_datum: leave out the fixes before such a message; otherwise the first fix is the origin.
    """

    def __init__(
        self, recording: rr.RecordingStream, datum: Geodetic | None = None, *, awaits_datum: bool = False
    ) -> None:
        self._recording = recording
        self._awaits_datum = awaits_datum
        self._world = None if datum is None else LocalFrame(datum)
        self._tracks: dict[str, Track] = {}
        self._fixes: dict[str, Track] = {}
        self._parents: dict[str, str] = {}
        self._transforms: dict[str, tuple[list[int], list[Array]]] = {}
        self._statuses: dict[str, str] = {}
        self._due: dict[str, int] = {}
        self._shown: set[str] = set()
        self._styled: set[str] = set()
        self._kinds: dict[str, Callable[[str, Any, int], None]] = {
            ODOMETRY: self._add_odometry,
            FIX: self._add_fix,
            TRANSFORMS: self._add_transforms,
            DIAGNOSTICS: self._add_diagnostics,
            LOG: self._add_log,
            CLOUD: self._add_cloud,
        }
        self._clouds = Clouds()
        self._maps: set[str] = set()
        self._shown_maps: set[str] = set()
        recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def wants(self, topic: str, type_name: str, time_ns: int) -> bool:
        """Whether a message would be drawn: of those that come fast only some are."""
        if type_name not in self._kinds:
            return False
        if type_name not in (ODOMETRY, TRANSFORMS, CLOUD) or topic == "/tf_static":
            return True
        if time_ns < self._due.get(topic, time_ns):
            return False
        self._due[topic] = time_ns + (CLOUD_NS if type_name == CLOUD else TRACK_NS)
        return True

    def add(self, topic: str, type_name: str, message: Any, time_ns: int) -> None:
        """Take in a decoded message that `wants` asked for; `time_ns` stands in for a stamp where there is none."""
        self._kinds[type_name](topic, message, time_ns)

    def write(self, entity: str, text: str, level: str, time_ns: int) -> None:
        """Write a line of text at a time."""
        self._recording.set_time(TIMELINE, timestamp=np.datetime64(time_ns, "ns"))
        self._recording.log(entity, rr.TextLog(text, level=level))

    def flush(self) -> None:
        """Send what was gathered."""
        for child, (stamps_ns, poses) in self._transforms.items():
            self._send_transforms(child, stamps_ns, np.array(poses))
        self._transforms.clear()
        for topic, track in self._tracks.items():
            if track.stamps_ns:
                self._send_track(topic, track)
        for topic, track in self._fixes.items():
            if track.stamps_ns:
                self._send_fixes(topic, track)
        entities = {self._entity(track.frame_id, topic) for topic, track in {**self._tracks, **self._fixes}.items()}
        if entities - self._shown or self._maps - self._shown_maps:
            self._shown |= entities
            self._shown_maps |= self._maps
            self._recording.send_blueprint(blueprint(sorted(self._shown), sorted(self._shown_maps)))

    # --- gathering -----------------------------------------------------------------------------------------------

    def _add_odometry(self, topic: str, message: Any, time_ns: int) -> None:  # noqa: ARG002
        track = self._tracks.setdefault(topic, self._new_track(message.header.frame_id))
        pose, twist = message.pose, message.twist.twist
        p, q = pose.pose.position, pose.pose.orientation
        row = np.array((p.x, p.y, p.z, q.x, q.y, q.z, q.w))
        stamp = _stamp_ns(message.header)
        if stamp <= track.last_ns or not np.isfinite(row).all():
            return
        track.last_ns = stamp
        track.stamps_ns.append(stamp)
        track.poses.append(row)
        track.covariances.append(np.asarray(pose.covariance, dtype=np.float64).reshape(6, 6)[:3, :3])
        track.speeds_m_s.append(float(np.linalg.norm((twist.linear.x, twist.linear.y, twist.linear.z))))

    def _add_fix(self, topic: str, message: Any, time_ns: int) -> None:  # noqa: ARG002
        point = Geodetic(message.latitude, message.longitude, message.altitude)
        if not np.isfinite(point).all() or message.status.status < 0:
            return
        if topic.endswith(DATUM):
            self._world = LocalFrame(point)
            return
        if self._world is None:
            if self._awaits_datum:
                return
            self._world = LocalFrame(point)
        track = self._fixes.setdefault(topic, self._new_track("map"))
        track.stamps_ns.append(_stamp_ns(message.header))
        track.poses.append(self._world.to_enu(point))
        track.covariances.append(np.asarray(message.position_covariance, dtype=np.float64).reshape(3, 3))

    def _add_transforms(self, topic: str, message: Any, time_ns: int) -> None:  # noqa: ARG002
        for transform in message.transforms:
            child = transform.child_frame_id
            self._parents[child] = transform.header.frame_id
            t, q = transform.transform.translation, transform.transform.rotation
            stamps_ns, poses = self._transforms.setdefault(child, ([], []))
            stamps_ns.append(_stamp_ns(transform.header))
            poses.append(np.array((t.x, t.y, t.z, q.x, q.y, q.z, q.w)))
            self._clouds.add_transform(transform.header.frame_id, child, stamps_ns[-1], poses[-1])

    def _add_diagnostics(self, topic: str, message: Any, time_ns: int) -> None:
        for status in message.status:
            entity = f"log{topic}/{status.name.replace(': /', '/').replace(' ', '_')}"
            if self._statuses.get(entity) != status.message:
                self._statuses[entity] = status.message
                level = "INFO" if int(status.level) == 0 else "WARN"
                self.write(entity, f"{status.name}: {status.message}", level, _stamp_ns(message.header) or time_ns)

    def _add_cloud(self, topic: str, message: Any, time_ns: int) -> None:  # noqa: ARG002
        stamp_ns = _stamp_ns(message.header)
        self._recording.set_time(TIMELINE, timestamp=np.datetime64(stamp_ns, "ns"))
        drawn = self._clouds.draw(self._recording, self._entity(message.header.frame_id, topic), message)
        self._maps |= set() if drawn is None else {drawn}

    def _add_log(self, topic: str, message: Any, time_ns: int) -> None:
        self.write(
            f"log{topic}", message.msg, LEVELS.get(int(message.level), "INFO"), _time_ns(message.stamp) or time_ns
        )

    def _new_track(self, frame_id: str) -> Track:
        return Track(frame_id, COLOURS[(len(self._tracks) + len(self._fixes)) % len(COLOURS)])

    # --- sending -------------------------------------------------------------------------------------------------

    def _entity(self, frame_id: str, topic: str) -> str:
        return f"{self._frame(frame_id)}{topic}"

    def _frame(self, frame_id: str) -> str:
        """Return the entity of a frame, below those of its parents."""
        path = [frame_id]
        while (parent := self._parents.get(path[0])) is not None and parent not in path:
            path.insert(0, parent)
        return "/" + "/".join(path)

    def _send_transforms(self, child: str, stamps_ns: list[int], poses: Array) -> None:
        entity = self._frame(child)
        columns = rr.Transform3D.columns(translation=poses[:, :3], quaternion=poses[:, 3:])
        self._recording.send_columns(entity, [_times(stamps_ns)], columns)
        self._style(entity, rr.TransformAxes3D(AXIS_M))

    def _send_track(self, topic: str, track: Track) -> None:
        entity, times = self._entity(track.frame_id, topic), _times(track.stamps_ns)
        poses, covariances = np.array(track.poses), np.array(track.covariances)
        positions = poses[:, :3]
        before = positions[:1] if track.last_position is None else track.last_position[None]
        starts = np.vstack([before, positions[:-1]])
        strips = rr.LineStrips3D.columns(strips=np.stack([starts, positions], axis=1), radii=[-1.5] * len(positions))
        self._recording.send_columns(f"{entity}/track", [times], strips)
        self._style(f"{entity}/track", rr.LineStrips3D.from_fields(colors=[track.colour]))
        self._send_ellipsoids(f"{entity}/uncertainty", track, positions, covariances)
        sigmas = np.sqrt(np.maximum(np.trace(covariances, axis1=1, axis2=2), 0.0))
        x, y, z, w = poses[:, 3:].T
        series = {
            "position_sigma_m": sigmas,
            "speed_m_s": np.array(track.speeds_m_s),
            "height_m": positions[:, 2],
            "yaw_deg": np.degrees(np.arctan2(2 * (x * y + z * w), 1 - 2 * (y * y + z * z))),
        }
        for name, values in series.items():
            self._send_series(f"/plots/{name}{topic}", times, values, track.colour)
        track.last_position = positions[-1]
        for gathered in (track.stamps_ns, track.poses, track.covariances, track.speeds_m_s):
            gathered.clear()

    def _send_ellipsoids(self, entity: str, track: Track, positions: Array, covariances: Array) -> None:
        stamps = np.array(track.stamps_ns)
        # the first of each interval of the clock
        _, rows = np.unique(stamps // ELLIPSOID_NS, return_index=True)
        values, vectors = np.linalg.eigh(covariances[rows])
        vectors[np.linalg.det(vectors) < 0, :, 0] *= -1.0
        columns = rr.Ellipsoids3D.columns(
            centers=positions[rows],
            half_sizes=ELLIPSOID_SIGMAS * np.sqrt(np.maximum(values, 0.0)),
            quaternions=quaternions_xyzw(vectors),
        )
        self._recording.send_columns(entity, [_times(stamps[rows].tolist())], columns)
        self._style(entity, rr.Ellipsoids3D.from_fields(colors=[track.colour]))

    def _send_fixes(self, topic: str, track: Track) -> None:
        entity, times = self._entity(track.frame_id, topic), _times(track.stamps_ns)
        self._recording.send_columns(f"{entity}/track", [times], rr.Points3D.columns(positions=np.array(track.poses)))
        dots = rr.Points3D.from_fields(colors=[track.colour], radii=[-2.0])
        self._style(f"{entity}/track", dots)
        sigmas = np.sqrt(np.maximum(np.trace(np.array(track.covariances), axis1=1, axis2=2), 0.0))
        self._send_series(f"/plots/position_sigma_m{topic}", times, sigmas, track.colour)
        for gathered in (track.stamps_ns, track.poses, track.covariances):
            gathered.clear()

    def _style(self, entity: str, style: rr.AsComponents) -> None:
        """Send the style of an entity once."""
        if entity not in self._styled:
            self._styled.add(entity)
            self._recording.log(entity, style, static=True)

    def _send_series(self, entity: str, times: rr.TimeColumn, values: Array, colour: tuple[int, int, int]) -> None:
        self._recording.send_columns(entity, [times], rr.Scalars.columns(scalars=values))
        self._style(entity, rr.SeriesLines(colors=[colour]))


def blueprint(entities: Iterable[str], maps: Iterable[str] = ()) -> rrb.Blueprint:
    """Return the arrangement: space with the tracks up to the cursor, beside it time series and events."""
    past = rrb.VisibleTimeRanges(
        timeline=TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    recent = rrb.VisibleTimeRanges(
        timeline=TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-MAP_S),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    series = [("position_sigma_m", "position sigma [m]"), ("speed_m_s", "speed [m/s]"), ("height_m", "height [m]")]
    series.append(("yaw_deg", "yaw [deg]"))
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(
                origin="/",
                contents=["/**", "- /plots/**", "- /log/**"],
                name="map",
                overrides={**{f"{entity}/track": past for entity in entities}, **dict.fromkeys(maps, recent)},
            ),
            rrb.Vertical(
                *(rrb.TimeSeriesView(origin=f"/plots/{entity}", name=name) for entity, name in series),
                rrb.TextLogView(origin="/log", name="events"),
            ),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(timeline=TIMELINE),
    )


def _times(stamps_ns: list[int]) -> rr.TimeColumn:
    return rr.TimeColumn(TIMELINE, timestamp=np.array(stamps_ns, dtype="datetime64[ns]"))


def _time_ns(stamp: Any) -> int:
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def _stamp_ns(header: Any) -> int:
    return _time_ns(header.stamp)
