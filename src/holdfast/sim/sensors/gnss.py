"""Fixes of the antennas of an RTK-GNSS receiver: quality under the sky, error, claim of the receiver."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from holdfast.config.section import Section, quantity
from holdfast.errors import ConfigError
from holdfast.messages import Array, FixStatus
from holdfast.sim.datasheets import Sheet, SimulatedSensor
from holdfast.sim.effects import Event, offset, overwritten, shifted, silence, spikes, walk
from holdfast.sim.readings import Generators, Readings, slow_vectors
from holdfast.sim.ros import Encode, RosMessages
from holdfast.sim.scene import Sampling, Scene
from holdfast.sim.sensors import SensorKind, register

MESSAGE = "sensor_msgs/msg/NavSatFix"


class FixQuality(Section):
    """Error of a fix of one quality: white noise plus an error that changes slowly, per axis.

    The slow part (multipath, atmosphere) decorrelates with time and, being a pattern in space, with the antenna's path.
    """

    white_horizontal_m: float = quantity("m", ge=0, doc="sigma of the white part, east and north")
    white_vertical_m: float = quantity("m", ge=0, doc="sigma of the white part, up")
    slow_horizontal_m: float = quantity("m", ge=0, doc="sigma of the slow part, east and north")
    slow_vertical_m: float = quantity("m", ge=0, doc="sigma of the slow part, up")
    time_constant_s: float = quantity("s", 60.0, gt=0, doc="the slow part decorrelates in this time")
    distance_constant_m: float = quantity("m", 0.5, gt=0, doc="and over this distance of the antenna")


class OfReceiver(SimulatedSensor):
    """What the GNSS receiver measures, at the epochs of its fastest antenna."""

    def first_s(self, name: str, sheets: Mapping[str, Sheet], generators: Generators) -> float:  # noqa: ARG002
        """Return the first epoch, which antennas, headings and velocities share."""
        fastest_hz = max((antenna.rate_hz for antenna in antennas_of(sheets).values()), default=self.rate_hz)
        return float(generators("receiver", "phase").uniform(0.0, 1.0 / fastest_hz))


class SimulatedGnss(OfReceiver):
    """One antenna of an RTK receiver.

    The fixed solution follows carrier-phase noise and multipath of geodetic antennas: 8 mm horizontally and 15 mm
    vertically in all, which is what the datasheets of machine control receivers claim.
    """

    kind: Literal["gnss"]
    rtk_fixed: FixQuality = FixQuality(
        white_horizontal_m=0.007, white_vertical_m=0.0125, slow_horizontal_m=0.004, slow_vertical_m=0.008
    )
    rtk_float: FixQuality = FixQuality(
        white_horizontal_m=0.03,
        white_vertical_m=0.05,
        slow_horizontal_m=0.3,
        slow_vertical_m=0.5,
        time_constant_s=30.0,
        distance_constant_m=10.0,
    )
    single: FixQuality = FixQuality(
        white_horizontal_m=0.3,
        white_vertical_m=0.5,
        slow_horizontal_m=1.5,
        slow_vertical_m=2.5,
        time_constant_s=60.0,
        distance_constant_m=20.0,
    )
    shared_ratio: float = quantity(
        "1", 0.3, ge=0, le=1, doc="fraction of the slow variance that all antennas have in common"
    )
    claim_ratio: float = quantity("1", 1.0, gt=0, doc="claimed sigma over the true one: 1 is an honest receiver")
    float_below: float = quantity("1", 0.6, ge=0, le=1, doc="with less open sky the fix falls to float")
    single_below: float = quantity("1", 0.35, ge=0, le=1, doc="with less open sky to single")
    none_below: float = quantity("1", 0.12, ge=0, le=1, doc="with less open sky there is none")
    refix_s: float = quantity("s", 6.0, ge=0, doc="good sky for so long resolves the ambiguities again")


class Quality(IntEnum):
    """How a fix was computed, the better the higher."""

    NONE = 0
    SINGLE = 1
    RTK_FLOAT = 2
    RTK_FIXED = 3


DIAGONAL_KNOWN = 2  # NavSatFix.position_covariance_type
STATUS = {Quality.NONE: FixStatus.NO_FIX, Quality.SINGLE: FixStatus.FIX, Quality.RTK_FLOAT: FixStatus.GBAS}
GPS_GLONASS_GALILEO = 1 | 2 | 8


@dataclass(frozen=True, slots=True, eq=False)
class Antenna:
    """One antenna at its fixes.

    Attributes:
        times_s: (N,) true times of the fixes, increasing.
        p_W: (N, 3) true position of the antenna [m].
        quality: (N,) `Quality` of each fix.
    """

    sheet: SimulatedGnss
    times_s: Array
    p_W: Array
    quality: NDArray[np.int64]


def measure(at: Sampling) -> Readings:
    """Return the fixes of one antenna, as `gnss_readings`."""
    leader = next(iter(antennas_of(at.scene.sheets)))
    antennas = {name: antenna_at(at.scene, name, at.scene.times_s(name)) for name in (leader, at.name)}
    return gnss_readings(antennas, at.scene.generator)[at.name]


def antennas_of(sheets: Mapping[str, Sheet]) -> dict[str, SimulatedGnss]:
    """Return the datasheets of the antennas among those of all sensors."""
    return {name: sheet for name, sheet in sheets.items() if isinstance(sheet, SimulatedGnss)}


def antenna_at(scene: Scene, name: str, times_s: Array) -> Antenna:
    """Return an antenna at true times (N,), with the quality of its fixes under the sky that it sees."""
    sheet = antennas_of(scene.sheets)[name]
    quality = fix_quality(sheet, times_s, scene.open_sky(sheet.frame, times_s))
    return Antenna(sheet, times_s, scene.motion.frame(sheet.frame, times_s).p_W, quality)


def fix_quality(sheet: SimulatedGnss, times_s: Array, sky_view: Array) -> NDArray[np.int64]:
    """Return the `Quality` (N,) of fixes under these fractions of open sky (N,), 0 to 1.

    Quality falls at once; only `refix_s` of uninterrupted good sky resolve the ambiguities again, and the fix is float
    until then. Where the recording begins under good sky, they are resolved.
    """
    falls = [sky_view < sheet.none_below, sky_view < sheet.single_below, sky_view < sheet.float_below]
    quality = np.select(falls, [Quality.NONE, Quality.SINGLE, Quality.RTK_FLOAT], Quality.RTK_FIXED).astype(np.int64)
    row = np.arange(len(quality))
    last_bad = np.maximum.accumulate(np.where(quality < Quality.RTK_FIXED, row, -1))
    good_s = times_s - times_s[np.minimum(last_bad + 1, row)]
    resolving = (last_bad >= 0) & (good_s < sheet.refix_s) & (last_bad < row)
    quality[resolving] = Quality.RTK_FLOAT
    return quality


def gnss_readings(antennas: Mapping[str, Antenna], generators: Generators) -> dict[str, Readings]:
    """Return the fixes of all antennas by sensor name.

    The slow error has a part that all antennas share, because it comes from the atmosphere and from multipath that
    they all see; the first antenna leads it, so that a second one never changes the errors of the first.

    Columns:
        position: (N, 3) p_W of the antenna as the receiver reports it [m]; means nothing where the quality is NONE.
        error: (N, 3) position minus truth [m].
        sigma: (N, 3) claimed standard deviation east, north, up [m].
        quality: (N,) `Quality`.
        truth: (N, 3) true p_W of the antenna [m].
        faulty: (N,) whether a fault moved the fix by more than its claim; here nowhere.
    """
    readings = {}
    for name, (error, sigma) in fix_errors(antennas, generators).items():
        antenna = antennas[name]
        columns = {"position": antenna.p_W + error, "error": error, "sigma": sigma, "quality": antenna.quality}
        columns |= {"truth": antenna.p_W, "faulty": np.zeros(len(error), dtype=bool)}
        readings[name] = Readings(antenna.times_s, columns)
    return readings


def fix_errors(antennas: Mapping[str, Antenna], generators: Generators) -> dict[str, tuple[Array, Array]]:
    """Return error and claimed sigma of every fix, both (N, 3) east, north, up [m], by sensor name.

    error = w n + s (sqrt(r) c + sqrt(1 - r) o) with white noise n and two Gauss-Markov processes c (shared) and o (own)
    of unit variance, w and s the sigmas of the fix's quality and r the shared ratio. The processes decorrelate with
    time and with the antenna's path: their steps are dt / time_constant + ds / distance_constant.
    """
    errors: dict[str, tuple[Array, Array]] = {}
    if not antennas:
        return errors
    leader = next(iter(antennas.values()))
    shared = _slow(leader, generators("gnss", "shared error"))
    for name, antenna in antennas.items():
        rng = generators(name, "fix error")
        white, slow, _ = _datasheet_rows(antenna)
        noise = white * rng.standard_normal(antenna.p_W.shape)
        common = shared[np.searchsorted(leader.times_s, antenna.times_s, side="right").clip(1) - 1]
        ratio = antenna.sheet.shared_ratio
        drift = slow * (np.sqrt(ratio) * common + np.sqrt(1.0 - ratio) * _slow(antenna, rng))
        errors[name] = noise + drift, antenna.sheet.claim_ratio * np.hypot(white, slow)
    return errors


def _slow(antenna: Antenna, rng: np.random.Generator) -> Array:
    """Return three Gauss-Markov processes (N, 3) of unit variance along the antenna's fixes."""
    _, _, constants = _datasheet_rows(antenna)
    distance = np.linalg.norm(np.diff(antenna.p_W, axis=0, prepend=antenna.p_W[:1]), axis=1)
    elapsed = np.diff(antenna.times_s, prepend=antenna.times_s[:1])
    steps = elapsed / constants[:, 0] + distance / constants[:, 1]
    return slow_vectors(rng, steps)


