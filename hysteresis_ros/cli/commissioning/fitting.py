# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The stages that only compute: identification of the model, and design of the controller."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.analysis.commissioning_report import Picture, line
from hysteresis_ros.cli.commissioning.closed_loop import predicted_scan, scan_error
from hysteresis_ros.cli.commissioning.measuring import MICRO, steady_periods
from hysteresis_ros.cli.commissioning.situation import COMMISSIONED, IDENTIFIED, CommissioningError, Outcome, Situation
from hysteresis_ros.cli.commissioning.situation import SECTION as PLAN_SECTION
from hysteresis_ros.configuration import Configuration, dump_configuration, load_configuration, parse_configuration
from hysteresis_ros.control.controller import DESIGNS, design_of
from hysteresis_ros.designs.controller import AxisDesign, DesignRequest, design_axis, design_file, response_uncertainty
from hysteresis_ros.designs.setpoint_step import require_gentle, setpoint_step
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.parameter_file import SECTION, write_file
from hysteresis_ros.identification.preprocessing import block_means
from hysteresis_ros.identification.reading import Columns, read_data
from hysteresis_ros.identification.safe_motion import largest_change, with_comments, with_safe_motion
from hysteresis_ros.identification.workflow import Fast, Identified, identify
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.compensator import USED, CompensatorParameters, returned_commands
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.units import readable

#: Number of samples per cycle for the identification of the hysteresis; more samples add no information.
SAMPLES_A_CYCLE = 100
#: Largest number of other models with which a controller is also checked, unless these models are given.
OTHERS = 2
#: The held-out error of such a model must be less than this multiple of the error of the chosen model.
AS_LIKELY = 3.0
#: Other models with which controllers are checked if no compared model has a similar error.
USUAL = ("prandtl_ishlinskii", "duhem", "preisach")
#: Stages that move in open loop, before the design.
MOVED = ("gain", "resonance", "hysteresis", "creep")
#: Parameters, by node, that the model, the design and the limits of the range replace.
MODELLED = ("hysteresis.", "creep.", "dynamics.", "preload.", "inverse.", "model.", "sensor.", "limits.", "waveform.")
OWN = {
    "plant_simulator": MODELLED,
    "hysteresis_compensator": MODELLED,
    "motion_controller": (*MODELLED, "type"),
    "reference_generator": (*MODELLED, "minimum", "maximum", "initial_setpoint", "approach."),
}


def slow_data(situation: Situation) -> IdentificationData:
    """Return the data of the decaying cycles followed by the creep, averaged over blocks of samples.

    If the stage has a resonance and thus no slow lag, the measurement is advanced by the identified delay.
    """
    parts = [situation.folder.recording(stage) for stage in ("hysteresis", "creep")]
    late = situation.figure("resonance", "delay_s") if _is_quick(situation) else 0.0
    factor = max(int(situation.rate / (SAMPLES_A_CYCLE * situation.plan.cycle_frequency)), 1)
    voltage = np.concatenate([block_means(part["voltage"], factor) for part in parts])
    measured = np.concatenate(
        [block_means(np.interp(part.time + late, part.time, part["measured"]), factor) for part in parts]
    )
    time = np.arange(voltage.size) * factor / situation.rate
    return IdentificationData(time, voltage, measured, source="hysteresis.npz, creep.npz", factor=factor)


def _is_quick(situation: Situation) -> bool:
    """Return whether the stage has a resonance; otherwise a slower lag dominates its dynamics."""
    return "resonance_hz" in situation.found["resonance"].figures


def fast_data(situation: Situation, recording: Recording) -> Fast:
    """Return the data of the multisine, including the ramp to it."""
    steady, _ = steady_periods(situation, recording)
    time = np.arange(steady.stop) / situation.rate
    data = IdentificationData(time, recording["voltage"][: steady.stop], recording["measured"][: steady.stop])
    return Fast(data, steady.start)


def identify_stage(situation: Situation) -> Outcome:
    """Identify the stage and write the model, which is chosen by held-out blocks unless the user has named one."""
    fast = fast_data(situation, situation.folder.recording("resonance"))
    reading = read_data(slow_data(situation), Columns(all_samples=True))
    slow = "creep" if _is_quick(situation) else "lag,creep"

    def fitted(model: str) -> Identified:
        return identify(reading, model, linear=slow, fast=fast, progress=situation.progress)

    found = fitted(situation.model)
    if not found.converged:
        raise CommissioningError(f"identification: {found.reason}; choose another model: --model (hysteresis models)")
    write_file(situation.folder.path / IDENTIFIED, commissioned_text(situation, found))
    if found.response is not None and not found.response.fit_for_feedback:
        raise CommissioningError(
            f"the model is {found.response.reason}. It is in {situation.folder.path / IDENTIFIED}; to "
            "get another model, give --resume --model NAME (hysteresis models), or use a larger "
            "multisine (`small` in /commissioning)"
        )
    figures = {name: value for name, value in found.figures.items() if value is not None}
    errors = _held_out(figures)
    others, said = [], []
    for name in _others(situation, found, errors):
        try:
            other = fitted(name)
            write_file(_other_file(situation, name), commissioned_text(situation, other))
        except HysteresisError as error:
            said.append(f"{name} (left out: {' '.join(str(error).split())})")
            continue
        others.append(name)
        said.append(f"{name} {readable(other.figures['rmse_m'], 'm')}")
    lines = [
        f"model {figures['model']} with {figures['linear']}, RMS error {readable(figures['rmse_m'], 'm')} "
        f"({figures['rmse_percent_of_stroke']:.2g} % of the stroke)"
    ]
    if errors:
        best = ", ".join(f"{name} {1e9 * errors[name]:.3g}" for name in sorted(errors, key=lambda name: errors[name]))
        lines.append(f"error on held-out blocks [nm]: {best}")
    if said:
        lines.append(f"other possible models, with RMS error: {', '.join(said)}; the controller must tolerate them")
    lines += [f"note: {text}" for text in found.warnings]
    return Outcome(lines, figures | {"others": others}, _loops(found))


