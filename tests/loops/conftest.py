"""The yard of the lidar's tests and the bags of the recording's serve here too."""

import sys
from pathlib import Path

for room in ("recording", "lidar_odometry"):
    sys.path.append(str(Path(__file__).parents[1] / room))
