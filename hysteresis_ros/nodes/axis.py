# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Executable ``hysteresis_axis``: the four nodes of an axis in one process with one executor.

With ``time_mode: fused`` one compiled thread runs their loop. ``--recorder`` adds the node ``recorder``, which gets all
samples of a fused axis only if it runs in this process. With ``--external-plant`` an external node replaces the plant
node.
"""

from __future__ import annotations

import sys

from hysteresis_ros.nodes.fused import FusedAxis
from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode
from hysteresis_ros.nodes.inchworm_sequencer import InchwormSequencerNode
from hysteresis_ros.nodes.launcher import EXTERNAL_PLANT
from hysteresis_ros.nodes.motion_controller import MotionControllerNode
from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode
from hysteresis_ros.nodes.recorder import RecorderNode
from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode
from hysteresis_ros.nodes.spin import run

#: Argument that adds the recorder.
WITH_RECORDER = "--recorder"


def main(arguments=None) -> int:
    """Run all nodes; return the exit code."""
    arguments = list(sys.argv if arguments is None else arguments)
    fused = FusedAxis()

    def joined(kind):
        return lambda: fused.join(kind())

    def reference():
        if "plant_simulator" in fused.nodes:
            motor = fused.plant.get_parameter("type").value == "inchworm"
        else:
            motor = fused.nodes["motion_controller"].get_parameter("use_origin").value
        return fused.join(InchwormSequencerNode() if motor else ReferenceGeneratorNode())

    factories = [*map(joined, (PlantSimulatorNode, HysteresisCompensatorNode, MotionControllerNode)), reference]
    if EXTERNAL_PLANT in arguments:
        arguments.remove(EXTERNAL_PLANT)
        del factories[0]
    if WITH_RECORDER in arguments:
        arguments.remove(WITH_RECORDER)
        factories.insert(0, joined(RecorderNode))  # the first node is the last to exit
    return run(factories, arguments, steered=True)


if __name__ == "__main__":
    raise SystemExit(main())