def _held_out(figures: dict) -> dict[str, float]:
    """Return the errors [m] on held-out blocks by the names of the tried models."""
    return {
        name.removeprefix("held_out_").removesuffix("_rmse_m"): value
        for name, value in figures.items()
        if name.startswith("held_out_") and name != "held_out_rmse_m"
    }


def _others(situation: Situation, found: Identified, errors: dict[str, float]) -> tuple[str, ...]:
    """Return the names of other models that fit almost as well."""
    chosen = found.figures["model"]
    if situation.against is not None:
        return tuple(name for name in situation.against if name != chosen)
    likely = sorted((name for name in errors if name != chosen), key=lambda name: errors[name])
    likely = [name for name in likely if errors[name] < AS_LIKELY * errors[chosen]]
    return tuple(likely or (name for name in USUAL if name != chosen))[:OTHERS]


def _other_file(situation: Situation, name: str):
    return situation.folder.path / f"other_{name}.yaml"


def _loops(found: Identified) -> list[Picture]:
    # before this sample the hysteresis depends on an unknown history
    known = slice(found.validation.skipped, None)
    voltage, measured, modelled = found.data.input[known], found.data.output[known], found.predicted[known]
    both = [line("measured", voltage, MICRO * measured), line("model", voltage, MICRO * modelled)]
    left = [line("measured − model", found.data.time[known], 1e9 * (measured - modelled))]
    return [
        Picture("Loops, measured and modelled", "voltage [V]", "displacement [µm]", both),
        Picture("Residual of the slow movements", "time [s]", "residual [nm]", left),
    ]


def commissioned_text(situation: Situation, found: Identified) -> str:
    """Return the parameter file of the axis with the identified model, its noise and the range of the plan."""
    plan, namespace = situation.plan, situation.axis.namespace
    identified = parse_configuration(found.text, "the identified model")
    limits = {"limits.minimum": plan.minimum, "limits.maximum": plan.maximum}
    # values for all nodes ('/**') also apply to the recorder
    nodes = {f"{namespace}/recorder": situation.configuration.node("recorder", namespace)}
    for node, replaced in OWN.items():
        given = situation.configuration.node(node, namespace)
        kept = {name: value for name, value in given.items() if not name.startswith(replaced)}
        own = next((dict(values) for name, values in identified.entries if name == f"/**/{node}"), {})
        if node in ("plant_simulator", "hysteresis_compensator"):
            own = {name: value for name, value in own.items() if not name.startswith("limits.")} | limits
        # the limits of motion in the identified file are from some recordings only; here they are computed from all
        own = {name: value for name, value in own.items() if not name.startswith("approach.")}
        nodes[f"{namespace}/{node}"] = kept | own
    nodes[f"{namespace}/reference_generator"] |= _used_range(
        nodes[f"{namespace}/hysteresis_compensator"], situation.rate
    )
    nodes[f"{namespace}/plant_simulator"]["sensor.noise"] = situation.figure("noise", "noise_rms_m")
    for section in (SECTION, PLAN_SECTION):
        source = identified if section == SECTION else situation.configuration
        values = next((dict(values) for name, values in source.entries if name == section), None)
        if values is not None:
            nodes[section] = values
    text = f"# Identified by `hysteresis commission {situation.configuration.source}`. SI units.\n"
    text += dump_configuration({node: _plain(values) for node, values in nodes.items()})
    text = with_safe_motion(text, "the identified axis", namespace, excited(situation), plan.amplifier)
    single_axis(parse_configuration(text, "the identified axis"), namespace)
    return text


def _used_range(compensator: dict, rate: float) -> dict[str, float]:
    """Return the range of the reference [m]: the middle part of the range that the actuator reaches repeatedly.

    Units: ``rate`` [Hz].
    """
    names = {row.name for row in CompensatorParameters.table()}
    known = CompensatorParameters.from_mapping({name: value for name, value in compensator.items() if name in names})
    low, high = returned_commands(known, 1.0 / rate)
    unused = 0.5 * (1.0 - USED) * (high - low)
    low, high = float(f"{low + unused:.4g}"), float(f"{high - unused:.4g}")
    return {"minimum": low, "maximum": high, "initial_setpoint": min(max(0.0, low), high)}


