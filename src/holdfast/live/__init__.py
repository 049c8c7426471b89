"""The estimator on a running ROS 2 machine, over DDS."""
