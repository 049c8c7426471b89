"""Fixes of one or two RTK-GNSS antennas: their quality under the sky, their error and what the receiver claims."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array
from holdfast.sim.datasheets import SimulatedGnss
from holdfast.sim.readings import Readings, slow_noise

Generators = Callable[..., np.random.Generator]
"""Random numbers by the names of their purpose: `partial(generator, seed)`."""


class Quality(IntEnum):
    """How a fix was computed, the better the higher."""

    NONE = 0
    SINGLE = 1
    RTK_FLOAT = 2
    RTK_FIXED = 3


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


def fix_quality(sheet: SimulatedGnss, times_s: Array, sky_view: Array) -> NDArray[np.int64]:
    """Return the `Quality` (N,) of fixes under these shares of open sky (N,), 0 to 1.

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

    The slow error has a part that both antennas share, because it comes from the atmosphere and from multipath that
    they both see; the first antenna leads it, so that a second one never changes the errors of the first.

    Columns:
        position: (N, 3) p_W of the antenna as the receiver reports it [m]; means nothing where the quality is NONE.
        error: (N, 3) position minus truth [m].
        sigma: (N, 3) claimed standard deviation east, north, up [m].
        quality: (N,) `Quality`.
        truth: (N, 3) true p_W of the antenna [m].
        lying: (N,) whether a fault moved the fix by more than its claim; here nowhere.
    """
    return {name: _readings(antennas[name], *errors) for name, errors in fix_errors(antennas, generators).items()}


def fix_errors(antennas: Mapping[str, Antenna], generators: Generators) -> dict[str, tuple[Array, Array]]:
    """Return error and claimed sigma of every fix, both (N, 3) east, north, up [m], by sensor name.

    error = w n + s (sqrt(r) c + sqrt(1 - r) o) with white noise n and two Gauss-Markov processes c (shared) and o (own)
    of unit variance, w and s the sigmas of the fix's quality and r the shared ratio. The processes decorrelate with
    time and with the antenna's way: their steps are dt / time_constant + ds / distance_constant.
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


def _readings(antenna: Antenna, error: Array, sigma: Array) -> Readings:
    columns = {
        "position": antenna.p_W + error,
        "error": error,
        "sigma": sigma,
        "quality": antenna.quality,
        "truth": antenna.p_W,
        "lying": np.zeros(len(antenna.times_s), dtype=bool),
    }
    return Readings(antenna.times_s, columns)


def _slow(antenna: Antenna, rng: np.random.Generator) -> Array:
    """Return three Gauss-Markov processes (N, 3) of unit variance along the antenna's fixes."""
    _, _, constants = _datasheet_rows(antenna)
    way = np.linalg.norm(np.diff(antenna.p_W, axis=0, prepend=antenna.p_W[:1]), axis=1)
    elapsed = np.diff(antenna.times_s, prepend=antenna.times_s[:1])
    steps = elapsed / constants[:, 0] + way / constants[:, 1]
    return np.stack([slow_noise(rng, steps) for _ in range(3)], axis=1)


def _datasheet_rows(antenna: Antenna) -> tuple[Array, Array, Array]:
    """Return sigmas of the white and the slow part (N, 3) [m], time and distance constant (N, 2) [s, m].

    Where there is no solution the numbers of a single fix stand in: the rows are kept, but nobody may use them.
    """
    sheet = antenna.sheet
    table = np.array(
        [
            [fix.white_horizontal_m] * 2
            + [fix.white_vertical_m]
            + [fix.slow_horizontal_m] * 2
            + [fix.slow_vertical_m, fix.time_constant_s, fix.distance_constant_m]
            for fix in (sheet.single, sheet.single, sheet.rtk_float, sheet.rtk_fixed)
        ]
    )
    rows = table[antenna.quality]
    return rows[:, :3], rows[:, 3:6], rows[:, 6:]
