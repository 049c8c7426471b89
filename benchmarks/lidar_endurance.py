"""An hour of scans through one lidar odometry: the memory of its process and the time per scan, over time.

    holdfast simulate construction --scans --duration 3600 -o hour
    python benchmarks/lidar_endurance.py hour

The process works as in a replay, guided by the IMU, as fast as it can. Prints a row every few minutes of recording, and
exits with 1 if memory has grown by more than 5 % since the map has been as old as it gets, or if the time per scan has
by more than a quarter. Times depend on what else the machine does: lower quartiles are shown. Needs Linux.
"""

import argparse
import os
import sys
from collections import deque
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
from endurance import resident_mb

from holdfast.config.load import load_config
from holdfast.lidar_odometry.in_step import InStep
from holdfast.lidar_odometry.runner import Options, choose_topic, guide_of
from holdfast.lidar_odometry.scan_map import MEMORY_SWEEPS
from holdfast.recording.decode import stamp_ns
from holdfast.recording.kinds.scans import point_cloud
from holdfast.recording.raw import RawBag

ALLOWED_MEMORY, ALLOWED_TIME = 1.05, 1.25
HEADER = f"{'minutes':>8} {'scans':>7} {'memory MB':>10} {'ms to the pose':>15} {'ms of processor':>16}"
TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def processor_s(pid: int) -> float:
    """Return what a process has used of the processor."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S


def rows(folder: Path, row_minutes: float) -> Iterator[tuple[float, ...]]:
    """Yield minutes, scans, memory [MB], time from scan to pose and of the processor per scan [ms]."""
    options = Options(replace=True)
    with RawBag(folder / "recording.mcap") as bag:
        topic = choose_topic(bag, options)
        guide = guide_of(load_config(folder / "config.yaml"), bag, options)
        codecs = {channel: channel.codec() for channel in bag.channels if channel.topic in {topic, guide.imu_topic}}
        with closing(InStep(guide.settings, 0.0, restarts=False)) as odometry:
            since, used_s, next_ns = 0, 0.0, bag.recording.start_ns + row_minutes * 60e9
            for arrival_ns, channel, raw in bag.messages():
                if channel not in codecs:
                    continue
                message = codecs[channel].deserialize(raw)
                if channel.topic != topic:
                    odometry.add_sample(guide.decode(message, arrival_ns))
                    continue
                odometry.add_scan(point_cloud(stamp_ns(message), arrival_ns, "", message))
                is_row = arrival_ns >= next_ns
                deque(odometry.due(None if is_row else arrival_ns - 10**9), maxlen=0)
                if not is_row:
                    continue
                assert odometry.pid is not None
                took_ms, cpu_s = odometry.account.took_ms[since:], processor_s(odometry.pid)
                yield (
                    (arrival_ns - bag.recording.start_ns) / 60e9,
                    odometry.account.poses,
                    resident_mb(odometry.pid),
                    float(np.percentile(took_ms, 25.0)),
                    (cpu_s - used_s) / len(took_ms) * 1e3,
                )
                since, used_s, next_ns = since + len(took_ms), cpu_s, next_ns + row_minutes * 60e9
            print(f"new maps: {odometry.account.new_maps}, refused: {odometry.account.refused}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="that `holdfast simulate --scans` wrote")
    parser.add_argument("--row-minutes", type=float, default=5.0, help="of recording per row of the table")
    arguments = parser.parse_args()
    print(HEADER)
    found = []
    for row in rows(arguments.folder, arguments.row_minutes):
        print("{:8.1f} {:7.0f} {:10.1f} {:15.1f} {:16.1f}".format(*row), flush=True)
        found.append(row)
    full = [row for row in found if row[1] > MEMORY_SWEEPS]
    if len(full) < 2:
        print(f"too short: the map remembers {MEMORY_SWEEPS} scans")
        return 0
    memory, time = (full[-1][column] / full[0][column] for column in (2, 3))
    print(f"memory {memory - 1.0:+.1%}, time to the pose {time - 1.0:+.1%} since {full[0][0]:.0f} minutes")
    return int(memory > ALLOWED_MEMORY or time > ALLOWED_TIME)


if __name__ == "__main__":
    sys.exit(main())
