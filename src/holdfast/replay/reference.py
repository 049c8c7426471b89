"""A reference to judge a run by, brought into the world frame of the run.

A TUM file does not say where on the earth its world is. The results of a replay do (`summary.json` beside it), and so
does a simulation (`scenario.yaml` beside `truth/` and `site.ply`); of any other file it is the user who knows.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import gtsam
import numpy as np
from gtsam import SO3

from holdfast.config.document import read_document
from holdfast.config.load import read_yaml
from holdfast.errors import HoldfastError, RecordingError
from holdfast.evaluation import quaternions
from holdfast.evaluation.mesh import Mesh, read_mesh
from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.messages import Array
from holdfast.recording.tum import read_tum
from holdfast.replay.batch_outputs import CAUSAL
from holdfast.replay.outputs import SUMMARY
from holdfast.replay.summary_file import datum_in, read_summary
from holdfast.state import Trajectory

TRUTH, BIASES, SCENARIO = "imu_in_world.tum", "imu_bias.csv", "scenario.yaml"


class Reference(NamedTuple):
    """Poses of the IMU in the world of a run.

    Attributes:
        poses: as they are compared.
        file: they are from.
        is_placed: whether the file is known to be of that world, or of another one from which the poses were moved.
        note: that they were; empty if they were not.
    """

    poses: Trajectory
    file: Path
    is_placed: bool
    note: str = ""


class Surface(NamedTuple):
    """The true surface in the world of a run.

    Attributes:
        mesh: as it is compared.
        note: that it was moved there, or that it may be elsewhere; empty if it is known to be of that world.
    """

    mesh: Mesh
    note: str = ""


def read_reference(path: Path, datum: Geodetic | None) -> Reference:
    """Read a reference in the world about a datum; where one of both is nowhere on the earth, it stays as it is.

    Args:
        path: TUM file, or the truth/ folder of a simulation.
        datum: of the run that is judged.

    Raises:
        RecordingError: it cannot be read, or a folder is none of these; names the one in it that may have been meant.
    """
    file = path / TRUTH if path.is_dir() else path
    if path.is_dir() and not (path / BIASES).exists():
        meant = f"; is {path / 'truth'} meant?" if (path / "truth" / TRUTH).exists() else ""
        raise RecordingError(
            f"{path}: holds no truth (allowed: a TUM file, or the truth/ folder of a simulation){meant}"
        )
    poses, its_own = read_tum(file), datum_of(file)
    if datum is None or its_own is None or datum == its_own:
        return Reference(poses, file, is_placed=datum == its_own)
    moved, note = in_other_world(poses, its_own, datum), _moved(file, its_own, datum)
    return Reference(moved, file, is_placed=True, note=note)


def read_surface(file: Path, datum: Geodetic | None) -> Surface:
    """Read the site of a simulation in the world about a datum; where one of both is nowhere on the earth, as it is.

    Raises:
        RecordingError: it cannot be read.
    """
    mesh, its_own = read_mesh(file), datum_of_simulation(file.resolve().parent)
    if datum is None or its_own is None:
        whose = "the run" if datum is None else f"{file} (that of a {SCENARIO} beside it)"
        return Surface(mesh, f"The datum of {whose} is not known: {file.name} may be in another world than the run.")
    if datum == its_own:
        return Surface(mesh)
    return Surface(mesh_in_other_world(mesh, its_own, datum), _moved(file, its_own, datum))


def datum_of(file: Path) -> Geodetic | None:
    """Return the origin of the world that the poses in a TUM file are given in; None if nothing beside it says so."""
    folder = file.resolve().parent
    for results in (folder, folder.parent) if folder.name == CAUSAL else (folder,):
        if (results / SUMMARY).is_file():
            return datum_in(read_summary(results))
    return datum_of_simulation(folder.parent) if folder.name == "truth" else None


def datum_of_simulation(folder: Path) -> Geodetic | None:
    """Return the origin of the world of a simulation: of its truth and of its site; None if the folder is of none."""
    scenario = folder / SCENARIO
    if not scenario.is_file():
        return None
    try:
        data: Any = read_document(read_yaml(scenario, ""), str(scenario)).data
        return Geodetic(*(float(data["datum"][name]) for name in Geodetic._fields))
    except (HoldfastError, KeyError, TypeError, ValueError):
        return None


def in_other_world(track: Trajectory, datum: Geodetic, other: Geodetic) -> Trajectory:
    """Return a track that is given in the W of a datum in the W of another one."""
    turn, origin = _motion(datum, other)
    q = np.tile(turn, (len(track.stamps_ns), 1))
    positions = origin + quaternions.rotate(q, track.positions)
    return replace(track, positions=positions, quaternions=quaternions.multiply(q, track.quaternions))


def mesh_in_other_world(mesh: Mesh, datum: Geodetic, other: Geodetic) -> Mesh:
    """Return a surface that is given in the W of a datum in the W of another one."""
    turn, origin = _motion(datum, other)
    return replace(mesh, vertices=origin + quaternions.rotate(turn, mesh.vertices))


def _moved(file: Path, datum: Geodetic, of_run: Geodetic) -> str:
    apart_m = float(np.linalg.norm(LocalFrame(of_run).to_enu(datum)))
    return f"The datum of {file} is {apart_m:.3g} m from that of the run: it is judged by in the world of the run."


def _motion(datum: Geodetic, other: Geodetic) -> tuple[Array, Array]:
    """Return rotation (4,) x, y, z, w and translation (3,) [m] from the W of a datum into the W of another one."""
    here, there = LocalFrame(datum), LocalFrame(other)
    origin = there.to_enu(here.to_geodetic(np.zeros(3)))
    axes = [there.to_enu(here.to_geodetic(axis)) - origin for axis in 1000.0 * np.eye(3)]
    turn: Any = gtsam.Rot3(SO3.ClosestTo(np.column_stack(axes) / 1000.0).matrix()).toQuaternion()
    return turn.coeffs(), origin
