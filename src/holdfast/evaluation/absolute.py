"""Absolute pose error: how far the estimate is from the reference at each stamp."""

from dataclasses import dataclass

import numpy as np

from holdfast.evaluation import quaternions
from holdfast.evaluation.association import Pairs
from holdfast.messages import Array


@dataclass(frozen=True, slots=True)
class Statistics:
    """Summary of errors; of signed ones the mean and median keep the sign, p95 and max are of the magnitude.

    Attributes:
        std: about the mean, of the population (numpy's and evo's convention).
        p95: 95th percentile, linear between the two nearest ranks.
    """

    mean: float
    std: float
    rms: float
    median: float
    p95: float
    max: float
    count: int


def summarise(values: Array) -> Statistics | None:
    """Summarise the values (N,); NaN stands for an error that is not defined there; None if none is."""
    values = values[~np.isnan(values)]
    if not len(values):
        return None
    return Statistics(
        mean=float(np.mean(values)),
        std=float(np.std(values)),
        rms=float(np.sqrt(np.mean(values**2))),
        median=float(np.median(values)),
        p95=float(np.percentile(np.abs(values), 95.0)),
        max=float(np.abs(values).max()),
        count=len(values),
    )


def ape(pairs: Pairs) -> dict[str, Array]:
    """Return the absolute pose errors, estimate minus reference, by name: each (N,).

    `translation_m` = |p_est - p_ref|, `horizontal_m` and `vertical_m` its parts (all >= 0); `east_m`, `north_m`, `up_m`
    signed, on the axes of the world. Where both have an orientation also `rotation_deg`, the angle of
    R_ref^T R_est (>= 0), and `roll_deg`, `pitch_deg`, `yaw_deg`: differences of the angles of Rz Ry Rx, signed, within
    +-180 deg; they lose their meaning for bodies that pitch by 90 deg. `translation_m` and `rotation_deg` equal
    evo's translation_part and rotation_angle_deg.
    """
    difference = pairs.estimate.positions - pairs.reference.positions
    errors = {
        "translation_m": np.linalg.norm(difference, axis=1),
        "horizontal_m": np.hypot(difference[:, 0], difference[:, 1]),
        "vertical_m": np.abs(difference[:, 2]),
        "east_m": difference[:, 0],
        "north_m": difference[:, 1],
        "up_m": difference[:, 2],
    }
    if pairs.oriented:
        ours, theirs = pairs.estimate.quaternions, pairs.reference.quaternions
        errors["rotation_deg"] = np.degrees(
            quaternions.angle_rad(quaternions.multiply(quaternions.conjugate(theirs), ours))
        )
        difference_rad = quaternions.roll_pitch_yaw_rad(ours) - quaternions.roll_pitch_yaw_rad(theirs)
        roll, pitch, yaw = np.degrees(quaternions.wrap_rad(difference_rad)).T
        errors |= {"roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw}
    return errors


@dataclass(frozen=True, slots=True)
class EndError:
    """Where the estimate ends up: the error of the last pair, as after an outage.

    Attributes:
        yaw_deg: signed; None without orientation.
        driven_m: distance that the reference drove from the first to the last pair.
        percent: translation_m in percent of driven_m; None where the reference stands still.
    """

    translation_m: float
    horizontal_m: float
    vertical_m: float
    yaw_deg: float | None
    driven_m: float
    percent: float | None


def end_error(pairs: Pairs, errors: dict[str, Array]) -> EndError:
    """Return the error of the last pair; `errors` are those of `ape(pairs)`."""
    driven = float(pairs.driven_m()[-1])
    last = {name: float(values[-1]) for name, values in errors.items()}
    return EndError(
        translation_m=last["translation_m"],
        horizontal_m=last["horizontal_m"],
        vertical_m=last["vertical_m"],
        yaw_deg=last.get("yaw_deg"),
        driven_m=driven,
        percent=100.0 * last["translation_m"] / driven if driven > 0.0 else None,
    )
