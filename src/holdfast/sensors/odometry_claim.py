"""What an odometry says itself of the directions in which it does not know its motion: a covariance in its message.

Covariances in messages of odometries are seldom meant: zeros, constants such as the identity, 1e6 for `unknown`, or the
growing covariance of the pose itself. Noise is therefore configured, and of a claim only what tells directions apart
is taken: along a tunnel it is large, across it small. decision 032.
"""

import numpy as np

from holdfast.config.sensors import DriftingConfig
from holdfast.messages import Array

LARGE = 9.0  # of the configured variance: below three sigmas a claim is no news
# of the configured variance: with 5 mm, 1.6 m a pose, which is as good as unknown beside an IMU. Larger claims cost the
# optimiser its digits: with 23 m a pose it made a velocity of them that nobody had measured
MOST = 1e5
SKEW = 1e-6


def claimed_excess(claim: Array | None, config: DriftingConfig) -> Array | None:
    """Return the covariance (6, 6) that a claim adds to the configured noise, or None where it adds nothing.

    In units of the configured sigmas, the eigenvalues of the claim above LARGE are kept. That holds only if, of
    rotation and of translation alike, some direction is not large: else the claim tells no directions apart.

    Args:
        claim: (6, 6) of the motion since the pose before in the tangent of L, rotation first; or None.
        config: `covariance` is `never`, `directions` or `always`, which adds the whole claim; all up to MOST.
    """
    if claim is None or config.covariance == "never" or not np.isfinite(claim).all():
        return None
    sigmas = np.repeat([config.rotation_sigma_rad, config.translation_sigma_m], 3)
    relative = claim / np.outer(sigmas, sigmas)
    skew = np.abs(relative - relative.T).max()
    relative = (relative + relative.T) / 2.0
    values, directions = np.linalg.eigh(relative)
    if skew > SKEW * values[-1] or values[0] < -SKEW * values[-1]:
        return None  # no covariance at all
    if config.covariance == "always":
        kept = np.clip(values, 0.0, MOST)
    elif values[-1] > LARGE and _tells_apart(relative[:3, :3]) and _tells_apart(relative[3:, 3:]):
        kept = np.where(values > LARGE, np.minimum(values, MOST), 0.0)
    else:
        return None
    excess: Array = (directions * kept) @ directions.T * np.outer(sigmas, sigmas)
    return excess


def _tells_apart(relative: Array) -> bool:
    """Whether not every direction of a block (3, 3) is large."""
    return bool(np.linalg.eigvalsh(relative)[0] <= LARGE)
