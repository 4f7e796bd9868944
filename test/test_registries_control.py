# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The contract of registered controllers and waveforms: each follows its declaration, whatever package it is from."""

from __future__ import annotations

import functools
import json
import os
import pathlib
import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest

from hysteresis_ros.configuration import dump_configuration, load_configuration, parse_configuration
from hysteresis_ros.control.controller import (
    DESIGNS,
    LAWS,
    ControllerParameters,
    History,
    arm,
    controller_block,
    handover_block,
    note,
    successor,
)
from hysteresis_ros.control.law import APPLIED, COMMAND, ESTIMATED, FEEDFORWARD, STARTED, Controller
from hysteresis_ros.control.margins import judge
from hysteresis_ros.designs.gains import design_gains
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.laboratory.comparison.candidates import candidates, known
from hysteresis_ros.laboratory.comparison.laws import ROWS
from hysteresis_ros.laboratory.comparison.tasks import Conditions, make_tasks
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters
from hysteresis_ros.references.classes import CLASSES
from hysteresis_ros.references.generator import ReferenceGenerator, ReferenceParameters
from hysteresis_ros.references.waveforms import WAVEFORMS, Waveform, WaveformParameters
from hysteresis_ros.registry import class_name

ROOT = pathlib.Path(__file__).resolve().parents[1]
#: Sample time [s], step of the reference [m] and bandwidth of the designs [Hz].
T, STEP, BANDWIDTH = 1e-3, 2e-6, 20.0
#: A model with two lags and unit gain.
MODEL = LinearParameters(A=(0.0, 1.0, -0.48, 1.4), B=(0.0, 1.0), C=(0.05, 0.03), output_scale=1e-6)

laws = pytest.mark.parametrize("law", LAWS.values(), ids=list(LAWS))
designs = pytest.mark.parametrize("name", DESIGNS)
shapes = pytest.mark.parametrize("shape", WAVEFORMS.values(), ids=list(WAVEFORMS))


def plain() -> ControllerParameters:
    entries = {f"model.dynamics.{name}": value for name, value in MODEL.to_mapping().items()}
    return ControllerParameters.from_mapping(entries)


@functools.cache
def designed(name: str, bandwidth: float | None = BANDWIDTH) -> ControllerParameters:
    return design_gains(plain(), name, T, bandwidth).parameters


def example(law) -> ControllerParameters:
    """Parameters of the first design, or only the model for a law without designs."""
    if not law.designs:
        return ControllerParameters.from_mapping({**plain().to_mapping(), "type": law.name})
    return designed(next(iter(law.designs)))


