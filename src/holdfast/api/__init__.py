"""What a notebook calls: `holdfast.replay`, `holdfast.smooth`, `holdfast.simulate`, with arrays as results."""
