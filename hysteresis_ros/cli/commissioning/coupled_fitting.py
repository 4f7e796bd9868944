# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Coupled axes: from their recordings to a model, and from the model to controllers and a parameter file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.analysis.commissioning_report import Picture, line
from hysteresis_ros.cli.commissioning.coupled import DESIGNED, StageSituation
from hysteresis_ros.cli.commissioning.coupled_measuring import identification_data, reading_of
from hysteresis_ros.cli.commissioning.measuring import MICRO
from hysteresis_ros.cli.commissioning.situation import COMMISSIONED, IDENTIFIED, CommissioningError, Outcome
from hysteresis_ros.cli.commissioning.situation import SECTION as PLAN_SECTION
from hysteresis_ros.configuration import Configuration, dump_configuration, load_configuration, parse_configuration
from hysteresis_ros.control.coupling import disk_margins
from hysteresis_ros.designs.coupled import response_uncertainties, stage_lines
from hysteresis_ros.designs.stage_frequency_response import decoupled_responses
from hysteresis_ros.designs.stage_identification import (
    DEVIATING,
    IdentifiedStage,
    StageRequest,
    design_identified,
    identify_stage,
    put_into,
)
from hysteresis_ros.identification.frequency_response import response_matrix
from hysteresis_ros.identification.parameter_file import SECTION, write_file
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_response import stage_loop
from hysteresis_ros.units import readable

#: Largest error of the model on the held-out data without the error of its gain, as a fraction of the motion.
UNFIT = 0.2
#: The gains of model and data must differ by less than this factor, in either direction, so that a design keeps its
#: margins.
STEEPEST = 2.0
#: Largest error of the hysteresis model on the recorded loops, as a fraction of the stroke.
LOOSE = 0.05


def identify_coupled(situation: StageSituation) -> Outcome:
    """Identify the stage and write its file (open loop); test the model on a held-out realisation of the multisines."""
    reading, data = identification_data(situation, situation.folder.recording("multisine"))
    loops = reading_of(situation.folder.recording("hysteresis"), "hysteresis.npz")
    request = StageRequest(
        axes=situation.names,
        model=situation.model,
        controller="none",
        resting_noise=tuple(situation.figures("noise")[name]["noise_rms_m"] for name in situation.names),
        progress=lambda text: situation.progress(0, text),
    )
    found = identify_stage(reading, data, request, loops)
    write_file(situation.folder.path / IDENTIFIED, found.text)
    held = found.held_out
    if held is None:
        raise CommissioningError("no realisation was held out; start again in another --directory")
    lines = [f"{found.figures['type']} of order {found.figures['order']}, {found.figures['lines']} lines"]
    errors = zip(situation.names, held.errors, held.shapes, held.gains, held.motion, strict=True)
    for name, error, shape, gain, motion in errors:
        percent = found.figures[f"loops_{name}_rmse_percent_of_stroke"]
        deviates = not 1.0 / DEVIATING <= gain <= DEVIATING
        own = f" ({100.0 * shape / motion:.2g} % with {gain:.3g} times the gain)" if deviates else ""
        lines.append(
            f"{name}: held-out error {readable(float(error), 'm')} RMS, {100.0 * error / motion:.2g} % of the motion"
            f"{own}; loops {percent:.2g} % of the stroke"
        )
        unfit = ""
        if not 1.0 / STEEPEST < gain < STEEPEST:
            unfit = "more than twice or less than half the gain"
        elif shape > UNFIT * motion or percent > 100.0 * LOOSE:
            unfit = f"more than {100.0 * UNFIT:g} % of the motion, or {100.0 * LOOSE:g} % of the stroke"
        if unfit:
            raise CommissioningError(
                f"{lines[-1]}: {unfit}: the model is not fit for feedback. It is in "
                f"{situation.folder.path / IDENTIFIED}; choose another with "
                "--resume --model NAME (hysteresis models), or check that nothing else moves the stage"
            )
    lines += [f"note: {text}" for text in found.warnings]
    return Outcome(lines, found.figures, _pictures(situation, found))


