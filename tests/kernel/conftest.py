import sys
from pathlib import Path

for room in ("estimator", "chassis"):  # where motion.py and slewing.py lie
    sys.path.insert(0, str(Path(__file__).parents[1] / room))
