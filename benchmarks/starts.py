"""Prints how well the heading is known where the estimator starts in motion: `python benchmarks/starts.py`.

Each drive of `drives/` is begun at several times, with what `config init` writes: as it is, without Doppler velocities,
with claims that are ten times too large or too small, and without claims. The heading of the first estimate is compared
with that of the estimator that has driven for half a minute or longer by then; NEES is 1 for a start that says honestly
how well it knows its heading, and more for one that is too sure. The configuration admits fixes of any claim.
"""

import argparse
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
from drives import messages_of, recorded_in, starter_config

from holdfast.config.model import Config
from holdfast.config.sensors import GnssConfig
from holdfast.estimator.estimator import Estimator
from holdfast.messages import FixStatus, GnssFix, GnssVelocity, Message

FRACTIONS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)  # of the drive, at which it is begun
GIVEN_UP_S, SETTLED_NS = 150.0, 30_000_000_000
ANY_SIGMA_M = 1e3


class Start(NamedTuple):
    """One start: after how long [s], heading off by and known to [deg], NaN where there is nothing to compare with.

    `longest_s` is the time that the slowest message took until then.
    """

    after_s: float
    off_deg: float
    sigma_deg: float
    longest_s: float


def scaled(message: Message, factor: float) -> Message:
    """Return a message of a receiver that claims other sigmas."""
    if not isinstance(message, GnssFix | GnssVelocity) or message.covariance is None:
        return message
    return replace(message, covariance=message.covariance * factor**2)


def unclaimed(message: Message) -> Message:
    """Return a fix without a claim, as a receiver on its own."""
    return replace(message, covariance=None, status=FixStatus.FIX) if isinstance(message, GnssFix) else message


def without_doppler(message: Message) -> Message | None:
    """Return a message unless it is a Doppler velocity."""
    return None if isinstance(message, GnssVelocity) else message


VARIANTS: dict[str, Callable[[Message], Message | None]] = {
    "as it is": lambda message: message,
    "without Doppler": without_doppler,
    "claims x 10": partial(scaled, factor=10.0),
    "claims x 0.1": partial(scaled, factor=0.1),
    "without claims": unclaimed,
}


def tolerant(config: Config) -> Config:
    """Return a configuration that admits fixes of any claim."""
    sensors = {
        name: section.model_copy(update={"max_sigma_m": ANY_SIGMA_M}) if isinstance(section, GnssConfig) else section
        for name, section in config.sensors.items()
    }
    return config.model_copy(update={"sensors": sensors})


def start(config: Config, messages: Sequence[Message], stamps: np.ndarray, attitudes: np.ndarray) -> Start:
    """Replay until the first estimate; `attitudes` (N, 3, 3) at `stamps` (N,) are those of a long run."""
    estimator, longest_s, first_ns = Estimator(config), 0.0, messages[0].stamp_ns
    for message in messages:
        began = perf_counter()
        estimate = estimator.process(message).estimate
        longest_s = max(longest_s, perf_counter() - began)
        after_s = (message.stamp_ns - first_ns) * 1e-9
        if estimate is not None:
            k = int(np.searchsorted(stamps, estimate.stamp_ns))
            if k == len(stamps) or stamps[k] != estimate.stamp_ns or stamps[k] - stamps[0] < SETTLED_NS:
                return Start(after_s, np.nan, np.nan, longest_s)
            R = estimate.nav.attitude().matrix()
            turned = R @ attitudes[k].T
            sigma_rad = np.sqrt((R @ estimate.covariance[:3, :3] @ R.T)[2, 2])
            off_rad = np.arctan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])
            return Start(after_s, float(np.degrees(off_rad)), float(np.degrees(sigma_rad)), longest_s)
        if after_s > GIVEN_UP_S:
            break
    return Start(np.inf, np.nan, np.nan, longest_s)


def starts(drive: Path) -> dict[str, list[Start]]:
    """Return the starts of one drive by variant. Runs in a process of its own."""
    config = tolerant(starter_config(drive / "bag"))
    messages = messages_of(drive, config)
    estimator = Estimator(config)
    track = [one for one in (estimator.process(message).estimate for message in messages) if one is not None]
    stamps = np.array([one.stamp_ns for one in track])
    attitudes = np.array([one.nav.attitude().matrix() for one in track])
    first_ns, lasts_ns = messages[0].stamp_ns, messages[-1].stamp_ns - messages[0].stamp_ns
    found: dict[str, list[Start]] = {}
    for title, change in VARIANTS.items():
        for fraction in FRACTIONS:
            rest = [one for one in messages if one.stamp_ns >= first_ns + fraction * lasts_ns]
            changed = [one for one in map(change, rest) if one is not None]
            found.setdefault(title, []).append(start(config, changed, stamps, attitudes))
    return found


def main() -> None:
    """Run and print all drives."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data" / "drives")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    drives = recorded_in(given.data)
    if not drives:
        print(f"all drives: skipped, no recording at {given.data}")
        return
    with ProcessPoolExecutor(given.jobs) as pool:
        found = list(pool.map(starts, drives))
    print(
        f"{'':16s} {'starts':>6s} {'never':>6s} {'after s':>8s} {'judged':>7s} {'off deg':>8s} {'p90':>6s}"
        f" {'worst':>6s} {'sigma':>6s} {'NEES':>6s} {'longest ms':>10s}"
    )
    for title in VARIANTS:
        rows = np.array([one for of_drive in found for one in of_drive[title]])
        judged = rows[np.isfinite(rows[:, 1])]
        off = abs(judged[:, 1])
        print(
            f"{title:16s} {len(rows):6d} {np.isinf(rows[:, 0]).sum():6d} {np.median(rows[:, 0]):8.1f} {len(judged):7d}"
            f" {np.median(off):8.2f} {np.quantile(off, 0.9):6.1f} {off.max():6.1f} {np.median(judged[:, 2]):6.1f}"
            f" {np.mean((off / judged[:, 2]) ** 2):6.2f} {1e3 * np.median(rows[:, 3]):10.0f}"
        )


if __name__ == "__main__":
    main()
