# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What can be done, by the names that the catalogue uses."""

from __future__ import annotations

from hysteresis_ros.nodes.campaign import machine, measurement, people, processes

#: Each is called with the rig, the mishap and the amount.
ACTIONS = {
    "kill": processes.kill,
    "stop": processes.stop,
    "flood": people.flood,
    "second sender": people.second_sender,
    "storm": people.storm,
    "anything": people.anything,
    "measure": measurement.measure,
    "load": machine.load,
    "fill": machine.fill,
    "misbehave": machine.misbehave,
    "cut recording": machine.cut_recording,
    "set clock": machine.set_clock,
    "second graph": people.second_graph,
}
