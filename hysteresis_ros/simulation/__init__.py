"""The closed loop without ROS: configuration files, the axis made of blocks, and its offline simulation."""
