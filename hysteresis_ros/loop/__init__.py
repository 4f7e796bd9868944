"""The loop of an axis: its parameters, its parts, one sample of it, and the runner without ROS."""