def _pictures(situation: StageSituation, found: IdentifiedStage) -> list[Picture]:
    response, pictures = found.responses[0].response, []
    for i, name in enumerate(situation.names):
        traces = []
        for j, other in enumerate(situation.names):
            for label, values in (("measured", response.response), ("model", found.structure)):
                traces.append(line(f"from {other}, {label}", response.frequency, MICRO * np.abs(values[:, i, j])))
        pictures.append(Picture(f"Response of {name}", "frequency [Hz]", "gain [µm/V]", traces, "xy"))
        one = found.loops[i]
        if one is not None:
            known = slice(one.validation.skipped, None)
            volts = one.data.input[known]
            both = [
                line("measured", volts, MICRO * one.data.output[known]),
                line("model", volts, MICRO * (one.predicted[known] + one.validation.offset)),
            ]
            pictures.append(Picture(f"Loops of {name}", "voltage [V]", "displacement [µm]", both))
    return pictures


def design_coupled(situation: StageSituation) -> Outcome:
    """Design a controller for each axis, check all loops together, and write the stage that predicts the runs."""
    (situation.folder.path / COMMISSIONED).unlink(missing_ok=True)
    configuration = load_configuration(situation.folder.path / IDENTIFIED)
    parameters = StageParameters.from_configuration(configuration)
    _, data = identification_data(situation, situation.folder.recording("multisine"))
    responses = response_matrix(data.u, data.y, data.sample_time, data.period)
    analyses = decoupled_responses(responses, np.array(situation.figures("identify")["gain_m_per_v"]))
    noise = max(situation.figures("noise")[name]["noise_rms_m"] for name in situation.names) or None
    request = StageRequest(controller=situation.controller)
    known = response_uncertainties(configuration, parameters)
    text, designs, why = design_identified(configuration.original, parameters, request, noise, analyses, known)
    if not designs:
        raise CommissioningError(f"{why[0]}; choose another with --resume --controller NAME")
    designed = StageParameters.from_configuration(parse_configuration(text, "the designed stage"))
    together = disk_margins(stage_loop(designed), 1.0 / situation.rate).together
    if together.alpha <= 0.0:
        raise CommissioningError(
            "each loop is stable alone, but all together are not: the axes are coupled too strongly near the "
            "crossover; choose a slower controller with --resume --controller NAME"
        )
    write_file(situation.folder.path / DESIGNED, text)
    lines: list[str] = []
    figures: dict = {"disk_margin_db": together.gain_margin}
    for name, design in designs.items():
        margins = design.margins
        lines.append(
            f"{name}: {design.parameters.type}, bandwidth {margins.bandwidth:.4g} Hz, M_s "
            f"{margins.sensitivity_peak:.3g}, delay margin {margins.delay_margin_samples:.3g} samples"
        )
        figures[name] = {"bandwidth_hz": float(margins.bandwidth), "sensitivity_peak": margins.sensitivity_peak}
    return Outcome([*lines, *stage_lines(designed), *(f"note: {text}" for text in why)], figures)


def closed_configuration(situation: StageSituation, watched: bool = True) -> Configuration:
    """Return the stage with the designed parameters; ``watched``: with the travel limits of the commissioning."""
    designed = load_configuration(situation.folder.path / DESIGNED)
    into = situation.within()
    if not watched:
        own: list[tuple[str, dict]] = []
        for axis in _axes(situation):
            own.append((f"{axis.namespace}/plant_simulator", {"overtravel": axis.plant_simulator.overtravel}))
        into = replace(into, entries=(*into.entries, *own))
    text = put_into(into, designed, StageParameters.from_configuration(designed))
    return parse_configuration(text, "the commissioned stage")


def _axes(situation: StageSituation):
    return situation.parameters.axes


def commissioned_text(situation: StageSituation) -> str:
    """Return the parameter file of the finished stage, with the sections for the origin of its numbers and the plan."""
    text = closed_configuration(situation, watched=False).original
    body = "".join(one for one in text.splitlines(keepends=True) if not one.startswith("#"))
    head = (
        f"# Commissioned by `hysteresis commission {situation.configuration.source}`. SI units.\n"
        "# /identification and /commissioning are not nodes: origin of the numbers, and allowed movements.\n"
    )
    sections: dict[str, dict] = {}
    designed = load_configuration(situation.folder.path / DESIGNED)
    wanted = [(designed, SECTION), *((situation.configuration, name) for name in _plan_sections(situation))]
    for source, section in wanted:
        found = next((values for name, values in source.entries if name == section), None)
        if found is not None:
            sections[section] = {key: tuple(one) if isinstance(one, list) else one for key, one in found.items()}
    return head + body.rstrip("\n") + "\n" + dump_configuration(sections)


def _plan_sections(situation: StageSituation) -> list[str]:
    return [PLAN_SECTION, *(f"{axis.namespace}{PLAN_SECTION}" for axis in _axes(situation))]
