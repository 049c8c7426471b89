"""The estimator in two processes: the IMU path here, the graphs in the other."""
