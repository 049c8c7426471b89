"""KISS-ICP as its authors ship it; it deskews by itself, to the end of the sweep (measured, and read in its source)."""

import numpy as np
from kiss_icp.config import load_config
from kiss_icp.kiss_icp import KissICP

from holdfast.lidar_odometry.registration import Registered, Registration
from holdfast.lidar_odometry.sweep import Sweep


class KissIcp(Registration):
    """Poses refer to the end of the sweep."""

    def __init__(self, threads: int) -> None:
        config = load_config(None)
        config.registration.max_num_threads = threads
        self._odometry = KissICP(config)

    def register(self, sweep: Sweep) -> Registered:
        """Join the next sweep to the map."""
        phases = sweep.phases()
        self._odometry.register_frame(sweep.points, np.zeros(0) if phases is None else phases)
        end_s = 0.0 if sweep.offsets_s is None else float(sweep.offsets_s.max())
        return Registered(sweep.stamp_ns + round(end_s * 1e9), np.array(self._odometry.last_pose))
