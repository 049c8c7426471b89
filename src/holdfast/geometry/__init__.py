"""Geodesy. The algebra of SO(3) and SE(3) is `gtsam.Rot3` and `gtsam.Pose3`."""
