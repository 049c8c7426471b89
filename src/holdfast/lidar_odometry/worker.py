"""The process of one lidar odometry: a registration holds the interpreter's lock for whole scans.

Started as `python -m holdfast.lidar_odometry.worker CONNECTION SLOT SLOT`: inherited descriptors. The first message on
the connection are the settings, each further one a `Request`, answered by an `Answer`. The process ends when the
connection closes, and with the process that started it, however that ends.
"""

import os
import signal
import sys
from multiprocessing.connection import Connection
from time import perf_counter_ns, process_time

from holdfast.lidar_odometry.scan_odometry import ScanOdometry, Settings
from holdfast.lidar_odometry.shared_scan import READY, Answer, Request, Slot
from holdfast.parent import die_with_parent
from holdfast.recording.decode import UndecodableError


def serve(connection: Connection, slots: list[Slot], settings: Settings) -> None:
    """Answer each request until the other end closes."""
    odometry = ScanOdometry(settings)
    connection.send(Answer(READY))
    while True:
        request: Request = connection.recv()
        began_ns = perf_counter_ns()
        registered, refusal = None, ""
        try:
            registered = odometry.register(request.cloud(slots[request.slot].read(request.size)), request.samples)
        except UndecodableError as error:
            refusal = str(error)
        took_ns = perf_counter_ns() - began_ns
        connection.send(Answer(request.number, registered, refusal, took_ns, process_time()))
        odometry.finish()  # while the pose is on its way


def main() -> None:
    """Run the odometry for the process that started this one."""
    for number in (signal.SIGINT, signal.SIGTERM):  # whoever started this process decides when it ends
        signal.signal(number, signal.SIG_IGN)
    die_with_parent()
    descriptor, *slots = (int(text) for text in sys.argv[1:])
    connection = Connection(descriptor)
    try:
        settings, placement = connection.recv()
        if placement.cores is not None and hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, placement.cores)
        os.nice(placement.nice)
        serve(connection, [Slot(slot) for slot in slots], settings)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except Exception as error:  # whatever a library throws, the other end reports it in one line
        text = " ".join(str(error).split())
        connection.send(Answer(READY, fault=f"failed: {type(error).__name__}: {text}"))
        sys.exit(1)


if __name__ == "__main__":
    main()
