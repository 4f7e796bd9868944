# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Stages for tests: with the axes of xy_scanner, with a single axis, and with modes defined here."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.configuration import Configuration, load_configuration
from hysteresis_ros.loop.stage import Stage
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.models.linear import zero_order_hold
from hysteresis_ros.models.structure import StructureParameters

#: Sample time of xy_scanner [s].
SAMPLE_TIME = 1e-4

#: A stage with linear open-loop actuators: 1 V moves an actuator by 0.4 µm, without creep and noise.
LINEAR = {
    "plant_simulator": {
        "hysteresis__type": "proportional",
        "hysteresis__proportional__gain": 0.4e-6,
        "creep__type": "none",
        "sensor__noise": 0.0,
        "sensor__resolution": 0.0,
        "limits__bits": 0,
        "limits__slew_rate": 0.0,
        "dynamics__delay": 0.0,
        "overtravel": -1.0,
    },
    "hysteresis_compensator": {
        "hysteresis__type": "proportional",
        "hysteresis__proportional__gain": 0.4e-6,
        "creep__type": "none",
        "limits__bits": 0,
        "limits__slew_rate": 0.0,
    },
    "motion_controller": {"type": "open_loop", "damping__type": "none"},
    "reference_generator": {
        "waveform__type": "hold",
        "approach__maximum_velocity": 0.0,
        "approach__maximum_acceleration": 0.0,
        "approach__maximum_jerk": 0.0,
    },
}


def configured(name: str = "xy_scanner", **overrides) -> Configuration:
    """Return a configuration; ``overrides`` by node, with double underscores for dots."""
    configuration = load_configuration(name)
    for node, values in overrides.items():
        configuration = configuration.override("" if node == "every" else node.replace("__", "/"), **values)
    return configuration


def stage(name: str = "xy_scanner", **overrides) -> Stage:
    """Return a stage at rest; arguments as :func:`configured`."""
    return Stage(StageParameters.from_configuration(configured(name, **overrides)))


def linear_stage(nodes: dict | None = None, **overrides) -> Stage:
    """Return xy_scanner with linear open-loop actuators, and other values of its section ``stage``.

    Values of ``nodes`` apply to plant and compensator alike.
    """
    return stage(**_with(LINEAR, nodes), **({"stage": overrides} if overrides else {}))


def _with(given: dict, nodes: dict | None) -> dict:
    """Return parameters by node, with the given ones of plant and compensator added."""
    alike = ("plant_simulator", "hysteresis_compensator")
    return given | {name: given[name] | (nodes or {}) for name in alike}


def modes(frequencies, dampings) -> tuple[np.ndarray, np.ndarray]:
    """Return A and inputs of modes for held inputs; states: displacement, and velocity over frequency [rad/s]."""
    count = len(frequencies)
    A, B = np.zeros((2 * count, 2 * count)), np.zeros((2 * count, count))
    for i, (frequency, damping) in enumerate(zip(frequencies, dampings, strict=True)):
        w = 2.0 * np.pi * frequency
        part = slice(2 * i, 2 * i + 2)
        A[part, part], held = zero_order_hold([[0.0, w], [-w, -2.0 * damping * w]], [[0.0], [w]], SAMPLE_TIME)
        B[part, i] = held[:, 0]
    return A, B


def internal_structure(stiffening: float = 0.04, coupling: float = 0.05) -> StructureParameters:
    """Return two modes at 700 and 800 Hz with hysteresis that acts on the modes and is driven by them.

    The input is in volts, 0.4 µm each; small motions are linear, in larger ones the plays add a force.
    """
    A, B = modes((700.0, 800.0), (0.01, 0.01))
    gain = np.array([[1.0, coupling], [coupling, 1.0]])
    C = np.zeros((2, 4))
    C[:, ::2] = 0.4e-6 * gain
    motion = np.zeros((2, 4))
    motion[0, 0] = motion[1, 2] = -0.5  # V of the play for the displacement of 1 V
    return StructureParameters(
        inputs=2,
        outputs=2,
        A=tuple(A.ravel()),
        B=tuple((0.9 * B).ravel()),
        C=tuple(C.ravel()),
        B_w=tuple(B.ravel()),
        C_z=tuple(motion.ravel()),
        radii=(1.0, 4.0, 10.0),
        weights=(stiffening, stiffening, 2.0 * stiffening) * 2,
        sample_time=SAMPLE_TIME,
    )


def as_values(structure: StructureParameters) -> dict:
    """Return a structure as values of the section ``stage``."""
    return {f"structure__{name}": value for name, value in structure.to_mapping().items()}


def internal_stage(structure: StructureParameters | None = None, nodes: dict | None = None, **overrides) -> Stage:
    """Return an open-loop stage with hysteresis inside its structure; its actuators pass their voltages on."""
    values = {**as_values(structure or internal_structure()), "type": "internal", "decoupling": []}
    plant = {**LINEAR["plant_simulator"], "hysteresis__proportional__gain": 1.0}
    return stage(**_with({**LINEAR, "plant_simulator": plant}, nodes), stage=values | overrides)


def driven(one: Stage, voltages) -> np.ndarray:
    """Return the displacements [m], shape (N, n), of a stage under open-loop voltages [V], shape (N, n).

    Row k is measured before the voltage of sample k is put out.
    """
    gains = [axis.parameters.hysteresis_compensator.hysteresis.chosen.gain for axis in one.axes]
    setpoints = {
        name: gain * np.asarray(voltages)[:, i] for i, (name, gain) in enumerate(zip(one.names, gains, strict=True))
    }
    found = one.run(setpoints)
    put_out = np.column_stack([found[name]["plant_voltage"] for name in one.names])
    np.testing.assert_allclose(put_out, voltages, atol=1e-9)
    return np.column_stack([found[name]["displacement"] for name in one.names])
