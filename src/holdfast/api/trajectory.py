"""A trajectory as a notebook wants it: arrays, a data frame, errors against another one, and a figure."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from os import PathLike
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from holdfast import state
from holdfast.arguments import check_choice, check_seconds, path_of
from holdfast.covariances import Covariances
from holdfast.errors import ConfigError, MessageError
from holdfast.evaluation import quaternions
from holdfast.evaluation.absolute import Statistics, ape, summarise
from holdfast.evaluation.alignment import AlignmentName, align
from holdfast.evaluation.association import Association, associate
from holdfast.extras import needing
from holdfast.measured_fields import LIMIT_NS, array_of, got
from holdfast.messages import Array
from holdfast.output_folder import naming_the_output
from holdfast.recording.covariance_csv import CovarianceWriter, beside, read_covariances
from holdfast.recording.tum import NORM_TOLERANCE, read_tum, write_tum
from holdfast.whole_file import whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = (("horizontal_m", "horizontal [m]"), ("vertical_m", "vertical [m]"), ("yaw_deg", "yaw [deg]"))
COLUMNS: Mapping[str, tuple[tuple[int, ...], str]] = {  # shape of each row, unit
    "positions": ((3,), "m"),
    "quaternions_xyzw": ((4,), "1"),
    "velocities": ((3,), "m/s"),
    "covariances": ((9, 9), "rad, m, m/s squared"),
}
NEEDED = ("positions", "quaternions_xyzw")
LIBRARIES = ("polars", "pandas")  # of data frames


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Errors of a trajectory at the stamps of a reference, estimate minus reference.

    Attributes:
        stamps_ns: (M,).
        values: by name, (M,) each: translation_m, horizontal_m, vertical_m, east_m, north_m, up_m, and where both have
            an orientation rotation_deg, roll_deg, pitch_deg, yaw_deg.
    """

    stamps_ns: NDArray[np.int64]
    values: Mapping[str, Array]

    def __getitem__(self, name: str) -> Array:
        """Return one of the errors (M,).

        Raises:
            ConfigError: there is none of this name.
        """
        if not isinstance(name, str) or name not in self.values:
            raise ConfigError(f"errors[{name!r}]: must be one of {', '.join(self.values)}")
        return self.values[name]

    def statistics(self) -> dict[str, Statistics]:
        """Return mean, std, rms, median, p95 and max of each error."""
        found = {name: summarise(of) for name, of in self.values.items()}
        return {name: of for name, of in found.items() if of is not None}


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """The motion of one frame in another at N stamps.

    Attributes:
        stamps_ns: (N,) strictly increasing, on the IMU's clock.
        positions: (N, 3) [m].
        quaternions_xyzw: (N, 4) of unit norm.
        velocities: (N, 3) [m/s], expressed in the other frame; None where they are not known.
        covariances: (N, 9, 9) of rotation [rad], position [m] and velocity [m/s], each in the body frame; or None.

    Raises:
        MessageError: an array has another shape, or is not made of such numbers; names it. Lists become arrays.
    """

    stamps_ns: NDArray[np.int64]
    positions: Array
    quaternions_xyzw: Array
    velocities: Array | None = None
    covariances: Array | None = None

    def __post_init__(self) -> None:
        stamps_ns = _increasing(self.stamps_ns)
        object.__setattr__(self, "stamps_ns", stamps_ns)
        for name, (shape, unit) in COLUMNS.items():
            values = getattr(self, name)
            if np.ma.is_masked(values):
                raise MessageError(f"{name}: must not be masked, what is not known has no stamp")
            if values is not None or name in NEEDED:
                object.__setattr__(self, name, array_of(values, (len(stamps_ns), *shape), name, unit))

    @classmethod
    def read(cls, path: str | PathLike[str]) -> "Trajectory":
        """Read a TUM file, and the covariances beside it if there are any.

        Raises:
            ConfigError: it is no path.
            RecordingError: names file and line.
        """
        track = path_of("path", path)
        poses, file = read_tum(track), beside(track)
        covariances = read_covariances(file).at(poses.stamps_ns) if file.exists() else None
        return cls(poses.stamps_ns, poses.positions, poses.quaternions, None, covariances)

    def write(self, path: str | PathLike[str]) -> None:
        """Write a TUM file, and the covariances beside it if they are known; those of an earlier one are removed.

        Raises:
            ConfigError: it is no path, or cannot be written.
            MessageError: there are no poses, or one is none, which could not be read again; names its stamp.
        """
        track = path_of("path", path)
        self._check_poses()
        with whole(track) as part:
            write_tum(part, self.poses)
        if self.covariances is None:
            with naming_the_output(beside(track)):
                beside(track).unlink(missing_ok=True)
        else:
            with whole(beside(track)) as part, CovarianceWriter(part) as writer:
                writer.extend(Covariances(self.stamps_ns, self.covariances))

    def _check_poses(self) -> None:
        if not len(self):
            raise MessageError("stamps_ns: must not be empty, a file of no poses cannot be read again")
        norms = np.linalg.norm(self.quaternions_xyzw, axis=1)
        sound: list[tuple[str, Array, NDArray[np.bool_]]] = [
            ("positions: must be finite", self.positions, _are_finite(self.positions)),
            ("quaternions_xyzw: must be of unit norm", self.quaternions_xyzw, np.abs(norms - 1.0) <= NORM_TOLERANCE),
        ]
        if self.covariances is not None:
            sound.append(("covariances: must be finite", self.covariances, _are_finite(self.covariances)))
        for must_be, values, are_sound in sound:
            if not are_sound.all():
                at = int(np.argmin(are_sound))
                raise MessageError(f"{must_be}, got {values[at].ravel()[:4].tolist()} at {self.stamps_ns[at]} [ns]")

    def __len__(self) -> int:
        """Return the number of stamps."""
        return len(self.stamps_ns)

    def __repr__(self) -> str:
        """Return what it is on one line: a notebook shows it."""
        names = ("velocities", self.velocities), ("covariances", self.covariances)
        known = "".join(f", {name}" for name, of in names if of is not None)
        seconds = self.times_s[-1] if len(self) else 0.0
        driven_m = float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())
        return f"Trajectory({len(self)} poses, {seconds:.1f} s, {driven_m:.1f} m{known})"

    @property
    def times_s(self) -> Array:
        """The stamps (N,) in seconds since the first."""
        times: Array = (self.stamps_ns - self.stamps_ns[:1]) * np.float64(1e-9)
        return times

    @property
    def poses(self) -> state.Trajectory:
        """Stamps, positions and quaternions alone, as the evaluation takes them."""
        return state.Trajectory(self.stamps_ns, self.positions, self.quaternions_xyzw)

    def sigmas_m(self) -> Array:
        """Return the standard deviations (N, 3) of the position along the axes of the other frame [m].

        Raises:
            ConfigError: the covariances are not known.
        """
        if self.covariances is None:
            raise ConfigError("the covariances of this trajectory are not known")
        axes = quaternions.rotate(self.quaternions_xyzw[:, None, :], np.eye(3)[None])  # rows: body axes in W
        variances = np.einsum("nki,nkl,nli->ni", axes, self.covariances[:, 3:6, 3:6], axes)
        sigmas: Array = np.sqrt(variances)
        return sigmas

    def interpolate(self, stamps_ns: ArrayLike) -> "Trajectory":
        """Return it at other stamps (M,): linear in position, velocity and covariance, slerp in rotation.

        Raises:
            MessageError: the stamps are no increasing integers, or beyond the ends.
        """
        stamps = _increasing(stamps_ns)
        if len(stamps) and not len(self):
            raise MessageError("stamps_ns: must be empty, this trajectory has no poses")
        if len(stamps) and not self.stamps_ns[0] <= stamps[0] <= stamps[-1] <= self.stamps_ns[-1]:
            raise MessageError(f"stamps_ns: must be within {self.stamps_ns[0]} and {self.stamps_ns[-1]} [ns]")
        after = np.minimum(np.searchsorted(self.stamps_ns, stamps, side="right"), len(self) - 1)
        before = np.maximum(after - 1, 0)  # of one pose it is that pose, too
        length = np.maximum(self.stamps_ns[after] - self.stamps_ns[before], 1)
        fraction = (stamps - self.stamps_ns[before]) / length

        def linear(values: Array | None) -> Array | None:
            if values is None:
                return None
            part = fraction.reshape(-1, *[1] * (values.ndim - 1))
            between: Array = (1.0 - part) * values[before] + part * values[after]
            return between

        turned = quaternions.slerp(self.quaternions_xyzw[before], self.quaternions_xyzw[after], fraction)
        positions = linear(self.positions)
        assert positions is not None
        return Trajectory(stamps, positions, turned, linear(self.velocities), linear(self.covariances))

    def errors(self, reference: "Trajectory", *, alignment: AlignmentName = "none", max_gap_s: float = 0.5) -> Errors:
        """Return the errors at the stamps of a reference.

        Args:
            reference: what is true.
            alignment: `none`, `yaw` (and translation) or `se3`: how it is moved onto the reference first.
            max_gap_s: longer gaps between two poses are not bridged [s].

        Raises:
            RecordingError: the two do not overlap in time, or cannot be aligned.
            ConfigError: the reference is no trajectory, the alignment is none of these, or the gap is no time.
        """
        _check(reference)
        check_choice("alignment", alignment, get_args(AlignmentName))
        check_seconds("max_gap_s", max_gap_s)
        pairs = associate(
            self.poses, reference.poses, Association(max_gap_s=max_gap_s, names={"max_gap_s": "max_gap_s"})
        )
        pairs = align(pairs, alignment).apply(pairs)
        return Errors(pairs.reference.stamps_ns, ape(pairs))

    def to_dataframe(self, library: Literal["polars", "pandas"] | None = None) -> Any:
        """Return a data frame with a row per stamp: of polars if that is installed, else of pandas.

        Raises:
            ConfigError: neither is installed, or not the one that is asked for; or it is none of these.
        """
        if library is not None:
            check_choice("library", library, LIBRARIES)
        columns: dict[str, Any] = {"stamp_ns": self.stamps_ns}
        columns |= {f"p_{axis}_m": self.positions[:, k] for k, axis in enumerate("xyz")}
        columns |= {f"q_{axis}": self.quaternions_xyzw[:, k] for k, axis in enumerate("xyzw")}
        if self.velocities is not None:
            columns |= {f"v_{axis}_m_s": self.velocities[:, k] for k, axis in enumerate("xyz")}
        if self.covariances is not None:
            columns |= {f"sigma_{axis}_m": self.sigmas_m()[:, k] for k, axis in enumerate("xyz")}
        for name in LIBRARIES if library is None else (library,):
            try:
                return import_module(name).DataFrame(columns)
            except ModuleNotFoundError:
                continue
        raise ConfigError(f"a data frame needs {library or 'polars or pandas'}: pip install {library or 'polars'}")

    def plot(self, reference: "Trajectory | None" = None) -> "Figure":
        """Return a figure: the track from above, and the errors over time if there is a reference.

        Raises:
            ConfigError: matplotlib is not installed, or the reference is no trajectory.
        """
        if reference is not None:
            _check(reference)
        with needing("a figure", "plot"):
            from matplotlib.figure import Figure
        figure = Figure(figsize=(10.0, 4.0), layout="constrained")
        if reference is None:
            above = figure.add_subplot()
        else:
            grid = figure.add_gridspec(len(SHOWN), 2)
            above = figure.add_subplot(grid[:, 0])
            above.plot(
                reference.positions[:, 0], reference.positions[:, 1], color="0.6", linewidth=3, label="reference"
            )
            errors = self.errors(reference)
            times_s = (errors.stamps_ns - self.stamps_ns[0]) * 1e-9
            for row, (name, label) in enumerate((name, label) for name, label in SHOWN if name in errors.values):
                axes = figure.add_subplot(grid[row, 1])
                axes.plot(times_s, errors[name], linewidth=0.8)
                axes.set_ylabel(label)
            axes.set_xlabel("time [s]")
        above.plot(self.positions[:, 0], self.positions[:, 1], linewidth=1.0, label="estimate")
        above.set_aspect("equal", adjustable="datalim")
        above.set_xlabel("east [m]")
        above.set_ylabel("north [m]")
        above.legend()
        return figure


