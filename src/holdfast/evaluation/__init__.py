"""The judge: accuracy and consistency of trajectories. It shares no code with the estimator that it judges."""
