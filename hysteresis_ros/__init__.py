"""Hysteretic piezo positioning on ROS 2, from a recording to a controlled axis.

record → identify → simulate → compensate → control → analyse, with the same numbers offline and in the running nodes:
every model, inverse, controller and observer is a block (:mod:`hysteresis_ros.block`) that the offline simulation and
the ROS 2 nodes call alike. Only :mod:`hysteresis_ros.nodes` needs ROS.
"""

#: The version; setup.py reads it from here, package.xml repeats it.
__version__ = "0.1.0"
