"""What a notebook calls: `holdfast.replay`, `smooth`, `calibrate` and `simulate`, with arrays as results."""
