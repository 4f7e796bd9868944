"""The plants that are simulated, by ``type`` of the plant's node."""

from __future__ import annotations

from hysteresis_ros.loop.camera import SeenPlant
from hysteresis_ros.loop.plants import ActuatorPlant, MotorPlant

#: Plant of each ``type``.
PLANTS = {"actuator": ActuatorPlant, "inchworm": MotorPlant, "camera": SeenPlant}
