"""An hour of scans into one map: the memory of `holdfast map` over time, and at its peak.

    holdfast simulate quick --scans -o quick
    python benchmarks/map_memory.py quick --hours 1

The scans of a simulation are repeated, with the true poses, and each time the machine stands a few metres further, so
that the map grows all the time. Prints a row every few minutes of recording, then the peak after all files are written,
and exits with 1 if memory has grown by more than 10 % from the second row to the last. Needs Linux.
"""

import argparse
import resource
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from holdfast.config.load import load_config
from holdfast.geometry.earth import Geodetic
from holdfast.lidar_odometry.sweep import Sweep
from holdfast.mapping.colours import colouring
from holdfast.mapping.las import Grid, write_las
from holdfast.mapping.options import SiteMapOptions
from holdfast.mapping.picture import draw_above
from holdfast.mapping.ply import write_ply
from holdfast.mapping.site_map import MapBuilder
from holdfast.mapping.source import Scans
from holdfast.recording.raw import RawBag
from holdfast.recording.tum import TumWriter, read_tum

ALLOWED = 1.10
ROWS = 12
HEADER = f"{'minutes':>8} {'scans':>7} {'memory MB':>10} {'disk MB':>8} {'ms a scan':>10}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="that `holdfast simulate --scans` wrote")
    parser.add_argument("--hours", type=float, default=1.0, help="of recording")
    parser.add_argument("--step-m", type=float, default=5.0, help="by which the machine is further in each repetition")
    arguments = parser.parse_args()
    options = SiteMapOptions()
    with TemporaryDirectory(prefix="holdfast-map-memory-", dir=".") as made:
        period_ns, count = repeat_track(arguments, Path(made) / "track.tum")
        trajectory = read_tum(Path(made) / "track.tum")
        config = load_config(arguments.folder / "config.yaml")
        builder = MapBuilder(Path(made), trajectory, config.T_I("lidar"), options)
        print(HEADER, flush=True)
        rows, row_ns, began_s, scans = [], round(arguments.hours * 3600e9 / ROWS), perf_counter(), 0
        first_ns = int(trajectory.stamps_ns[0])
        for sweep in repeated(arguments.folder, period_ns, count):
            builder.add(sweep)
            if sweep.stamp_ns - first_ns >= row_ns * (len(rows) + 1):
                spent_ms = 1e3 * (perf_counter() - began_s) / max(builder.scans - scans, 1)
                began_s, scans = perf_counter(), builder.scans
                disk = sum(file.stat().st_size for file in Path(made).iterdir()) / 1e6
                rows.append(resident_mb())
                minutes = (sweep.stamp_ns - first_ns) / 60e9
                print(f"{minutes:8.1f} {scans:7d} {rows[-1]:10.0f} {disk:8.0f} {spent_ms:10.1f}", flush=True)
        found = builder.finish()
        colours = colouring(found, "height")
        write_ply(found, colours, Path(made) / "map.ply")
        write_las(
            found, colours, Grid(Geodetic(*config.frames.datum.model_dump().values()), None), Path(made) / "map.laz"
        )
        draw_above(found, colours, trajectory, options.voxel_m, Path(made) / "map.png")
        sizes = ", ".join(
            f"{name} {(Path(made) / name).stat().st_size / 1e6:.0f} MB" for name in ("map.ply", "map.laz")
        )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{found.points} points of {found.scans} scans, {found.thinned} thinned; {sizes}")
    print(f"peak resident memory {peak:.0f} MB, files and picture included")
    grown = rows[-1] / rows[1]
    print(f"memory {grown - 1.0:+.1%} from the second row to the last (allowed: {ALLOWED - 1.0:+.0%})")
    return int(grown > ALLOWED)


def repeat_track(arguments: argparse.Namespace, file: Path) -> tuple[int, int]:
    """Write the true poses again and again, each time further east; return the period [ns] and their number."""
    truth = read_tum(arguments.folder / "truth" / "imu_in_world.tum")
    step_ns = int(np.median(np.diff(truth.stamps_ns)))
    period_ns = int(truth.stamps_ns[-1] - truth.stamps_ns[0]) + step_ns
    count = max(1, round(arguments.hours * 3600e9 / period_ns))
    with TumWriter(file) as writer:
        for number in range(count):
            shift = np.array([arguments.step_m * number, 0.0, 0.0])
            writer.extend((truth.stamps_ns + number * period_ns).tolist(), truth.positions + shift, truth.quaternions)
    return period_ns, count


def repeated(folder: Path, period_ns: int, count: int) -> Iterator[Sweep]:
    """Yield the scans of a simulation so many times."""
    for number in range(count):
        with RawBag(folder / "recording.mcap") as bag:
            for sweep in Scans(bag, None, 1.0).read():
                yield replace(sweep, stamp_ns=sweep.stamp_ns + number * period_ns)


def resident_mb() -> float:
    """Return the resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


if __name__ == "__main__":
    sys.exit(main())
