# ruff: noqa: ARG001, PLR0917 - arguments that only have to be handed over
"""Measures what it costs to call a compiled function, with cold and with warm caches: decision 027.

    python benchmarks/calls.py

The function adds two numbers that lie in arrays of records; GTSAM integrating and predicting one sample stands beside
it. Before each call with cold caches 6 MB are written.
"""

import sys
from time import perf_counter_ns

import numba
import numpy as np
from numba import cfunc, njit

from holdfast.bench.realtime import Floor
from holdfast.kernel.addresses import records_at
from holdfast.kernel.types import BOOL, INT64, READING, VECTOR
from holdfast.messages import ImuSample

CALLS = 1000
RECORD = np.dtype([("number", np.int64), ("matrix", np.float64, (9, 9))])
RECORDS = numba.from_dtype(RECORD)[::1]
BALLAST = np.zeros(6 << 17)


def _of_arrays(a, b, c, d, e, f, g, h, i, j, k, m, number, epoch, stamp_ns, arrival_ns, reading, is_checked):
    a[0].number += number
    return m[0].number + stamp_ns + int(reading[0])


def _of_addresses(address, stamp_ns, arrival_ns, force, rate):
    records = records_at(address, 12, RECORD)
    records[0].number += int(rate[0])
    return records[11].number + stamp_ns + int(force[0])


def _of_numbers(address, stamp_ns, arrival_ns, force, rate):
    records = records_at(address, 12, RECORD)
    records[0].number += rate
    return records[11].number + stamp_ns + force


def doors(records):
    """Return the ways to call, by name; `records` (12,) must stay, as only their address is given."""
    arrays = [np.zeros(1, RECORD) for _ in range(12)]
    force, rate, address, stamp_ns = np.ones(3), np.ones(3), records.ctypes.data, 1 << 60
    types = INT64(*[RECORDS] * 12, INT64, INT64, INT64, INT64, READING, BOOL)
    of_arrays = njit(types)(_of_arrays).get_overload(types)
    types = INT64(INT64, INT64, INT64, VECTOR, VECTOR)
    of_addresses = njit(types)(_of_addresses).get_overload(types)
    through_ctypes = cfunc(INT64(*[INT64] * 5))(_of_numbers).ctypes
    sample, floor = ImuSample(stamp_ns, stamp_ns, "imu", rate, force), Floor()

    def arrays_and_lists():
        of_arrays(*arrays, 1, 2, stamp_ns, stamp_ns, (*force.tolist(), *rate.tolist()), False)

    return {
        "GTSAM alone": lambda: floor.measure(sample),
        "twelve arrays, six floats": arrays_and_lists,
        "cfunc and ctypes": lambda: through_ctypes(address, stamp_ns, stamp_ns, 1, 1),
        "an address, two arrays": lambda: of_addresses(address, stamp_ns, stamp_ns, force, rate),
    }


def main():
    """Print the medians."""
    records = np.zeros(12, RECORD)
    ways = doors(records)
    took_ns = {name: ([], []) for name in ways}
    for _ in range(CALLS):
        for name, call in ways.items():
            for times_ns, is_cold in zip(took_ns[name], (True, False), strict=True):
                if is_cold:
                    BALLAST[:] += 1.0
                began_ns = perf_counter_ns()
                call()
                times_ns.append(perf_counter_ns() - began_ns)
    sys.stdout.write(f"{'[us], median':28}{'cold':>8}{'warm':>8}\n")
    for name, (cold, warm) in took_ns.items():
        sys.stdout.write(f"{name:28}{np.median(cold) / 1e3:8.1f}{np.median(warm) / 1e3:8.1f}\n")


if __name__ == "__main__":
    main()
