# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameters that every node of an axis has, and the way from those of a node to those of its blocks."""

from __future__ import annotations

from dataclasses import dataclass, fields

from hysteresis_ros.errors import Problem
from hysteresis_ros.parameters import Parameters, parameter


@dataclass(frozen=True)
class NodeParameters(Parameters):
    """What every node of an axis needs; normally given once, under ``/**``."""

    sample_rate: float = parameter(
        1000.0, unit="Hz", low=1.0e-3, high=1.0e6, read_only=True, description="samples per second of the axis"
    )
    time_mode: str = parameter(
        "realtime",
        choices=("realtime", "lockstep", "fused"),
        read_only=True,
        description="realtime: the plant keeps the time; lockstep: each sample waits for its answer, as fast as it "
        "can; fused: all nodes in one process, one compiled thread makes the samples in real time",
    )
    joint: str = parameter("extender", read_only=True, description="name of the joint in joint_states")
    force_joint: str = parameter(
        "force", read_only=True, description="joint in joint_states whose effort is the measured force in the stack"
    )
    autostart: bool = parameter(True, read_only=True, description="configure and activate by itself at start")
    use_sim_time: bool = parameter(
        False, description="take the time of log lines and diagnostics from /clock; samples have their own stamps"
    )
    exit_at_end: bool = parameter(
        False, read_only=True, description="leave when the plant has published the end of the run"
    )
    partner_timeout: float = parameter(
        10.0,
        unit="s",
        low=0.1,
        high=3600.0,
        description="lockstep: silence of a partner that ends the run; DDS may take 3 s to repeat what was lost",
    )
    faults: tuple[str, ...] = parameter(
        (),
        read_only=True,
        description="faults on purpose, each 'NAME:START:DURATION[:VALUE]', times in seconds of the axis' own time; "
        "for all nodes, under '/**'",
    )
    queue_depth: int = parameter(
        1000, low=1, high=100000, read_only=True, description="lockstep: messages each topic keeps for a slow recorder"
    )
    external_plant: bool = parameter(
        False,
        read_only=True,
        description="realtime: a node of your own publishes joint_states in plant_simulator's place; the source of "
        "references begins and ends the run; for all nodes, under '/**'",
    )

    measurement_reliability: str = parameter(
        "reliable",
        choices=("reliable", "best_effort"),
        read_only=True,
        description="how joint_states are subscribed: best_effort where a driver of your own publishes them so; "
        "realtime only",
    )

    setpoint_reliability: str = parameter(
        "reliable",
        choices=("reliable", "best_effort"),
        read_only=True,
        description="how setpoint is subscribed: best_effort matches every publisher, and a setpoint may be lost",
    )

    def check(self):
        """Yield what does not fit together."""
        yield from super().check()
        if self.measurement_reliability != "reliable" and self.time_mode == "lockstep":
            allowed = "must be reliable in lockstep, where each sample is answered: give time_mode: realtime"
            yield Problem("measurement_reliability", self.measurement_reliability, allowed)
        if self.external_plant and self.time_mode != "realtime":
            allowed = "a plant of your own does not wait for anybody: give time_mode: realtime"
            yield Problem("external_plant", self.external_plant, allowed)


def part(parameters: Parameters, cls):
    """Return the block's own parameters, out of the parameters of its node; always the same instance of ``cls``."""
    kept = parameters.__dict__.setdefault("_parts", {})
    if cls not in kept:
        kept[cls] = cls(**{item.name: getattr(parameters, item.name) for item in fields(cls)})
    return kept[cls]
