"""The files of the optimum over a recording: trajectories with covariance, biases, and what was refused."""

from collections import Counter
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.evaluation import quaternions
from holdfast.events import Outcome
from holdfast.geometry.rotations import quaternions_xyzw
from holdfast.messages import Array
from holdfast.recording.covariance_csv import CovarianceWriter, beside
from holdfast.recording.tum import TumWriter
from holdfast.replay.published import by_sensor
from holdfast.sensors.constants import Constant
from holdfast.smoothing.batch_smoother import BatchSmoother
from holdfast.smoothing.block import Block, Work

CAUSAL = "causal"  # folder of the run from which the optimum starts
BIASES, REFUSED = "biases.csv", "refused.csv"
HEADERS = {
    BIASES: [
        "stamp_ns",
        *(f"{kind}_{axis}{unit}" for kind in ("bias", "sigma") for unit in ("_m_s2", "_rad_s") for axis in "xyz"),
    ],
    REFUSED: ["stamp_ns", "sensor", "reason", "weight", "nis"],
}


class BatchOutputs:
    """Writes each stretch as it is done; a context manager.

    imu_in_world.tum and base_in_world.tum hold a pose at each sample of the IMU, imu_in_world.covariance.csv the upper
    triangle of the covariance (9, 9) at each node: rotation [rad], position [m] and velocity [m/s], in I.
    """

    def __init__(self, folder: Path, config: Config) -> None:
        self._counts: Counter[tuple[str, Outcome]] = Counter()
        self._constants: dict[str, Constant] = {}
        self._work: list[Work] = []
        self._closures: Counter[str] = Counter()
        with ExitStack() as stack:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                names = ["imu_in_world", *(["base_in_world"] if config.has_base() else [])]
                self._tracks = {name: stack.enter_context(TumWriter(folder / f"{name}.tum")) for name in names}
                self._covariances = stack.enter_context(CovarianceWriter(beside(folder / "imu_in_world.tum")))
                self._tables = {
                    name: stack.enter_context((folder / name).open("w", encoding="utf-8")) for name in HEADERS
                }
            except OSError as error:
                raise ConfigError(f"{error.filename or folder}: cannot be written ({error.strerror})") from None
            self._stack = stack.pop_all()
        for name, header in HEADERS.items():
            self._tables[name].write(",".join(header) + "\n")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def write(self, block: Block) -> None:
        """Write a stretch."""
        track, base = block.track, block.base
        self._tracks["imu_in_world"].extend(track.times_ns.tolist(), track.positions, track.quaternions)
        if len(base.rows) and "base_in_world" in self._tracks:
            q = track.quaternions[base.rows]
            positions = track.positions[base.rows] + quaternions.rotate(q, base.positions)
            attitudes = quaternions.multiply(q, quaternions_xyzw(base.rotations))
            self._tracks["base_in_world"].extend(track.times_ns[base.rows].tolist(), positions, attitudes)
        self._covariances.extend(block.covariances)
        self._rows(BIASES, block.biases.times_ns, np.hstack([block.biases.values, block.biases.sigmas]))
        for one in block.refused:
            self._tables[REFUSED].write(f"{one.stamp_ns},{one.sensor},{one.reason},{one.weight:.3f},{one.nis:.4g}\n")
        for table in self._tables.values():
            table.flush()
        self._counts += block.counts
        self._constants |= block.constants
        self._work.append(block.work)
        self._closures += block.closures

    def _rows(self, name: str, stamps_ns: Iterable[Any], values: Array) -> None:
        lines = (
            f"{stamp_ns}," + ",".join(f"{value:.9g}" for value in row)
            for stamp_ns, row in zip(stamps_ns, values.tolist(), strict=True)
        )
        self._tables[name].writelines(f"{line}\n" for line in lines)

    def summary(self, smoother: BatchSmoother) -> dict[str, Any]:
        """Return what summary.json says of the optimum."""
        return {
            "counts": by_sensor(self._counts),
            "parameters": {
                name: {"estimate": one.value.tolist(), "sigma": one.sigmas.tolist()}
                for name, one in sorted(self._constants.items())
            },
            "loop_closures": dict(sorted(self._closures.items())),
            "windows": [work._asdict() for work in self._work],
            "cost": sum(work.cost_after for work in self._work),
            "iterations": sum(work.iterations for work in self._work),
            "wall_s": smoother.wall_s,
            "failures": [failure._asdict() for failure in smoother.failures],
        }
