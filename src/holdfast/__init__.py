"""Holdfast tells a construction machine where it is: IMU, RTK-GNSS and lidar odometry fused in factor graphs."""

__version__ = "0.1.0"
