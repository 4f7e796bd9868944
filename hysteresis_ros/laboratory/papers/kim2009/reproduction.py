# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The experiments of Kim, Kim & Park 2009 on the axis of ``config/kim2009.yaml``, which states its assumptions.

Identification, preload (fig. 10) and uncontrolled steps (fig. 12) come first. The paper's section 4 follows: an
open-loop triangle with the inverse hysteresis model (fig. 13), and steps under sliding mode control without this model
(fig. 15) and with it (fig. 17). These experiments are repeated with a less accurate compensator and with an estimated
disturbance, then with one non-ideal condition at a time, and with other tasks.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.configuration import Configuration, load_configuration
from hysteresis_ros.control import state_feedback
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.kalman import filter_gain
from hysteresis_ros.laboratory.papers.claims import (
    Claim,
    Reproduction,
    loops_comparison,
    loops_overlay,
    prediction_figure,
    response_figure,
    traces_comparison,
)
from hysteresis_ros.laboratory.papers.kim2009 import axis as kim
from hysteresis_ros.laboratory.papers.kim2009 import identification, tracking
from hysteresis_ros.laboratory.papers.kim2009.identification import paper_k
from hysteresis_ros.laboratory.papers.runs import loop_width, step_figures
from hysteresis_ros.loop.parameters import AxisParameters, part
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.recordings.dataset import Recording

TITLE = "Kim, Kim & Park 2009, inchworm with piezo stack: hysteresis compensation and sliding mode control"

# Runs in the plots.
STEP_RUNS = UNCONTROLLED, CONTROLLED, COMPENSATED = "uncontrolled", "sliding mode", "sliding mode and compensator"
HONEST_RUNS = TRUSTING, ESTIMATING = "compensator off by 5 %", "the same, disturbance estimated"
TRIANGLE_RUNS = TRIANGLE, STRAIGHT = "no inverse", "exact inverse"
PRELOAD_RUNS = FREE, LOADED = "no preload", f"preload {kim.PRELOAD:g} N"
PREDICTED, EXCITED = "identified model", "multisine"
MODEL_GROUP = "Model and gains (sections 2.4 and 4.2)"


def reproduce(configuration: Configuration | None = None) -> Reproduction:
    """Repeat the paper's experiments and check every claim."""
    configuration = load_configuration("kim2009") if configuration is None else configuration
    axis = single_axis(configuration)
    perfect = kim.ideal(configuration)
    stroke = kim.MAXIMUM_VOLTAGE * axis.plant_simulator.hysteresis.polynomial.virgin[1]
    mistaken = kim.real(configuration, kim.MISMATCH)
    runs = {
        UNCONTROLLED: kim.run_steps(kim.open_loop(kim.uncompensated(perfect))),
        CONTROLLED: kim.run_steps(kim.uncompensated(perfect)),
        COMPENSATED: kim.run_steps(perfect),
        TRUSTING: kim.run_steps(mistaken),
        ESTIMATING: kim.run_steps(kim.estimating(mistaken)),
        TRIANGLE: kim.run_cycles(kim.uncompensated(perfect), "triangle", stroke, kim.TRIANGLE_FREQUENCY),
        STRAIGHT: kim.run_cycles(perfect, "triangle", stroke, kim.TRIANGLE_FREQUENCY),
        FREE: _small_loop(perfect),
        LOADED: _small_loop(kim.preloaded(perfect)),
        EXCITED: identification.run_excitation(configuration),
    }
    identified = paper_k()
    runs[PREDICTED] = identification.prediction(identified)
    claims = [
        *_model_claims(axis),
        *identification.identification_claims(identified, runs[EXCITED]),
        *tracking.uncontrolled_claims(perfect, runs[UNCONTROLLED]),
        *tracking.branch_claims(axis.plant_simulator.hysteresis.polynomial, stroke),
        *tracking.element_claims(perfect, stroke),
        *tracking.dynamics_claims(perfect, stroke, loop_width(runs[TRIANGLE]), loop_width(runs[STRAIGHT])),
        *tracking.sliding_mode_claims(runs[CONTROLLED], runs[COMPENSATED]),
        *_preload_claims(perfect, runs[FREE], runs[LOADED]),
        *tracking.honest_triangle_claims(configuration, stroke),
        *tracking.honest_step_claims(configuration),
        *tracking.estimating_claims(configuration),
        *tracking.condition_claims(configuration),
        *tracking.task_claims(configuration, stroke),
    ]
    return Reproduction("kim2009", TITLE, tuple(claims), runs, configuration.original)


def figures(found: Reproduction) -> list:
    """Return the plots of a reproduction: captions and figures; needs Matplotlib."""
    moves = {name: found.runs[name] for name in STEP_RUNS}
    honest = {name: found.runs[name] for name in HONEST_RUNS}
    # the first step leads up, the second one back to 0 V
    up, back = 0.5 * kim.STEP_TIME, 1.5 * kim.STEP_TIME
    # the reference of sample k first acts at sample k + 1
    loops = {name: (found.runs[name]["reference"][:-1], found.runs[name]["displacement"][1:]) for name in TRIANGLE_RUNS}
    response, fit = identification.structure(found.runs[EXCITED])
    fitted = fit.model.frequency_response(response.frequency)[:, 0, 0]
    preload = {
        "as measured": {name: _branches(found.runs[name], 0.0) for name in PRELOAD_RUNS},
        "minus the offset at rest": {name: _branches(found.runs[name], 1.0) for name in PRELOAD_RUNS},
    }
    return [
        (
            "Polynomial model from 20 loops, on a decreasing triangle that was not used for the fit",
            prediction_figure(found.runs[PREDICTED]),
        ),
        (
            f"Frequency response around 635 Hz, and the fit of order {fit.order}",
            response_figure(response.frequency, response.single, fitted),
        ),
        (f"Loop of {kim.PRELOAD_VOLTAGE:g} V with and without preload", loops_overlay(preload)),
        ("Steps of 1 V: whole run, and the return to 0 V", traces_comparison(moves, (back - 0.02, back + 0.12))),
        ("Realistic conditions: whole run, and the first step", traces_comparison(honest, (up - 0.02, up + 0.12))),
        ("Open-loop triangle of 2 Hz, dynamics included, before and after compensation", loops_comparison(loops)),
    ]


