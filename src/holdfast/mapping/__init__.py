"""The map of a recording: scans deskewed with a trajectory at IMU rate, gathered in voxels on disk."""
