"""Lidar odometry: point clouds of a recording become poses, by a registration library in a process of its own."""