def _datasheet_rows(antenna: Antenna) -> tuple[Array, Array, Array]:
    """Return sigmas of the white and the slow part (N, 3) [m], time and distance constant (N, 2) [s, m].

    Where there is no solution the numbers of a single fix stand in: the rows are kept, but nobody may use them.
    """
    sheet = antenna.sheet
    table = [[number for _, number in fix] for fix in (sheet.single, sheet.single, sheet.rtk_float, sheet.rtk_fixed)]
    rows = np.array(table)[antenna.quality]
    return rows[:, [0, 0, 1]], rows[:, [2, 2, 3]], rows[:, 4:]


def outage(event: Event, name: str) -> Readings:
    """Remove the rows; or let a fix wander off at a constant random velocity, as float, with a claim that covers it.

    The antennas share as much of the velocity as of their slow error.
    """
    growth, sheet = event.fault.claim_growth_m_s, antennas_of(event.sheets)[name]
    if growth is None:
        return silence(event, name)
    before = event.readings[name]
    claim = growth * event.elapsed_s(name)
    common, own = (event.generators(purpose).standard_normal(3) for purpose in ("shared error", name))
    course = np.sqrt(sheet.shared_ratio) * common + np.sqrt(1.0 - sheet.shared_ratio) * own
    quality = before.values["quality"]
    return before.replaced(
        position=before.values["position"] + claim / sheet.claim_ratio * course,
        error=before.values["error"] + claim / sheet.claim_ratio * course,
        sigma=np.hypot(before.values["sigma"], claim),
        quality=np.where(event.inside(name), np.minimum(quality, Quality.RTK_FLOAT), quality),
    )


