"""The estimator's output as ROS messages: the same in a file and on the network."""
