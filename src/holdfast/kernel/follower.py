"""Takes a new optimised state from the memory that the optimiser's process writes, and continues from it.

A state lies there as a row of 64-bit words, in one of two places: number, body, checksum. The body is laid out by
`holdfast.realtime.records`; `START` and what follows say where its parts begin.
"""

from typing import Any

from holdfast.kernel.addresses import floats_at, words_at
from holdfast.kernel.compiling import entry, inner
from holdfast.kernel.imu_path import continue_from_incoming, open_path
from holdfast.kernel.ring import checksum
from holdfast.kernel.samples import forget
from holdfast.kernel.types import INT64

NOTHING, FOLLOWED, UNUSUAL = range(3)
HAS_DATUM, HAS_STATE, IS_FORTRAN, IS_LOST = 1, 2, 4, 8  # flags of a state

# words of a row; the counts of health lie before the gravity
EPOCH, LIFE, RECOVERIES, FLAGS, STAMP, HEALTH = 1, 2, 4, 6, 7, 8
DATUM, STATE, COVARIANCE = 1, 4, 28  # from the gravity on


@inner
def _newest_row(shared: Any) -> int:
    """Copy the newest whole row to where the caller keeps it; return its version, 0 if there is none."""
    slot = words_at(shared.slot_at, 1 + 2 * shared.slot_words, 1)
    taken = words_at(shared.taken_at, shared.slot_words, 1)
    newest = slot[0, 0]
    for version in (newest, newest - 1):
        if version > 0:
            first = 1 + (version % 2) * shared.slot_words
            for k in range(shared.slot_words):
                taken[k, 0] = slot[first + k, 0]
            if taken[0, 0] == version and taken[shared.slot_words - 1, 0] == checksum(taken[:, 0]):
                return version
    return 0


@inner
def _is_usual(path: Any, words: Any, floats: Any) -> bool:
    """Whether a state goes on where the one taken in last was."""
    shared, flags = path.shared, words[FLAGS, 0]
    datum = HEALTH + shared.healths + DATUM
    known = path.is_running != 0 and words[EPOCH, 0] == shared.epoch and words[LIFE, 0] == shared.life
    known = known and flags & HAS_STATE != 0 and flags & HAS_DATUM == shared.flags & HAS_DATUM
    for k in range(3):
        known = known and floats[datum + k, 0] == shared.datum[k]
    return known and not (shared.is_rescued != 0 and words[STAMP, 0] < shared.anchor_ns)


@inner
def _read(path: Any, words: Any, floats: Any) -> None:
    """Let `path.incoming` be the state of a row."""
    incoming, first = path.incoming, HEALTH + path.shared.healths + STATE
    incoming.stamp_ns = words[STAMP, 0]
    for i in range(3):
        for j in range(3):
            incoming.nav.R[i, j] = floats[first + 3 * i + j, 0]
        incoming.nav.p[i], incoming.nav.v[i] = floats[first + 9 + i, 0], floats[first + 12 + i, 0]
        incoming.bias_accel[i], incoming.bias_gyro[i] = floats[first + 15 + i, 0], floats[first + 18 + i, 0]
        incoming.rate[i] = floats[first + 21 + i, 0]
    first = HEALTH + path.shared.healths + COVARIANCE
    down, right = (1, 15) if words[FLAGS, 0] & IS_FORTRAN else (15, 1)
    for i in range(15):
        for j in range(15):
            incoming.P[i, j] = floats[first + down * i + right * j, 0]


# --- what Python calls: compiled here, so it comes last


@entry(INT64, INT64)
def follow(address: int) -> int:
    """Copy the newest state to where the caller keeps it, and continue from it; the caller does that if it is unusual.

    Args:
        address: of the `PATH`.
    """
    paths, propagations, buffers, samples, blocks, works = open_path(address)
    path, held, work = paths[0], buffers[0], works[0]
    shared = path.shared
    version = _newest_row(shared)
    if version == 0:
        return NOTHING
    shared.seen, shared.left = version, 0
    words, floats = words_at(shared.taken_at, shared.slot_words, 1), floats_at(shared.taken_at, shared.slot_words, 1)
    if not _is_usual(path, words, floats):
        return UNUSUAL
    _read(path, words, floats)
    is_recovery = words[RECOVERIES, 0] != shared.recoveries
    continue_from_incoming(path, propagations, held, samples, blocks, work, False, is_recovery)
    shared.recoveries, shared.anchor_ns, shared.is_rescued = words[RECOVERIES, 0], words[STAMP, 0], 0
    shared.rescue_ns = shared.anchor_ns + shared.patience_ns
    forget(held, samples, shared.anchor_ns - shared.kept_ns)
    return FOLLOWED
