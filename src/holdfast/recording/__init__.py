"""Recordings: bags, CSV folders and the KITTI drive come in; trajectories and bags go out."""
