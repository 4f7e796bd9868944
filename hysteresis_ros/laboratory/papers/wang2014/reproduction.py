# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The experiments of Wang, Alici & Tan 2014 on the axis of ``config/wang2014.yaml``, which states its assumptions.

The truth is a modified Prandtl-Ishlinskii element with a second-order linear part, never the Duhem model that the paper
identifies. Four controllers are compared in every row: the paper's linear inverse, its inverse Duhem model with α = 80,
a Duhem model whose α comes from minor loops, and a Prandtl-Ishlinskii model. Their parameters come from the files
``config/wang2014*.yaml``, which :mod:`.identification` derives from recordings; only the Duhem functions of the element
alone are identified here (W3).
"""

from __future__ import annotations

import numpy as np

from hysteresis_ros.analysis.identification_report import correlations_figure
from hysteresis_ros.configuration import Configuration
from hysteresis_ros.identification.validation import validate
from hysteresis_ros.laboratory.papers.claims import (
    Reproduction,
    errors_comparison,
    history_figure,
    loops_comparison,
    loops_overlay,
    responses_comparison,
)
from hysteresis_ros.laboratory.papers.wang2014 import axis as wang
from hysteresis_ros.laboratory.papers.wang2014 import control, model
from hysteresis_ros.laboratory.papers.wang2014.identification import training_history
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.recordings.dataset import Recording

TITLE = "Wang, Alici & Tan 2014, conducting polymer actuator: Duhem model and inverse feedforward"

SHOWN = "π"  # rad/s, of the plots
PLOTTED = np.geomspace(0.05, 90.0, 300)  # Hz
MEASURED = "measured"


def reproduce(configuration: Configuration | None = None) -> Reproduction:
    """Repeat the paper's experiments and check every claim."""
    axes = wang.controllers(configuration)
    better = axes[wang.BETTER]
    clean = wang.ideal(better)
    full, half = (wang.record_sines(clean, part * wang.VOLTAGE) for part in (1.0, 0.5))
    runs: dict[str, Recording] = {}
    claims = [
        *model.preparation_claims(axes, full, half),
        *model.shape_claims(better),
        *model.model_claims(axes, full, half),
        *control.tracking_claims(axes, runs),
        *control.honest_claims(axes),
        *control.sweep_claims(axes),
        *control.feedback_claims(axes),
    ]
    frequency = wang.FREQUENCIES[SHOWN]
    runs[MEASURED] = wang.play(
        wang.real(better), 3.0 / frequency, type="sine", frequency=frequency, amplitude=wang.VOLTAGE
    )
    return Reproduction("wang2014", TITLE, tuple(claims), runs, better.text)


def figures(found: Reproduction) -> list:
    """Return the plots of a reproduction: captions and figures; needs Matplotlib."""
    axes = wang.controllers()
    better = axes[wang.BETTER]
    cases = {key: f"full.{SHOWN}.{key}" for key in axes}
    validation = _validation(better, found.runs[MEASURED])
    loop = model.Element(better).loop()
    histories = {f"α = {alpha:g}": training_history(loop, alpha) for alpha in (3.0, wang.PUBLISHED_ALPHA)}
    responses = {"truth (assumed)": model.linear_response(single_axis(better).plant_simulator.dynamics, PLOTTED)}
    for key, label in ((wang.LINEAR, "G1"), (wang.PAPER, "G2, α = 80"), (wang.BETTER, "G2, Prandtl-Ishlinskii")):
        responses[label] = model.linear_response(model.controller_dynamics(axes[key]), PLOTTED)
    return [
        ("Quasi-static loops of the truth and of the identified models", loops_overlay(_loops(axes))),
        (f"Tracking of {SHOWN} rad/s: displacement over reference", loops_comparison(_tracked(axes, found, cases))),
        (f"Tracking errors, {SHOWN} rad/s, full amplitude", _errors(axes, found, "full")),
        (f"Tracking errors, {SHOWN} rad/s, half amplitude", _errors(axes, found, "half")),
        ("Linear parts, each of unit gain at 0 Hz", responses_comparison(PLOTTED, responses)),
        (
            f"Residual of the Prandtl-Ishlinskii model and G2 on a noisy recording of {SHOWN} rad/s",
            correlations_figure(validation),
        ),
        ("Training of the networks f and g on the loop to ±1 V", history_figure(histories)),
    ]


def _validation(configuration: Configuration, measured: Recording):
    voltage = measured["voltage"]
    skip = round(1.0 / wang.FREQUENCIES[SHOWN] / measured.sample_time)
    return validate(measured["measured"], model.predict(configuration, voltage), input=voltage, skip=skip)


def _loops(axes) -> dict:
    element = model.Element(axes[wang.BETTER])
    panels = {}
    for part in (1.0, 0.5):
        voltage = part * element.major
        last = slice(2 * model.SAMPLES, None)
        loops = {"truth": (voltage[last], element.displacement(voltage)[last])}
        for key in (wang.PAPER, wang.MINOR, wang.BETTER):
            loops[wang.WORDS[key]] = (voltage[last], model.hysteresis_output(axes[key], voltage)[last])
        panels[f"±{part:g} V"] = loops
    return panels


def _tracked(axes, found: Reproduction, cases) -> dict:
    shown = {}
    for key, label in {wang.LINEAR: "G1", wang.PAPER: "α = 80", wang.BETTER: "plays"}.items():
        run = found.runs[cases[key]]
        last = run.time >= 1.0 / wang.FREQUENCIES[SHOWN]
        shown[label] = (wang.delayed_reference(axes[key], run)[last], run["displacement"][last])
    return shown


def _errors(axes, found: Reproduction, words: str):
    errors = {}
    for key in axes:
        run = found.runs[f"{words}.{SHOWN}.{key}"]
        start = 1.0 / wang.FREQUENCIES[SHOWN]
        errors[wang.WORDS[key]] = (run.time[run.time >= start - 1e-9], wang.tracking_error(axes[key], run, start))
    large = {wang.WORDS[wang.LINEAR]} if words == "full" else {wang.WORDS[key] for key in (wang.LINEAR, wang.PAPER)}
    return errors_comparison(errors, tuple(label for label in errors if label not in large))
