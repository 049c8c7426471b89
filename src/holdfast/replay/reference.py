"""A reference to judge a run by, brought into the world frame of the run.

A TUM file does not say where on the earth its world is. The results of a replay do (`summary.json` beside it), and so
does a simulation (`scenario.yaml` beside `truth/`); of any other file it is the user who knows.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import gtsam
import numpy as np
from gtsam import SO3

from holdfast.config.document import read_document
from holdfast.config.load import read_yaml
from holdfast.errors import HoldfastError
from holdfast.evaluation import quaternions
from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.recording.tum import read_tum
from holdfast.replay.batch_outputs import CAUSAL
from holdfast.replay.outputs import SUMMARY
from holdfast.replay.summary_file import datum_in, read_summary
from holdfast.state import Trajectory

TRUTH, SCENARIO = "imu_in_world.tum", "scenario.yaml"


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


def read_reference(path: Path, datum: Geodetic | None) -> Reference:
    """Read a reference in the world about a datum; where one of both is nowhere on the earth, it stays as it is.

    Args:
        path: TUM file, or the truth/ folder of a simulation.
        datum: of the run that is judged.

    Raises:
        RecordingError: it cannot be read.
    """
    file = path / TRUTH if path.is_dir() else path
    poses, its_own = read_tum(file), datum_of(file)
    if datum is None or its_own is None or datum == its_own:
        return Reference(poses, file, is_placed=datum == its_own)
    apart_m = float(np.linalg.norm(LocalFrame(datum).to_enu(its_own)))
    note = f"The datum of {file} is {apart_m:.3g} m from that of the run: it is judged by in the world of the run."
    return Reference(in_other_world(poses, its_own, datum), file, is_placed=True, note=note)


def datum_of(file: Path) -> Geodetic | None:
    """Return the origin of the world that the poses in a TUM file are given in; None if nothing beside it says so."""
    folder = file.resolve().parent
    for results in (folder, folder.parent) if folder.name == CAUSAL else (folder,):
        if (results / SUMMARY).is_file():
            return datum_in(read_summary(results))
    scenario = folder.parent / SCENARIO
    if folder.name != "truth" or not scenario.is_file():
        return None
    try:
        data: Any = read_document(read_yaml(scenario, ""), str(scenario)).data
        return Geodetic(*(float(data["datum"][name]) for name in Geodetic._fields))
    except (HoldfastError, KeyError, TypeError, ValueError):
        return None


def in_other_world(track: Trajectory, datum: Geodetic, other: Geodetic) -> Trajectory:
    """Return a track that is given in the W of a datum in the W of another one."""
    here, there = LocalFrame(datum), LocalFrame(other)
    origin = there.to_enu(here.to_geodetic(np.zeros(3)))
    axes = [there.to_enu(here.to_geodetic(axis)) - origin for axis in 1000.0 * np.eye(3)]
    turn: Any = gtsam.Rot3(SO3.ClosestTo(np.column_stack(axes) / 1000.0).matrix()).toQuaternion()
    q = np.tile(turn.coeffs(), (len(track.stamps_ns), 1))
    positions = origin + quaternions.rotate(q, track.positions)
    return replace(track, positions=positions, quaternions=quaternions.multiply(q, track.quaternions))