def _deviation(name: str, quantity: str, found, published, assumption: str) -> Claim:
    """Return the row with the largest deviation of numbers from the published ones."""
    return Claim(
        f"model.{name}",
        MODEL_GROUP,
        f"{quantity}: largest deviation",
        float(np.max(np.abs(np.asarray(found) - published))),
        "1",
        paper=", ".join(f"{value:g}" for value in published),
        high=kim.GAIN_TOLERANCE,
        assumptions=(kim.MODEL, assumption),
    )


def _model_claims(axis: AxisParameters) -> list[Claim]:
    control = part(axis.motion_controller, ControllerParameters)
    model = control.model.dynamics.state_space
    A, B = model.A, model.B
    law = control.sliding_mode
    K, _ = state_feedback.sliding_gain(A, B, law.S, law.phi)
    noise = {"kalman.gain": "riccati", "kalman.q": kim.NOISE_RATIO, "kalman.r": 1.0}
    L = filter_gain(ControllerParameters.from_mapping(control.to_mapping() | noise).kalman, model)
    poles = np.sort(np.linalg.eigvals(A - B @ K[np.newaxis]).real)
    modes = np.log(model.poles.astype(complex)) * axis.plant_simulator.sample_rate
    slowest_decay = modes[np.argmin(np.abs(modes.real))]
    _, rest_input = state_feedback.steady_state(model)
    scale = control.model.dynamics.output_scale

    noisy = "process noise enters with the input: Q = q B Bᵀ"
    return [
        _deviation("linear_gain", "linear gain from A, B, S, Φ", K, kim.LINEAR_GAIN, kim.LAW),
        _deviation("observer_gain", f"L from A, B, C and q/r = {kim.NOISE_RATIO:g}", L, kim.OBSERVER_GAIN, noisy),
        replace(_deviation("poles", "poles of A − B K", poles, kim.POLES, kim.LAW), derived=True),
        Claim(
            "model.resonance",
            MODEL_GROUP,
            "resonance of A",
            float(np.abs(slowest_decay)) / (2.0 * np.pi),
            "Hz",
            paper=kim.RESONANCE,
            low=0.998 * kim.RESONANCE,
            high=1.002 * kim.RESONANCE,
            assumptions=(kim.MODEL,),
        ),
        Claim(
            "model.dc_gain",
            MODEL_GROUP,
            "displacement per volt before the amplifier",
            scale / rest_input,
            "m/V",
            paper=kim.DC_GAIN,
            derived=True,
            low=0.999 * kim.DC_GAIN,
            high=1.001 * kim.DC_GAIN,
            assumptions=(kim.MODEL,),
        ),
    ]


def _small_loop(configuration: Configuration) -> Recording:
    """Return the paper's sine of 20 V (figure 10)."""
    amplitude = kim.PRELOAD_VOLTAGE * configuration.node("plant_simulator")["hysteresis.polynomial.virgin"][1]
    return kim.run_cycles(kim.uncompensated(configuration), "sine", amplitude, kim.TRIANGLE_FREQUENCY)


def _branches(run: Recording, part: float) -> tuple[np.ndarray, np.ndarray]:
    """Return voltage and displacement of a loop, minus a fraction ``part`` of the displacement at rest."""
    # the voltage of sample k first acts at sample k + 1
    displacement = run["displacement"][1:]
    return run["voltage"][:-1], displacement - part * run["displacement"][0]


def _preload_claims(perfect: Configuration, free: Recording, loaded: Recording) -> list[Claim]:
    group = f"Preload of {kim.PRELOAD:g} N (section 2.3, figure 10)"
    offset = -kim.PRELOAD / kim.STIFFNESS
    controlled = step_figures(kim.run_steps(kim.preloaded(perfect)))
    return [
        Claim(
            "preload.offset",
            group,
            "offset W at rest",
            float(loaded["displacement"][0] - free["displacement"][0]),
            "m",
            paper=offset,
            low=1.001 * offset,
            high=0.999 * offset,
            assumptions=(kim.COMPLIANCE,),
            reason="follows from the printed stiffness; the paper's own coefficients A1, B1, B2 are not in its text",
        ),
        Claim(
            "preload.loop",
            group,
            f"loop of a {kim.PRELOAD_VOLTAGE:g} V sine: change of its width, % of the stroke",
            abs(loop_width(loaded) - loop_width(free)),
            "%",
            paper="no change",
            high=0.01,
            assumptions=(kim.COMPLIANCE, kim.STACK, "sine of 2 Hz"),
        ),
        Claim(
            "preload.residual",
            group,
            "sliding mode with compensator: residual at 0 V above W",
            controlled.residual,
            "m",
            paper="removed",
            high=kim.GOOD_RESIDUAL,
            assumptions=(kim.MODEL, kim.LAW, kim.STACK, kim.AMPLIFIED, kim.COMPLIANCE, kim.CLEAN),
        ),
    ]
