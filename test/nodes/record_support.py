"""The motor record that tests of it share."""

from __future__ import annotations

from hysteresis_ros.nodes.epics.settings import MotorSettings

#: Of an axis of 0 … 12 µm without a speed of its own.
SETTINGS = MotorSettings(
    name="t:m1",
    namespace="",
    source="reference_generator",
    joint="extender",
    low=0.0,
    high=12e-6,
    velocity=0.0,
    acceleration=0.0,
    tolerance=2e-8,
    dwell=0.1,
    timeout=5.0,
    unit="um",
    precision=4,
)