def _are_finite(values: Array) -> NDArray[np.bool_]:
    """Return at which stamps (N,) all values are finite."""
    return np.asarray(np.isfinite(values.reshape(len(values), -1)).all(axis=1), dtype=np.bool_)


def _increasing(stamps_ns: ArrayLike) -> NDArray[np.int64]:
    """Return stamps (N,) as whole numbers of 64 bits [ns]."""
    must_be = "stamps_ns: must be an array (N,) of whole numbers [ns]"
    try:
        found = np.asarray(stamps_ns)
    except (TypeError, ValueError):
        raise MessageError(f"{must_be}, {got(stamps_ns)}") from None
    is_whole = found.dtype.kind in "iu" or (not found.size and isinstance(stamps_ns, list | tuple))
    if found.ndim != 1 or not is_whole or (found >= LIMIT_NS).any():
        raise MessageError(f"{must_be}, {got(stamps_ns)}")
    (back,) = np.nonzero(found[1:] <= found[:-1])
    if len(back):
        earlier, later = found[back[0] : back[0] + 2]
        raise MessageError(f"stamps_ns: must increase [ns], but {later} comes after {earlier}")
    return np.asarray(found, np.int64)


def _check(reference: object) -> None:
    if not isinstance(reference, Trajectory):
        given = type(reference).__name__
        raise ConfigError(f"reference: must be a Trajectory, such as Trajectory.read(FILE), not {given}")
