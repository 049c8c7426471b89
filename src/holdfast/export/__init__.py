"""Tracks in the coordinates of surveyors: reference systems, site grids, and the formats of their programs."""
