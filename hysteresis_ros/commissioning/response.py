# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The stage that measures the closed loop: its margins, beside those that the design predicted."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from hysteresis_ros.analysis.pictures import Picture, line
from hysteresis_ros.commissioning.outcome import Outcome, verdict
from hysteresis_ros.commissioning.scanning import closed_axis, designed
from hysteresis_ros.commissioning.situation import Situation
from hysteresis_ros.configuration import Configuration
from hysteresis_ros.control.margins import Margins
from hysteresis_ros.control.measured_loop import MeasuredLoop
from hysteresis_ros.errors import IdentificationError, RecordingError
from hysteresis_ros.identification.excitations import Experiment, Plan, excitation
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.simulation.axes import single_axis
from hysteresis_ros.simulation.axis_response import AxisResponse, axis_response
from hysteresis_ros.simulation.learning_design import MeasuredPlant
from hysteresis_ros.simulation.response_run import around

#: What is played: lines of 4 Hz, five realisations of three periods, the first of which settles.
EXPERIMENT = Experiment(period=0.5, periods=2, settle=1, realisations=5)
#: M_s may be so many times the predicted one.
AS_PREDICTED = 1.25
#: Part of the plane that is drawn.
PLANE = 3.0


def _played(situation: Situation, configuration: Configuration) -> tuple[np.ndarray, Plan, float]:
    """Return the reference [m], where the excitation stands in it, and its peak [m]."""
    values = configuration.node("reference_generator", situation.axis.namespace)
    low, high = values["minimum"], values["maximum"]
    samples, plan = excitation(EXPERIMENT, situation.rate)
    peak = situation.plan.small * (high - low)
    reference, plan = around(samples, peak, 0.5 * (low + high), min(max(0.0, low), high), situation.rate, plan)
    return reference, plan, peak


def response_peak(situation: Situation) -> float:
    """Return how far the reference moves to both sides [m].

    Parameters
    ----------
    situation : Situation
    """
    return _played(situation, designed(situation))[2]


def response_axis(situation: Situation) -> AxisParameters:
    """Return the axis whose reference is excited in closed loop.

    Parameters
    ----------
    situation : Situation
    """
    configuration = designed(situation)
    return closed_axis(situation, configuration, "response", _played(situation, configuration)[0])


def _measured(situation: Situation, recording: Recording) -> AxisResponse:
    configuration = designed(situation)
    plan = replace(_played(situation, configuration)[1], loop="closed", at="reference")
    return axis_response(recording, plan, single_axis(configuration, situation.axis.namespace))


def measured_plant(situation: Situation) -> MeasuredPlant | None:
    """Return what the plant was measured to be in closed loop, over its model; None where nothing was seen.

    Parameters
    ----------
    situation : Situation
    """
    try:
        found = _measured(situation, situation.folder.recording("response"))
    except (IdentificationError, RecordingError):
        return None
    loop = cast("MeasuredLoop", found.loop)
    # what stands between plant and loop is the same in both
    return MeasuredPlant(loop.frequency, loop.loop / cast("np.ndarray", found.model_loop))


def judge_response(situation: Situation, recording: Recording) -> Outcome:
    """Judge the closed loop by its margins, measured and predicted.

    Parameters
    ----------
    situation : Situation
    recording : Recording
    """
    try:
        found = _measured(situation, recording)
    except (IdentificationError, RecordingError) as error:
        # what follows does not rest on it
        return Outcome([f"margins not measured: {error}; here: `small` in /commissioning"])
    # the plan closes the loop, and the axis is known
    known = found.loop, found.margins, found.model_loop
    loop, margins, model = cast("tuple[MeasuredLoop, Margins, np.ndarray]", known)
    peak, expected = loop.sensitivity_peak, margins.sensitivity_peak
    ratio = peak.low / expected
    lines = [f"M_s {peak.text('.3g')}, predicted {expected:.3g}: {verdict(ratio, AS_PREDICTED)}"]
    lines += [f"{name} {text}".replace("model", "predicted") for name, text in loop.rows(margins)[:-1]]
    return Outcome(lines, {**found.figures, "as_predicted": ratio <= AS_PREDICTED}, _pictures(loop, model))


def _pictures(loop: MeasuredLoop, model: np.ndarray) -> list[Picture]:
    f, predicted = loop.frequency, 1.0 / (1.0 + model)
    curves = [
        line("S, measured", f, np.abs(loop.sensitivity)),
        line("S, predicted", f, np.abs(predicted)),
        line("T, measured", f, np.abs(loop.complementary)),
        line("T, predicted", f, np.abs(1.0 - predicted)),
    ]
    turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 200))
    bound = -1.0 + 0.5 * turn
    near = np.abs(loop.loop) < PLANE
    plane = [
        line("loop, measured", loop.loop[near].real, loop.loop[near].imag),
        line("M_s = 2", bound.real, bound.imag),
        line("loop, predicted", model[np.abs(model) < PLANE].real, model[np.abs(model) < PLANE].imag),
        line("|L| = 1", turn.real, turn.imag),
    ]
    return [
        Picture("Sensitivity S and complementary sensitivity T", "frequency [Hz]", "magnitude [1]", curves, "xy"),
        Picture("Nyquist", "Re L", "Im L", plane, equal=True),
    ]
