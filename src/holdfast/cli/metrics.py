"""What `holdfast evaluate` is to measure, from its options."""

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.errors import ConfigError

if TYPE_CHECKING:
    from holdfast.evaluation.accuracy import Interval, Metrics

ASSOCIATION = ("max_gap_s", "max_difference_s", "reference_offset_s", "reference_lever_arm")  # options


def metrics_of(
    *,
    intervals: tuple[str, ...],
    intervals_file: Path | None,
    association: str,
    max_gap_s: float,
    max_difference_s: float,
    reference_offset_s: float,
    reference_lever_arm: tuple[float, float, float],
    position_only: bool,
    rpe_distance: tuple[float, ...],
    rpe_time: tuple[float, ...],
    rpe_pairs: str,
    kitti: bool,
) -> "Metrics":
    """Return what the options of the command ask for.

    Raises:
        ConfigError: names the option.
    """
    from holdfast.evaluation.accuracy import Metrics
    from holdfast.evaluation.association import Association

    for option, lengths in (("--rpe-distance", rpe_distance), ("--rpe-time", rpe_time)):
        for length in lengths:
            if not 0.0 < length < inf:
                raise ConfigError(f"{option} {length:g}: must be > 0 and finite")
    named = [_interval(text) for text in intervals]
    if intervals_file is not None:
        named += _intervals_of(intervals_file)
    return Metrics(
        rpe_distances_m=rpe_distance,
        rpe_times_s=rpe_time,
        rpe_pairing="all" if rpe_pairs == "all" else "consecutive",
        kitti=kitti,
        intervals=tuple(named),
        association=Association(
            method="nearest" if association == "nearest" else "interpolate",
            max_gap_s=max_gap_s,
            max_difference_s=max_difference_s,
            reference_offset_s=reference_offset_s,
            reference_lever_arm=reference_lever_arm,
            position_only=position_only,
            names={name: f"--{name.replace('_', '-')}" for name in ASSOCIATION},
        ),
    )


def _interval(text: str) -> "Interval":
    from holdfast.evaluation.accuracy import Interval

    name, _, span = text.rpartition("=")
    start, _, end = span.partition(":")
    try:
        return Interval(name, float(start), float(end))
    except ValueError:
        raise ConfigError(f"--interval {text}: expected NAME=START:END in seconds, such as tunnel=120:150") from None
    except ConfigError as error:
        raise ConfigError(f"--interval {text}: {error}") from None


def _intervals_of(path: Path) -> "list[Interval]":
    from holdfast.config.document import plain
    from holdfast.config.load import read_yaml
    from holdfast.evaluation.accuracy import Interval

    expected = "expected one `name: [start, end]` in seconds per line"
    try:
        content = plain(read_yaml(path, "to be given with --intervals"), str(path))
        return [Interval(name, float(start), float(end)) for name, (start, end) in content.items()]
    except ConfigError as error:
        raise ConfigError(f"--intervals {error} ({expected})") from None
    except (TypeError, ValueError):
        raise ConfigError(f"--intervals {path}: {expected}") from None
