# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The largest steps of the voltage that a parameter file causes, and those that it states."""

from __future__ import annotations

import re

import numpy as np

from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate

NODES = ("plant_simulator", "hysteresis_compensator")
STATED = re.compile(r"slew_rate: 0\.0  # .*a sample may step by ([0-9.]+) V: \w+")


def stated(text: str, axis, nodes=NODES) -> float:
    """Return the step of the voltage in a sample [V] that the nodes of a file state."""
    limits = [getattr(axis, name).limits for name in nodes]
    rates = [one.slew_rate for one in limits]
    if all(rates):
        return min(rates) / axis.plant_simulator.sample_rate
    assert not any(rates), "one node limits the voltage and the other does not"
    said = {float(value) for value in STATED.findall(text)}
    assert len(said) == 1 and len(STATED.findall(text)) == len(nodes), "without a limit the file states the step"
    return said.pop()


def steps(configuration, bare: bool) -> np.ndarray:
    """Return the voltages of a step to the farthest setpoint and back, as a waveform or with the approach.

    A controller with an inverse of the dynamics accepts no steps in the waveform.
    """
    if bare and configuration.node("motion_controller").get("feedforward.type") == "inverse_dynamics":
        configuration = configuration.override("motion_controller", feedforward__type="static")
    axis = single_axis(configuration)
    # an image of a camera in each sample takes most of the time
    own, count = axis.reference_generator, 200 if configuration.node("plant_simulator").get("type") == "camera" else 400
    way = max((own.minimum, own.maximum), key=lambda end: abs(end - own.initial_setpoint)) - own.initial_setpoint
    values = {"waveform.type": "hold"}
    if bare:
        begins = [0.0, 20 / axis.plant_simulator.sample_rate, 0.5 * count / axis.plant_simulator.sample_rate]
        values = {"waveform.type": "steps", "waveform.steps.values": [0.0, way, 0.0], "waveform.steps.times": begins}
        values |= {"waveform.offset": 0.0, "waveform.steps.period": 0.0}
    setpoints = np.full(count, own.initial_setpoint)
    setpoints[20 : count // 2] += 0.0 if bare else way
    still = single_axis(configuration.override("reference_generator", **values))
    return simulate(still, setpoints=setpoints, describe=False)["voltage"]


def quantum(configuration) -> float:
    """Return the step of the converter [V], to which the voltage is rounded after the slew rate."""
    limits = single_axis(configuration).hysteresis_compensator.limits
    return (limits.maximum - limits.minimum) / (2**limits.bits - 1) if limits.bits else 0.0
