"""Executable ``hysteresis_axis``: the four nodes of an axis composed in one process with one executor."""

from __future__ import annotations

from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode
from hysteresis_ros.nodes.motion_controller import MotionControllerNode
from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode
from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode
from hysteresis_ros.nodes.spin import run


def main(arguments=None) -> int:
    """Run all nodes; returns the exit code."""
    return run([PlantSimulatorNode, HysteresisCompensatorNode, MotionControllerNode, ReferenceGeneratorNode], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