def degraded(event: Event, name: str) -> Readings:
    """Draw the errors of better fixes anew from the lower quality, for all antennas of the fault together."""
    quality = int(Quality[event.fault.quality.upper()])
    antennas: dict[str, Antenna] = {}
    rows: dict[str, NDArray[np.bool_]] = {}
    for sensor in (sensor for sensor in event.fault.sensors if sensor in event.readings):
        readings = event.readings[sensor]
        rows[sensor] = event.inside(sensor) & (readings.values["quality"] > quality)
        fixes = readings.taken(rows[sensor])
        qualities = np.full(len(fixes.times_s), quality)
        antennas[sensor] = Antenna(antennas_of(event.sheets)[sensor], fixes.times_s, fixes.values["truth"], qualities)
    error, sigma = fix_errors(antennas, event.generators)[name]
    fresh = {
        "position": antennas[name].p_W + error,
        "error": error,
        "sigma": sigma,
        "quality": antennas[name].quality,
        "faulty": np.zeros(len(error), dtype=bool),
    }
    return overwritten(event.readings[name], rows[name], fresh)


def exchanged(event: Event) -> list[str]:
    """Return the two antennas of an exchange: those named, with another one if only one is; none if none is."""
    antennas = antennas_of(event.sheets)
    if not antennas.keys() & set(event.fault.sensors):
        return []
    return sorted(antennas, key=lambda name: name not in event.fault.sensors)[:2]


def exchange(event: Event, name: str) -> Readings:
    """Give an antenna the other's fix of the nearest time."""
    pair = exchanged(event)
    if name not in (*pair, *event.fault.sensors):
        return event.readings[name]
    if len(pair) < 2 or any(sensor not in event.readings or not len(event.readings[sensor].times_s) for sensor in pair):
        raise ConfigError(f"faults: a swap at {event.fault.start_s:g} s needs fixes of two antennas")
    before, inside = event.readings[name], event.inside(name)
    other = event.readings[pair[name == pair[0]]]
    middle_s = (other.times_s[1:] + other.times_s[:-1]) / 2.0
    fixes = other.taken(np.searchsorted(middle_s, before.times_s[inside])).values
    fresh = {column: fixes[column] for column in ("sigma", "quality")}
    shift = np.zeros_like(before.values["position"])
    shift[inside] = fixes["position"] - before.values["position"][inside]
    return shifted(overwritten(before, inside, fresh), shift)


def encode(ros: RosMessages, sheet: SimulatedGnss, readings: Readings) -> Encode:
    """Return what makes a sensor_msgs/NavSatFix."""
    positions, sigmas, qualities = (readings.values[name] for name in ("position", "sigma", "quality"))

    def encode(row: int, stamp_ns: int) -> Any:
        point = ros.world.to_geodetic(positions[row])
        status = int(STATUS.get(qualities[row], FixStatus.GBAS))
        return ros.make(
            MESSAGE,
            header=ros.header(stamp_ns, sheet.frame),
            status=ros.make("sensor_msgs/msg/NavSatStatus", status=status, service=GPS_GLONASS_GALILEO),
            latitude=point.latitude_deg,
            longitude=point.longitude_deg,
            altitude=point.altitude_m,
            position_covariance=np.diag(sigmas[row] ** 2).ravel(),
            position_covariance_type=DIAGONAL_KNOWN,
        )

    return encode


FAULTS = {"outage": outage, "degraded": degraded, "walk": walk, "offset": offset, "spikes": spikes, "swap": exchange}
register(
    SensorKind(
        SimulatedGnss, measure, MESSAGE, encode, faults=FAULTS, side_effects={"swap": exchange}, gives_heading=True
    )
)