class Loop:
    """Controller, hand-over and the model as plant, in the order of the nodes."""

    def __init__(self, parameters: ControllerParameters):
        self.controller, self.handover = controller_block(parameters, T), handover_block(parameters, T)
        self.plant, self.history = LinearDynamics(MODEL, T), History()
        self.command = 0.0

    def run(self, reference, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return commands and displacements, shape (count,) [m]."""
        commands, places = np.empty(count), np.empty(count)
        for k in range(count):
            x, places[k] = self.controller.x, self.plant.output()
            note(self.history.x, x[APPLIED], reference, x[FEEDFORWARD], places[k])
            commands[k] = self.handover.step(self.controller.step(reference, places[k]))
            self.controller.x[COMMAND] = self.controller.x[APPLIED] = commands[k]
            self.plant.step(commands[k])
        return commands, places


def round_trip(parameters, kind):
    given = parameters.to_mapping()
    assert {type(value) for value in given.values()} <= {float, int, bool, str, tuple}, "no NumPy types"
    text = dump_configuration({"/**/node": {name: value for name, value in given.items() if value != ()}})
    return kind.from_mapping(parse_configuration(text, "test").node("node"))


@laws
def test_a_controller_says_what_it_is_and_its_parameters_are_documented(law):
    assert law.name == law.name.lower() and law.description and issubclass(law.block, Controller)
    assert ControllerParameters(type=law.name).law is law
    assert law.designs or not law.feedback, "a law with feedback needs a design"
    missing = [row.name for row in ControllerParameters.table() if not row.description]
    assert not missing
    if law.block.__module__.startswith("hysteresis_ros."):
        text = (ROOT / "docs" / "parameters.md").read_text(encoding="utf-8")
        rows = [f"`{name}.{row.name}`" for name, kind in law.groups.items() for row in kind.table()]
        assert [row for row in rows if row not in text] == [], "update the tables with `hysteresis parameters`"


@pytest.mark.slow
@laws
def test_its_parameters_come_back_from_yaml_as_they_were(law):
    parameters = example(law).validated()
    assert parameters.type == law.name and round_trip(parameters, ControllerParameters) == parameters


@pytest.mark.slow
@laws
def test_its_block_keeps_the_contract_of_controllers(law):
    block = controller_block(example(law), T)
    reference, measured = np.random.default_rng(1).normal(scale=STEP, size=(2, 60))
    first = block.simulate(reference, measured)
    assert np.all(np.isfinite(first)) and block.x[STARTED] == 1.0
    assert block.x[COMMAND] == block.x[APPLIED] == first[-1] and np.isfinite(block.x[ESTIMATED])
    kept = block.state
    ahead = block.simulate(reference, measured)
    block.state = kept
    pairs = zip(reference, measured, strict=True)
    assert [block.step(r, y) for r, y in pairs] == ahead.tolist(), "step and simulate differ, or state is missing"
    block.reset()
    assert block.simulate(reference, measured).tolist() == first.tolist()
    assert np.all(np.isfinite(block.simulate(np.full(20, 1e300), np.full(20, -1e300))))
    block.reset()
    assert (
        np.any(block.simulate(0.0 * reference, measured) != block.simulate(0.0 * reference, -measured)) == law.feedback
    )


INTERPRETED = """
import json, sys
import numpy as np
from hysteresis_ros.control.controller import ControllerParameters, controller_block
from hysteresis_ros.references.waveforms import Waveform, WaveformParameters
laws, shapes = json.load(sys.stdin)
found, (reference, measured) = {}, np.random.default_rng(4).normal(scale=2e-6, size=(2, 200))
for name, entries in laws.items():
    block = controller_block(ControllerParameters.from_mapping(entries), 1e-3)
    found[name] = block.simulate(reference, measured)
for name, entries in shapes.items():
    found[name] = Waveform(WaveformParameters.from_mapping(entries), 1e-3).simulate(np.zeros(700))
np.savez(sys.argv[1], **{f"{name} output": y for name, y in found.items()})
"""


@pytest.fixture(scope="module")
def compared_forms(tmp_path_factory):
    """Return outputs of all controllers and waveforms from machine code and from plain Python, by name."""
    folder = tmp_path_factory.mktemp("interpreted")
    made = {name: example(law).to_mapping() for name, law in LAWS.items()}
    waves = {name: waveform(shape, folder).to_mapping() for name, shape in WAVEFORMS.items()}
    given = json.dumps([made, waves])
    for name, environment in (("fast", {}), ("plain", {"NUMBA_DISABLE_JIT": "1"})):
        command = [sys.executable, "-c", INTERPRETED, folder / f"{name}.npz"]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), **environment}
        subprocess.run(command, input=given, text=True, check=True, env=environment, timeout=300)
    return np.load(folder / "fast.npz"), np.load(folder / "plain.npz")


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="kernels are interpreted already")
@pytest.mark.parametrize("name", [*LAWS, *WAVEFORMS])
def test_compiled_and_as_plain_python_it_is_the_same(name, compared_forms):
    fast, interpreted = (forms[f"{name} output"] for forms in compared_forms)
    assert fast == pytest.approx(interpreted, rel=0.0, abs=1e-12 * max(np.max(np.abs(fast)), 1e-9))


@pytest.mark.slow
@designs
def test_a_design_is_stable_with_margins_and_has_the_bandwidth_asked(name):
    for asked in (None, BANDWIDTH, 2.0 * BANDWIDTH):
        found = design_gains(plain(), name, T, asked)
        assert found.parameters.type == DESIGNS[name][0].name
        assert found.margins.stable and 1.0 <= found.margins.sensitivity_peak < 3.0
        assert found.margins.gain_margin > 4.0 and found.margins.delay_margin > 0.0
        assert asked is None or found.margins.bandwidth == pytest.approx(asked, rel=1e-3)
    law, parameters = DESIGNS[name][0], found.parameters
    rows = list(law.rows(parameters, T))
    assert rows and all(len(row) == 2 and all(isinstance(text, str) for text in row) for row in rows)
    assert all(isinstance(text, str) for text in law.doubts(parameters, T, False))


@pytest.mark.slow
@designs
def test_a_designed_loop_goes_to_the_reference_and_stays(name):
    _, places = Loop(designed(name)).run(STEP, 2000)
    assert places[-500:] == pytest.approx(np.full(500, STEP), rel=0.01)
    assert places.max() < 1.4 * STEP


@pytest.mark.slow
@designs
def test_new_gains_do_not_move_the_command(name):
    loop, other = Loop(designed(name)), designed(name, 1.5 * BANDWIDTH)
    commands, _ = loop.run(STEP, 1000)
    assert other != loop.controller.parameters
    loop.controller.retune(other)
    arm(loop.handover)
    after, places = loop.run(STEP, 1000)
    assert after[0] == commands[-1], "the command jumps"
    assert places == pytest.approx(np.full(1000, STEP), rel=0.02)


@laws
@pytest.mark.parametrize("before", LAWS)
def test_it_takes_over_from_every_controller_without_a_jump(law, before):
    loop = Loop(example(LAWS[before]))
    commands, _ = loop.run(STEP, 1000)
    loop.controller, lasting = successor(example(law), T, loop.controller, loop.history)
    arm(loop.handover, lasting=lasting)
    after, places = loop.run(STEP, 1000)
    assert after[0] == pytest.approx(commands[-1], rel=1e-12), "the command jumps"
    assert places == pytest.approx(np.full(1000, STEP), rel=0.02)


@laws
def test_what_it_declares_for_tuning_can_be_tuned(law):
    if law.tuning is None:
        return
    own = law.groups[law.name]
    rows = {row.name: row for row in own.table()}
    assert law.tuning.gains and all(rows[name].type is float for name in law.tuning.gains)
    begun = law.tuning.start(example(law), T)
    assert judge(*law.tuning.loop(begun, T), T).meets(law.tuning.required)


@pytest.mark.slow
@pytest.mark.parametrize("name", ROWS)
def test_its_entries_of_the_comparison_can_be_built(name):
    if LAWS[ROWS[name][0].name].tuning is not None:
        return  # tuned on simulated runs, as tested in test/comparison
    configuration, conditions = load_configuration("picma_stage"), Conditions()
    tasks = make_tasks(conditions, (0.0, 10e-6))
    made = candidates(known(configuration, 16), conditions, tasks, only={(name, "none")})
    assert [one.refused for one in made] == [""]
    assert made[0].motion_controller["type"] == ROWS[name][0].name


@pytest.mark.parametrize(("given", "near"), [("pdi", "pid"), ("offsetfree", "offset_free"), ("zzz", None)])
def test_an_unknown_controller_is_refused_with_the_nearest_name_and_what_there_is(given, near):
    with pytest.raises(ConfigurationError) as caught:
        design_gains(plain(), given, T)
    assert all(name in str(caught.value) for name in DESIGNS)
    assert (f"did you mean {near}?" in str(caught.value)) == (near is not None)
    with pytest.raises(ParameterError, match=r"type = 'pidd'.*one of.*did you mean pid\?"):
        ControllerParameters.from_mapping({"type": "pidd"})


def waveform(shape, folder, **changes) -> WaveformParameters:
    """Return an example of a waveform; the file of a file waveform is written into the folder."""
    values = {"type": shape.name, "amplitude": 5e-6, "frequency": 4.0, "offset": 1e-6}
    if shape.name == "file":
        path = pathlib.Path(folder) / "samples.npy"
        np.save(path, 1e-6 * np.random.default_rng(0).normal(size=250))
        values |= {"file.path": str(path), "file.sample_time": 1e-3}
    elif shape.example is not None:
        values |= {f"{shape.name}.{name}": value for name, value in shape.example.to_mapping().items()}
    values |= changes
    try:
        return WaveformParameters.from_mapping(values)
    except ParameterError as error:
        # a waveform that must end
        assert [problem.name for problem in error.problems] == ["cycles"]
        return WaveformParameters.from_mapping(values | {"cycles": 4})


def polarities(shape) -> tuple[dict, ...]:
    return ({"polarity": "unipolar"}, {"polarity": "symmetric"}) if shape.takes_polarity else ({},)


@shapes
def test_a_waveform_says_what_it_is_and_comes_back_from_yaml(shape, tmp_path):
    given = waveform(shape, tmp_path).validated()
    assert given.shape is shape and round_trip(given, WaveformParameters) == given
    assert shape.extent in {row.name for row in WaveformParameters.table()}
    assert shape.parameters is None or {item.name for item in fields(shape.parameters)}
    text = (ROOT / "docs" / "parameters.md").read_text(encoding="utf-8")
    rows = [row.name for row in shape.parameters.table()] if shape.parameters else []
    if rows and shape.parameters.__module__.startswith("hysteresis_ros."):
        assert [row for row in rows if f"`waveform.{shape.name}.{row}`" not in text] == []


@shapes
def test_it_stays_within_its_declared_extremes_and_reaches_them(shape, tmp_path):
    for polarity in polarities(shape):
        block = Waveform(waveform(shape, tmp_path, **polarity), T)
        y = block.simulate(np.zeros(4000))
        assert block.lowest - 1e-18 <= y.min() and y.max() <= block.highest + 1e-18
        assert np.ptp(y) >= 0.9 * (block.highest - block.lowest)


@shapes
def test_it_repeats_after_its_period_at_any_count_and_its_state_is_all_there_is(shape, tmp_path):
    block = Waveform(waveform(shape, tmp_path), T)
    y = block.simulate(np.zeros(4000))
    block.reset()
    assert [block.step(0.0) for _ in range(700)] == y[:700].tolist()
    kept = block.state
    assert block.simulate(np.zeros(700)).tolist() == y[700:1400].tolist()
    block.state = kept
    assert block.simulate(np.zeros(700)).tolist() == y[700:1400].tolist()
    if block.period is not None:
        assert y[block.period :].tolist() == y[: -block.period].tolist()
        block.state = np.array([block.period * 1e6])
        assert block.simulate(np.zeros(700)).tolist() == y[:700].tolist()


@shapes
def test_its_cycle_lasts_one_over_its_frequency_and_its_fundamental_is_as_declared(shape, tmp_path):
    if not shape.periodic:
        assert shape.fundamental is None
        return
    for polarity in polarities(shape):
        given = waveform(shape, tmp_path, **polarity)
        block = Waveform(given, T)
        cycle = round(1.0 / (given.frequency * T))
        spectrum = np.abs(np.fft.rfft(block.simulate(np.zeros(cycle)))) * 2.0 / cycle
        assert np.argmax(spectrum[1:]) == 0, "another frequency is stronger"
        if shape.fundamental is not None:
            half = 0.5 * (block.highest - block.lowest)
            assert spectrum[1] / half == pytest.approx(shape.fundamental(given), rel=0.05)


@shapes
def test_after_its_cycles_it_holds_its_end(shape, tmp_path):
    block = Waveform(waveform(shape, tmp_path, cycles=2), T)
    end = block.duration_samples
    if end:
        y = block.simulate(np.zeros(end + 500))
        assert np.all(y[end:] == y[end]) and block.lowest - 1e-18 <= y[end] <= block.highest + 1e-18
    else:
        assert shape.name == "hold" or shape.duration is not None


@shapes
def test_it_refuses_what_it_does_not_take(shape, tmp_path):
    if not shape.takes_phase:
        with pytest.raises(ParameterError, match="phase"):
            WaveformParameters.from_mapping({**waveform(shape, tmp_path).to_mapping(), "phase": 0.3})
    if shape.takes_frequency:
        with pytest.raises(ParameterError, match="frequency = 0.0: must be > 0 Hz"):
            WaveformParameters.from_mapping({**waveform(shape, tmp_path).to_mapping(), "frequency": 0.0})
        with pytest.raises(ParameterError, match=r"waveform\.frequency"):
            Waveform(waveform(shape, tmp_path, frequency=0.7 / T), T)


@shapes
def test_every_parameter_that_it_uses_is_a_keyword_of_its_class(shape, tmp_path):
    given = waveform(shape, tmp_path)
    used = set()
    for name, value in {"frequency": 2.5, "phase": 0.3, "polarity": "symmetric"}.items():
        try:
            changed = Waveform(WaveformParameters.from_mapping({**given.to_mapping(), name: value}), T)
        except ParameterError:
            continue  # it does not take this parameter
        if not np.array_equal(changed.p, Waveform(given, T).p):
            used.add(name)
    assert used <= {row.name for row in CLASSES[class_name(shape.name)].keywords.values()}


@shapes
def test_out_of_range_it_is_refused_by_the_parameter_that_says_how_far_it_goes(shape, tmp_path):
    given = waveform(shape, tmp_path)
    block = Waveform(given, T)
    low, high = min(block.lowest, 0.0) - 1e-9, block.highest + 1e-9
    assert np.isfinite(ReferenceGenerator(ReferenceParameters(minimum=low, maximum=high, waveform=given), T).step(0.0))
    with pytest.raises(ParameterError) as caught:
        ReferenceGenerator(ReferenceParameters(minimum=low, maximum=high - 2e-9, waveform=given), T)
    assert [problem.name for problem in caught.value.problems] == [f"waveform.{shape.extent}"]


def test_an_unknown_waveform_is_refused_with_the_nearest_name_and_what_there_is():
    with pytest.raises(ParameterError, match=r"type = 'sin'.*one of .*triangle; did you mean sine\?"):
        WaveformParameters.from_mapping({"type": "sin"})
