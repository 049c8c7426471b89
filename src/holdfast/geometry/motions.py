"""How far a motion goes; the algebra of motions is GTSAM's."""

import gtsam
import numpy as np


def size_of(motion: gtsam.Pose3) -> tuple[float, float]:
    """Return how long a motion is [m], and how far it turns [rad]."""
    return float(np.linalg.norm(motion.translation())), float(np.linalg.norm(gtsam.Rot3.Logmap(motion.rotation())))
