import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "replay"))  # where small_drive.py lies
sys.path.append(str(Path(__file__).parents[1] / "recording"))
