"""Statistics of times: the columns of every latency table."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def percentiles(values: NDArray[np.floating[Any]]) -> dict[str, float] | None:
    """Return count, mean, standard deviation, percentiles and maximum of values (N,); None if there are none."""
    if not len(values):
        return None
    median, p90, p99, p999 = np.percentile(values, [50.0, 90.0, 99.0, 99.9]).tolist()
    moments = {"count": len(values), "mean": float(values.mean()), "std": float(values.std())}
    return moments | {"median": median, "p90": p90, "p99": p99, "p99.9": p999, "max": float(values.max())}
