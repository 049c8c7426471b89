"""Fault detection and exclusion: which measurements may enter the graph, and which must leave it again."""
