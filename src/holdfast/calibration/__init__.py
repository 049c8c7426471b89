"""Constants and noise of a machine's sensors, from whole recordings: into the configuration, and onto a page."""
