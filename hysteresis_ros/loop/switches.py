# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What is started and stopped within a sample while an axis runs, in compiled code.

Everything else that changes takes Python (:meth:`hysteresis_ros.loop.axis.Axis.apply`). What stands here does the same
as the methods ``start``, ``stop``, ``halt`` and ``hold`` of the parts.
"""

from __future__ import annotations

from hysteresis_ros.block import nested
from hysteresis_ros.loop import compensator as compensating
from hysteresis_ros.loop import control_sample as controlling
from hysteresis_ros.loop import plant as planting
from hysteresis_ros.loop.source import hold, rest

# Codes of what can be switched; HALT is the emergency stop, all that can be stopped.
NOTHING, START_PLANT, HALT_PLANT, START_CONTROLLER, STOP_CONTROLLER, START_COMPENSATOR, STOP_COMPENSATOR = range(7)
STOP_GENERATOR, HALT, HOLD_GENERATOR = 7, 8, 9

#: Node and action of each code.
SWITCHES = {
    START_PLANT: ("plant_simulator", "start"),
    HALT_PLANT: ("plant_simulator", "halt"),
    START_CONTROLLER: ("motion_controller", "start"),
    STOP_CONTROLLER: ("motion_controller", "stop"),
    START_COMPENSATOR: ("hysteresis_compensator", "start"),
    STOP_COMPENSATOR: ("hysteresis_compensator", "stop"),
    STOP_GENERATOR: ("reference_generator", "stop"),
    HOLD_GENERATOR: ("reference_generator", "hold"),
}

#: Code of each node and action.
CODES = {what: code for code, what in SWITCHES.items()}


def switched(code: int, motor: bool) -> list[tuple[str, str]]:
    """Return node and action of everything that a code switches; a motor's sequencer is asked to stop instead."""
    if code != HALT:
        return [SWITCHES[code]]
    stopped = [HALT_PLANT, STOP_CONTROLLER, STOP_COMPENSATOR, *([] if motor else [STOP_GENERATOR])]
    return [SWITCHES[one] for one in stopped]


@nested
def switch(laws, parts, column, code):
    """Start or stop a part from this sample on; what a source asks for because of that is put into the column."""
    trip = parts.plant.watch_x.trip
    controller, compensator = parts.controller.watch_x.own, parts.compensator.watch_x.own
    if code == START_PLANT:
        for i in range(trip.shape[0]):
            if i != planting.LATE:
                trip[i] = 0.0
    if code in (HALT_PLANT, HALT):
        trip[planting.TRIP] = max(trip[planting.TRIP], planting.HALTED)
    if code in (STOP_CONTROLLER, HALT):
        controller[controlling.STOP] = 1.0
    if code in (STOP_COMPENSATOR, HALT):
        compensator[compensating.STOP] = 1.0
    if code in (STOP_GENERATOR, HALT):
        rest(laws, parts.source, column)
    if code == HOLD_GENERATOR:
        hold(laws, parts.source, column)
    if code == START_CONTROLLER:
        controller[controlling.STOP] = 0.0
        controller[controlling.RETURNING] = 1.0
    if code == START_COMPENSATOR:
        compensator[compensating.STOP] = 0.0
        compensator[compensating.RETURNING] = 1.0
