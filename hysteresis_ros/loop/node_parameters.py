# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameters of the nodes: the blocks' own parameters and what a running node needs besides.

They live here and not with the nodes because the offline twin reads the same files.
"""

from __future__ import annotations

from dataclasses import dataclass

from hysteresis_ros.compensation.adaptation import AdaptationParameters
from hysteresis_ros.compensation.compensator import CompensatorParameters
from hysteresis_ros.control.command_range import CommandRangeParameters
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.errors import Problem
from hysteresis_ros.loop.common_parameters import NodeParameters
from hysteresis_ros.loop.plant_parameters import PlantNodeParameters
from hysteresis_ros.parameters import group, parameter
from hysteresis_ros.references.generator import ReferenceParameters
from hysteresis_ros.references.inchworm_parameters import InchwormSequencerParameters
from hysteresis_ros.references.settling import SettlingParameters
from hysteresis_ros.sensing.tracker import CameraParameters


@dataclass(frozen=True)
class ReferenceNodeParameters(NodeParameters, ReferenceParameters):
    """Parameters of ``reference_generator``."""

    settled: SettlingParameters = group(SettlingParameters)
    publish_description: bool = parameter(
        True, read_only=True, description="publish the joint and its limits as a URDF on robot_description"
    )
    samples: int = parameter(
        0, low=0, high=10**12, read_only=True, description="external_plant: length of the run in samples; 0: no end"
    )
    wait_for_recorder: bool = parameter(
        False, read_only=True, description="external_plant: begin when a recorder is there"
    )


@dataclass(frozen=True)
class InchwormSequencerNodeParameters(NodeParameters, InchwormSequencerParameters):
    """Parameters of ``inchworm_sequencer``, which takes the place of ``reference_generator``."""

    publish_description: bool = parameter(
        True, read_only=True, description="publish the joint and its limits as a URDF on robot_description"
    )
    extender_joint: str = parameter(
        "extender", read_only=True, description="name of the extender in joint_states; joint is the slider's"
    )
    measurement_timeout: float = parameter(
        0.2, unit="s", low=1.0e-3, high=3600.0, description="realtime: silence of joint_states that closes both clamps"
    )


@dataclass(frozen=True)
class ControllerNodeParameters(NodeParameters, ControllerParameters, CommandRangeParameters):
    """Parameters of ``motion_controller``."""

    use_origin: bool = parameter(
        False, read_only=True, description="inchworm: subtract the sequencer's origin from the measurement"
    )

    measurement_timeout: float = parameter(
        0.2, unit="s", low=1.0e-3, high=3600.0, description="realtime: silence of joint_states that makes it go safe"
    )
    spike_limit: float = parameter(
        0.0, unit="m", low=0.0, high=1.0, description="largest believable change of the measurement a sample; 0: any"
    )
    spike_samples: int = parameter(
        3, low=2, high=10**6, description="samples in a row after which a larger change is believed"
    )
    frozen_samples: int = parameter(
        0, low=0, high=10**9, description="equal measurements in a row that count as a frozen sensor; 0: never"
    )
    safe_command: float = parameter(
        0.0, unit="m", low=-1.0, high=1.0, description="command while the measurement is stale"
    )
    safe_slew_rate: float = parameter(
        1.0e-4, unit="m/s", low=1.0e-12, high=1.0e3, description="how fast the command goes to safe_command"
    )
    controller_state_rate: float = parameter(
        50.0,
        unit="Hz",
        low=0.0,
        high=1.0e6,
        read_only=True,
        description="how often ~/controller_state and ~/pid_state are published where control_msgs is installed; "
        "0: never",
    )

    def check(self):
        """Yield what does not fit together."""
        yield from super().check()
        low, high = self.command_range
        if low < high and not low <= self.safe_command <= high:
            allowed = f"must lie within command_minimum … command_maximum = {low:g} … {high:g} m"
            yield Problem("safe_command", self.safe_command, allowed)


@dataclass(frozen=True)
class CompensatorNodeParameters(NodeParameters, CompensatorParameters):
    """Parameters of ``hysteresis_compensator``."""

    adaptation: AdaptationParameters = group(AdaptationParameters)
    command_timeout: float = parameter(
        0.4, unit="s", low=1.0e-3, high=3600.0, description="realtime: silence of command that starts the watchdog"
    )
    safe_slew_rate: float = parameter(
        1000.0, unit="V/s", low=1.0e-3, high=1.0e9, description="how fast the voltage goes to safe_voltage"
    )

    def check(self):
        """Yield what does not fit together."""
        yield from super().check()
        yield from self.adaptation.fits(self.hysteresis, self.inverse.type)


@dataclass(frozen=True)
class DisplacementCameraNodeParameters(NodeParameters, CameraParameters):
    """Parameters of ``displacement_camera``."""

    image_timeout: float = parameter(
        1.0, unit="s", low=1.0e-3, high=3600.0, description="realtime: silence of image after which it says so"
    )


@dataclass(frozen=True)
class RecorderNodeParameters(NodeParameters):
    """Parameters of ``recorder``."""

    path: str = parameter(
        "recording",
        read_only=True,
        description="folder of the bag, made anew",
        place="files",
    )
    configuration: str = parameter(
        "", read_only=True, description="parameter file whose text goes into the bag", place="files"
    )
    inchworm: bool = parameter(
        False,
        read_only=True,
        description="record an inchworm's topics; a configuration with an inchworm_sequencer says so by itself",
    )
    topics: tuple[str, ...] = parameter(
        (),
        read_only=True,
        description="further topics to record (relative or absolute), each as 'name:package/msg/Type'",
    )
    chunk_time: float = parameter(
        0.25,
        unit="s",
        low=0.01,
        high=0.5,
        read_only=True,
        description="what was recorded is handed to the operating system at least this often",
    )
    max_bag_size: int = parameter(
        0,
        unit="B",
        low=0,
        high=10**15,
        read_only=True,
        description="size of a file of the bag after which the next one begins; 0: any",
    )
    max_bag_duration: float = parameter(
        0.0,
        unit="s",
        low=0.0,
        high=1.0e9,
        read_only=True,
        description="length of a file of the bag after which the next one begins; 0: any",
    )
    warn_space: int = parameter(
        2 * 10**9,
        unit="B",
        low=0,
        high=10**15,
        description="free space on the disk below which the recorder warns",
    )
    min_space: int = parameter(
        2 * 10**8,
        unit="B",
        low=0,
        high=10**15,
        description="free space on the disk below which it ends the recording, never the axis",
    )


#: Parameter class of each node, by node name.
NODE_PARAMETERS: dict[str, type[NodeParameters]] = {
    "plant_simulator": PlantNodeParameters,
    "reference_generator": ReferenceNodeParameters,
    "motion_controller": ControllerNodeParameters,
    "hysteresis_compensator": CompensatorNodeParameters,
    "recorder": RecorderNodeParameters,
    "inchworm_sequencer": InchwormSequencerNodeParameters,
    "displacement_camera": DisplacementCameraNodeParameters,
}
