"""An hour of work of the realtime engine, compressed: memory of both processes and update time over time.

    python benchmarks/endurance.py --hours 1 --rate 20

The scenario `construction` is simulated for that long (a minute of computing for ten of work) and played `--rate` times
faster than real time. Prints a row every few minutes of work, then what was reported, and exits with 1 if memory has
grown by more than 5 % from the second row to the last, or if a sound estimate was begun anew. Update times depend on
what else the machine does: their lower quartile is shown.
"""

import argparse
import gc
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from holdfast.config.load import load_config
from holdfast.config.model import Config
from holdfast.events import EventKind
from holdfast.messages import Message
from holdfast.realtime.engine import RealtimeEstimator
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.sim.scenario import load_scenario
from holdfast.trial.run import write_simulation

ALLOWED = 1.05
FALSE_ALARMS = EventKind.BEGUN_ANEW, EventKind.ESTIMATE_SUSPECT, EventKind.OPTIMISER_FAULT, EventKind.CLOCK_STEP
HEADER = f"{'minutes':>8} {'IMU path MB':>12} {'optimiser MB':>13} {'update ms':>10} {'behind ms':>10} {'IMU us':>7}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=1.0, help="of work")
    parser.add_argument("--rate", type=float, default=20.0, help="how much faster than real time")
    parser.add_argument("--row-minutes", type=float, default=5.0, help="of work per row of the table")
    arguments = parser.parse_args()
    with TemporaryDirectory(prefix="holdfast-endurance-") as folder:
        write_simulation(load_scenario("construction", {"duration_s": arguments.hours * 3600.0}), 0, Path(folder))
        config = load_config(Path(folder) / "config.yaml")
        with open_recording(folder) as recording:
            messages = recording.read(subscriptions(config))
            events: Counter[EventKind] = Counter()
            rows = list(run(config, messages, arguments, events))
    grown = growth(rows)
    for name, factor in grown.items():
        print(f"{name}: {factor - 1.0:+.1%} from the second row to the last")
    print("reported:", ", ".join(f"{kind} {count}" for kind, count in sorted(events.items())))
    has_grown = any(factor > ALLOWED for name, factor in grown.items() if "memory" in name)
    return int(has_grown or any(events[kind] for kind in FALSE_ALARMS))


def run(
    config: Config, messages: Iterable[Message], arguments: argparse.Namespace, events: Counter[EventKind]
) -> Iterator[tuple[float, ...]]:
    minutes, row_minutes = arguments.hours * 60.0, arguments.row_minutes
    print(HEADER, flush=True)
    with RealtimeEstimator(config) as engine:
        engine.wait_until_ready()
        gc.collect()
        gc.freeze()
        took_ns: list[int] = []
        next_row = row_minutes
        for worked, message in played(messages, arguments.rate):
            began_ns = time.perf_counter_ns()
            output = engine.process(message)
            if output.estimate is not None:
                took_ns.append(time.perf_counter_ns() - began_ns)
            events.update(event.kind for event in engine.take_events())
            if worked >= next_row or (worked >= minutes - 0.1 and next_row < minutes):
                next_row += row_minutes
                updates = engine.take_update_times()
                pids = "self", engine.optimiser_pid
                memory = [resident_mb(pid) for pid in pids]
                newest = engine.newest_state
                assert newest is not None
                behind_ms = (message.stamp_ns - newest.stamp_ns) * 1e-6
                row = (
                    worked,
                    *memory,
                    float(np.percentile(updates, 25.0)) * 1e-6,
                    behind_ms,
                    float(np.median(took_ns)) * 1e-3,
                )
                took_ns.clear()
                print("{:8.1f} {:12.1f} {:13.1f} {:10.2f} {:10.0f} {:7.1f}".format(*row), flush=True)
                yield row


def played(messages: Iterable[Message], rate: float) -> Iterator[tuple[float, Message]]:
    """Yield the minutes of work so far and the next message, at its time."""
    first_ns, began = None, time.perf_counter()
    for message in messages:
        first_ns = first_ns or message.arrival_ns
        at_s = (message.arrival_ns - first_ns) * 1e-9
        ahead_s = at_s / rate - (time.perf_counter() - began)
        if ahead_s > 0.0:
            time.sleep(ahead_s)
        yield at_s / 60.0, message


def resident_mb(pid: int | str | None) -> float:
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024.0
    return float("nan")


def growth(rows: list[tuple[float, ...]]) -> dict[str, float]:
    if len(rows) < 3:
        return {}
    names = {"memory of the IMU path": 1, "memory of the optimiser": 2, "update time": 3}
    return {name: rows[-1][column] / rows[1][column] for name, column in names.items()}


if __name__ == "__main__":
    sys.exit(main())
