"""The files: CSV and LAS in the coordinates of the target; GeoJSON and KML in WGS84, as their standards ask for.

Each is written whole or not at all. GeoJSON: RFC 7946. KML: OGC 12-007r2. LAS: ASPRS 1.4 R15, points of format 6
(laspy, the extra `export`).
"""

import json
from datetime import UTC, datetime
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from holdfast.errors import ConfigError
from holdfast.export.target import SurveyedTrack
from holdfast.extras import needing
from holdfast.whole_file import whole, write_whole

LEAPS = (("2006-01-01", 14), ("2009-01-01", 15), ("2012-07-01", 16), ("2015-07-01", 17), ("2017-01-01", 18))
GPS_EPOCH_S, ADJUSTED_S = 315_964_800, 1_000_000_000  # 1980-01-06 since 1970; what LAS takes off GPS time
FIRST_UTC_NS = 10**18  # of 2001: smaller stamps count from elsewhere
LAS_SCALE_M = 0.001


def write_csv(track: SurveyedTrack, file: Path) -> None:
    """Write a row per pose: time, coordinates of the target with 4 decimals (degrees: 9), attitude."""
    target = track.target
    digits = 9 if target.columns[0].endswith("_deg") else 4
    row = f"%d.%09d,%.{digits}f,%.{digits}f,%.4f,%.4f,%.4f,%.4f\n"
    with whole(file) as part, part.open("w", encoding="utf-8", newline="") as stream:
        stream.write(f"time_s,{','.join(target.columns)},{target.heights.column},roll_deg,pitch_deg,heading_deg\n")
        for stamp_ns, at, angles in zip(
            track.stamps_ns.tolist(), track.coordinates.tolist(), track.roll_pitch_heading_deg.tolist(), strict=True
        ):
            stream.write(row % (*divmod(stamp_ns, 1_000_000_000), *at, *angles))


def write_geojson(track: SurveyedTrack, file: Path) -> None:
    """Write one LineString: longitude, latitude [deg], height above the WGS84 ellipsoid [m]."""
    points = [
        [round(longitude, 9), round(latitude, 9), round(height, 4)]
        for latitude, longitude, height in track.geodetic.tolist()
    ]
    properties = {"name": "track", "heights": "above the WGS84 ellipsoid", "start": _utc(track, 0), "end": _utc(track)}
    feature = {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": "LineString", "coordinates": points},
    }
    write_whole(file, json.dumps({"type": "FeatureCollection", "features": [feature]}) + "\n")


def write_kml(track: SurveyedTrack, file: Path) -> None:
    """Write one LineString; its altitudes are above the sea, or it is laid on the ground where those are not known."""
    is_known = track.target.heights.is_above_sea
    heights = track.coordinates[:, 2] if is_known else track.geodetic[:, 2]
    rows = zip(track.geodetic[:, 1].tolist(), track.geodetic[:, 0].tolist(), heights.tolist(), strict=True)
    text = "\n".join(f"{longitude:.9f},{latitude:.9f},{height:.3f}" for longitude, latitude, height in rows)
    times = f"<TimeSpan><begin>{_utc(track, 0)}</begin><end>{_utc(track)}</end></TimeSpan>" if _utc(track) else ""
    write_whole(
        file,
        '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2">\n<Document>'
        f"<name>{escape(track.target.name)}</name>\n<Placemark><name>track</name>{times}\n<LineString>"
        f"<altitudeMode>{'absolute' if is_known else 'clampToGround'}</altitudeMode>\n<coordinates>\n{text}\n"
        "</coordinates></LineString></Placemark>\n</Document>\n</kml>\n",
    )


def write_las(track: SurveyedTrack, file: Path) -> None:
    """Write a point per pose with its time (adjusted standard GPS time) and roll, pitch, heading as extra bytes.

    Raises:
        ConfigError: the coordinates are degrees, the stamps are no times since 1970, or laspy is not installed.
    """
    if track.target.columns[0].endswith("_deg"):
        raise ConfigError(f"{file}: LAS takes metres (allowed: --crs with a projected system, or --site-grid)")
    if int(track.stamps_ns[0]) < FIRST_UTC_NS:
        raise ConfigError(f"{file}: LAS takes GPS time, and the stamps of this track do not count from 1970")
    with needing("LAS", "export"):
        import laspy
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets = np.floor(track.coordinates.mean(axis=0))
    header.scales = np.full(3, LAS_SCALE_M)
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.generating_software = "Holdfast"
    header.add_extra_dims([laspy.ExtraBytesParams(f"{name}_deg", "f8") for name in ("roll", "pitch", "heading")])
    if track.target.crs is not None:
        header.add_crs(track.target.crs)
    las = laspy.LasData(header)
    las.x, las.y, las.z = track.coordinates.T
    las.gps_time = gps_seconds(track.stamps_ns) - ADJUSTED_S
    for name, values in zip(("roll", "pitch", "heading"), track.roll_pitch_heading_deg.T, strict=True):
        las[f"{name}_deg"] = values
    with whole(file) as part:
        las.write(str(part))


def gps_seconds(stamps_ns: np.ndarray[tuple[int], np.dtype[np.int64]]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return GPS time (N,) [s] of stamps in UTC; leap seconds as announced until 2025."""
    since = np.array([datetime.fromisoformat(f"{day}T00:00:00+00:00").timestamp() for day, _ in LEAPS])
    leaps = np.array([13, *(leap for _, leap in LEAPS)])[np.searchsorted(since, stamps_ns // 10**9, side="right")]
    seconds: np.ndarray[tuple[int], np.dtype[np.float64]] = (stamps_ns - GPS_EPOCH_S * 10**9) * np.float64(1e-9) + leaps
    return seconds


def _utc(track: SurveyedTrack, index: int = -1) -> str | None:
    stamp_ns = int(track.stamps_ns[index])
    if stamp_ns < FIRST_UTC_NS:
        return None
    return f"{datetime.fromtimestamp(stamp_ns // 10**9, UTC):%Y-%m-%dT%H:%M:%S}.{stamp_ns // 10**6 % 1000:03d}Z"


FORMATS = {".csv": write_csv, ".geojson": write_geojson, ".json": write_geojson, ".kml": write_kml, ".las": write_las}
"""What writes a file, by its suffix."""