def excited(situation: Situation) -> float:
    """Return the largest slew rate of the voltage [V/s] in the open-loop stages."""
    recordings = (situation.folder.recording(stage) for stage in MOVED)
    return max(largest_change(one["voltage"], 1.0 / situation.rate) for one in recordings)


def design_stage(situation: Situation) -> Outcome:
    """Design controllers, simulate the scan of the identified stage with each, and write the best controller."""
    configuration = load_configuration(situation.folder.path / IDENTIFIED)
    plants = {name: _plant(situation, name) for name in situation.found["identify"].figures["others"]}
    names = list(DESIGNS) if situation.controller == "auto" else [situation.controller]
    design_of(names[0])
    tried: list[_Tried] = []
    reasons: dict[str, list[str]] = {}
    for number, (name, fed) in enumerate((name, fed) for name in names for fed in (False, True)):
        words = f"{name}{' with feedforward' if fed else ''}"
        situation.progress(number, words)
        try:
            tried.append(_tried(situation, configuration, plants, DesignRequest(name, feedforward=fed), words))
        except HysteresisError as error:
            reasons.setdefault(" ".join(str(error).replace(f"{name} ", "it ").split()), []).append(words)
    left_out = [f"{', '.join(those)}: {reason}" for reason, those in reasons.items()]
    if not tried:
        raise CommissioningError(f"no controller meets its required margins with this model; {left_out[0]}")
    tried.sort(key=lambda one: one.error)
    best = tried[0]
    write_file(situation.folder.path / COMMISSIONED, best.text)
    margins = best.design.margins
    lines = [
        f"{best.words}: bandwidth {margins.bandwidth:.4g} Hz, M_s {margins.sensitivity_peak:.3g}, delay margin "
        f"{margins.delay_margin_samples:.3g} samples",
        "error of the simulated scan, worst case [nm RMS]: "
        + ", ".join(f"{one.words} {1e9 * one.error:.3g} ({one.plant})" for one in tried),
        *(f"left out: {reason}" for reason in left_out),
    ]
    figures = {
        "controller": best.words,
        "bandwidth_hz": float(margins.bandwidth),
        "sensitivity_peak": margins.sensitivity_peak,
        "delay_margin_samples": margins.delay_margin_samples,
        "predicted_rms_m": best.error,
    }
    return Outcome(lines, {name: value for name, value in figures.items() if value == value})


@dataclass(frozen=True)
class _Tried:
    """A candidate design, with the file of its axis and the RMS error [m] of the scan on the worst plant."""

    words: str
    design: AxisDesign
    text: str
    plant: str
    error: float


def _plant(situation: Situation, name: str) -> dict:
    """Return the parameters of the plant that another model describes."""
    configuration = load_configuration(_other_file(situation, name))
    return configuration.node("plant_simulator", situation.axis.namespace)


def _tried(
    situation: Situation, configuration: Configuration, plants: dict[str, dict], request: DesignRequest, words: str
) -> _Tried:
    """Return a design that keeps its margins, with the file of its axis and its scan error on the worst plant."""
    namespace = situation.axis.namespace
    axis = single_axis(configuration, namespace)
    request = replace(request, noise=situation.figure("noise", "noise_rms_m") or None)
    result = design_axis(axis, request, response_uncertainty(configuration))
    if result.misses():
        raise CommissioningError("; ".join(result.misses()))
    text = design_file(configuration, result, namespace)
    own = parse_configuration(text, "the designed axis")
    require_gentle(setpoint_step(single_axis(own, namespace)))
    axes = {situation.found["identify"].figures["model"]: own}
    axes |= {name: _with_plant(own, values) for name, values in plants.items()}
    errors = {name: scan_error(situation, one, predicted_scan(situation, one)) for name, one in axes.items()}
    if not all(np.isfinite(error) for error in errors.values()):
        raise CommissioningError("the simulated axis does not follow the scan")
    worst = max(errors, key=lambda name: errors[name])
    return _Tried(words, result, axes[worst].text, worst, errors[worst])


def _with_plant(configuration: Configuration, values: dict) -> Configuration:
    """Return a configuration, and its text, with another plant."""
    nodes = dict(configuration.entries)
    name = next(name for name in nodes if name.endswith("/plant_simulator"))
    header = "".join(text + "\n" for text in configuration.original.splitlines() if text.startswith("# "))
    # the limits are kept, because the amplifier is the same
    limits = {key: value for key, value in nodes[name].items() if key.startswith("limits.")}
    plain = {**nodes, name: values | limits}
    text = header + dump_configuration({node: _plain(own) for node, own in plain.items()})
    text = with_comments(text, configuration.original)
    return parse_configuration(text, configuration.source)


def _plain(values: dict) -> dict:
    """Return parameters with lists that YAML writes in one line."""
    return {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
