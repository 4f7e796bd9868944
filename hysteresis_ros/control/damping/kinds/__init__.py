"""The kinds of damping: one file each, found by :mod:`hysteresis_ros.control.damping.registry`."""
