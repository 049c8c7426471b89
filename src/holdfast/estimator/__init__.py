"""The estimator: message in, estimates out; no thread, clock, file or print inside."""
