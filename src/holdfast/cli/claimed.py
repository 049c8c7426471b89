"""What `holdfast evaluate` says of the covariances that lie beside an estimate."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from holdfast.evaluation.association import Pairs
    from holdfast.evaluation.consistency import Consistency


def claimed_consistency(
    estimate: Path, pairs: "Pairs", lever_arm: tuple[float, float, float]
) -> "dict[str, Consistency]":
    """Return how well the covariances of an estimate explain its errors; nothing where none lie beside it.

    Raises:
        RecordingError: they cannot be read.
        EstimatorError: one is not positive definite.
    """
    from holdfast.evaluation.consistency import pose_consistency
    from holdfast.recording.covariance_csv import beside, read_covariances

    file = beside(estimate)
    if not file.exists():
        return {}
    if any(lever_arm):
        click.echo(f"note: {file.name} is of the IMU, not of the point of --reference-lever-arm: no NEES", err=True)
        return {}
    return pose_consistency(pairs, read_covariances(file))


def print_consistency(found: "dict[str, Consistency]") -> None:
    """Print the mean NEES per degree of freedom, and how many errors are within the bound of their covariance."""
    for name, one in found.items():
        click.echo(
            f"NEES of {name}: {one.mean_nees_per_dof:.2f} per degree of freedom (1: as claimed); "
            f"{100.0 * one.fraction_inside:.1f} % of the errors within the {100.0 * one.probability:.0f} % bound"
        )


def as_json(found: "dict[str, Consistency]") -> dict[str, Any]:
    """Return the numbers."""
    return {name: asdict(one) for name, one in found.items()}
