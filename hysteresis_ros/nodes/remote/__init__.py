"""What ``hysteresis status|get|set|call|echo|setpoint`` do in the graph, for people without the command ``ros2``."""
