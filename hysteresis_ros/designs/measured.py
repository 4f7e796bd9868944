# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Use of a measured frequency response of an axis in a design, and as the dynamics of a parameter file."""

from __future__ import annotations

import datetime
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Configuration, dump_configuration, parse_configuration
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.linearisation import whole_loop
from hysteresis_ros.control.margins import REQUIRED, MeasuredLoop, loop_of, margins_of, plant_state_space
from hysteresis_ros.control.uncertainty import ResponseUncertainty
from hysteresis_ros.designs.controller import AxisDesign
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.identification.frequency_response import Analysis
from hysteresis_ros.identification.parameter_file import SECTION
from hysteresis_ros.identification.response_check import MeasuredPlant, dynamics_of, measured_plant
from hysteresis_ros.identification.safe_motion import with_safe_motion
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.linear import LinearParameters

_HEADER = """\
# Dynamics identified by `hysteresis identify` from a measured frequency response; a ROS 2 parameter file. SI units. The
# hysteresis is that of the original file; the section /identification states the origin of the numbers.
"""


def measured_uncertainty(axis: AxisParameters, found: Analysis) -> ResponseUncertainty:
    """Return the uncertainty of the model in an axis' controller, according to a measured response."""
    plant, model = _beside(axis.motion_controller.model.dynamics, axis, found)
    return plant.uncertainty(model, found.response.sample_time)


def measured_margins(axis: AxisParameters, parameters: ControllerParameters, found: Analysis) -> MeasuredLoop:
    """Return the loop of a controller, including damping, with the measured plant."""
    plant, _ = _beside(parameters.model.dynamics, axis, found)
    sample_time = found.response.sample_time
    controller, model = whole_loop(parameters, sample_time)
    return loop_of(controller, plant.frequency, plant.response, plant.radius, sample_time, model)


def measured_lines(axis: AxisParameters, result: AxisDesign, found: Analysis) -> list[str]:
    """Return the printed margins of a design on the measured plant."""
    loop = measured_margins(axis, result.parameters, found)
    # both loops are cut at the command, so a damping is part of the controller
    model = margins_of(*whole_loop(result.parameters, found.response.sample_time), found.response.sample_time)
    rows = loop.rows(model)
    width = max(len(name) for name, _ in rows)
    lines = [f"measured {name:<{width}}  {text}" for name, text in rows]
    if loop.sensitivity_peak.low > REQUIRED.sensitivity_peak or loop.delay_margin.high < REQUIRED.delay_margin:
        lines.append(
            f"note: the measured plant does not meet M_s ≤ {REQUIRED.sensitivity_peak:g} or the delay margin of "
            f"{REQUIRED.delay_margin:g} sample, because the model differs from the plant; update its dynamics "
            "(hysteresis identify RESPONSE --into CONFIG) and design again"
        )
    return lines


@dataclass(frozen=True, eq=False)
class MeasuredDynamics:
    """A parameter file with dynamics from a measurement."""

    text: str
    figures: dict  #: Figures of the fit, by names that contain their units.
    warnings: tuple[str, ...]


def with_measured_dynamics(
    configuration: Configuration, namespace: str | None, found: Analysis, source: str, order: int | None = None
) -> MeasuredDynamics:
    """Return the parameter file of an axis; the dynamics of plant and controller model are fitted to a response."""
    axis = single_axis(configuration, namespace)
    dynamics, fit = dynamics_of(found, order)
    plant, model = _beside(dynamics, axis, found)
    values = {
        f"dynamics.{name}": list(value) if isinstance(value, tuple) else value
        for name, value in dynamics.to_mapping().items()
        if value != ()
    } | {"dynamics.sample_time": found.response.sample_time}
    put = configuration.override("plant_simulator", **values)
    put = put.override("motion_controller", type="open_loop", **{f"model.{name}": v for name, v in values.items()})
    uncertainty = plant.uncertainty(model, found.response.sample_time)
    error = np.abs(plant.response / model - 1.0)
    figures = {"order": fit.order, "rmse_of_response_percent": 100.0 * float(np.sqrt(np.mean(error**2)))}
    for number, mode in enumerate(fit.model.modes, 1):
        figures |= {f"mode_{number}_hz": float(mode.frequency), f"mode_{number}_damping": float(mode.damping)}
    before = next((own for name, own in configuration.entries if name == SECTION), {})
    kept = {name: value for name, value in before.items() if not name.startswith(("response.", "continuous."))}
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    section = kept | {"linear": f"order {fit.order}, of a frequency response", "linear_source": source}
    section |= {"date": now.isoformat()} | {f"metrics.{name}": value for name, value in figures.items()}
    section |= entries(uncertainty)
    text = single_axis(put, axis.namespace).configuration_text()
    text = _HEADER + text + dump_configuration({SECTION: _plain(section)})
    text = with_safe_motion(text, "the measured axis", axis.namespace)
    parse_configuration(text, "the measured axis")
    return MeasuredDynamics(text, figures, fit.warnings)


def entries(found: ResponseUncertainty, axis: str = "") -> dict:
    """Return an uncertainty as entries of a parameter file, for a later design; a stage has entries for each axis."""
    start = f"{axis}.response." if axis else "response."
    known = {f"{start}known_to": found.known_to} if np.isfinite(found.known_to) else {}
    return {
        f"{start}frequencies": tuple(float(f"{value:.6g}") for value in found.frequencies),
        f"{start}uncertainty": tuple(float(f"{value:.3g}") for value in found.relative),
        **known,
        **({f"{start}gain": found.gain} if found.gain > 1.0 else {}),
    }


def _plain(values: dict) -> dict:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}


def _beside(dynamics: LinearParameters, axis: AxisParameters, found: Analysis) -> tuple[MeasuredPlant, np.ndarray]:
    """Return the measured plant, and the response of ``dynamics`` at the measured lines."""
    sample_time, own = found.response.sample_time, 1.0 / axis.motion_controller.sample_rate
    if abs(sample_time / own - 1.0) > 1e-6:
        raise ConfigurationError(
            f"the response was measured at a sample rate of {1.0 / sample_time:.6g} Hz, but the axis "
            f"runs at {1.0 / own:.6g} Hz; measure it at the rate of the axis"
        )
    z = np.exp(2j * np.pi * found.response.frequency * sample_time)
    model = plant_state_space(dynamics).response(z)[:, 0, 0]
    return measured_plant(found, model), model
