"""Trials: a scenario simulated, estimated under a configuration, and judged by its truth."""
