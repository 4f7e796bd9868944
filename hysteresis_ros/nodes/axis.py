"""Executable ``hysteresis_axis``: the four nodes of an axis composed in one process with one executor."""

from __future__ import annotations

from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode
from hysteresis_ros.nodes.inchworm_sequencer import InchwormSequencerNode
from hysteresis_ros.nodes.motion_controller import MotionControllerNode
from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode
from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode
from hysteresis_ros.nodes.spin import run


def main(arguments=None) -> int:
    """Run all nodes; returns the exit code."""
    types = []

    def plant():
        node = PlantSimulatorNode()
        types.append(node.get_parameter("type").value)
        return node

    def reference():
        return InchwormSequencerNode() if "inchworm" in types else ReferenceGeneratorNode()

    return run([plant, HysteresisCompensatorNode, MotionControllerNode, reference], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
