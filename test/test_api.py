# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``import hysteresis_ros as hr``: the names for users of Python, and their agreement with the package."""

from __future__ import annotations

import copy
import doctest
import inspect
import pathlib
import pickle
import re
import subprocess
import sys

import numpy as np
import pytest

import hysteresis_ros as hr
from hysteresis_ros import api, designing
from hysteresis_ros import api as results
from hysteresis_ros.configuration import Configuration, load_configuration
from hysteresis_ros.control.controller import LAWS
from hysteresis_ros.errors import ConfigurationError, HysteresisError, RecordingError
from hysteresis_ros.laboratory import studies, swept
from hysteresis_ros.laboratory.comparison.compare import Comparison
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate as simulate_axis
from hysteresis_ros.models.hysteresis import MODELS
from hysteresis_ros.models.inverses import NAMES as INVERSES
from hysteresis_ros.references.waveforms import WAVEFORMS
from hysteresis_ros.registry import KeywordError, class_name

ROOT = pathlib.Path(__file__).resolve().parents[1]
#: Modules with a long import time.
HEAVY = {"numpy", "scipy", "numba", "matplotlib", "yaml", "pandas", "rosbags", "rclpy", "hysteresis_ros.api"}
INVOKE = "from click.testing import CliRunner; from hysteresis_ros.cli.main import main;"
VOLTAGE = 50.0 * (1.0 - np.cos(np.linspace(0.0, 15.0, 400)))
FACTORIES = {
    "models": [class_name(name) for name in MODELS],
    "controllers": [class_name(name) for name in LAWS],
    "references": [class_name(name) for name in WAVEFORMS],
    "inverses": ["Gain", *(class_name(name) for name in INVERSES if name != "none")],
}
CLASSES = [(factory, name) for factory, names in FACTORIES.items() for name in names]


@pytest.mark.parametrize(
    "code",
    [
        "import hysteresis_ros as hr; dir(hr), hr.__version__",
        f"{INVOKE} CliRunner().invoke(main, ['--help'])",
        f"{INVOKE} CliRunner().invoke(main, ['simulat'])",
    ],
    ids=["import", "help", "mistyped"],
)
def test_nothing_heavy_is_imported_before_it_is_used(code):
    answer = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys; print('\\nloaded', *sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert not HEAVY & set(answer.stdout.rsplit("loaded", 1)[1].split())


def test_every_public_name_is_there_and_others_are_answered_with_the_nearest():
    assert set(hr.__all__) <= set(dir(hr))
    assert all(getattr(hr, name) is not None for name in hr.__all__)
    with pytest.raises(AttributeError, match="did you mean simulate"):
        _ = hr.simulat
    for factory, names in FACTORIES.items():
        assert set(names) <= set(dir(getattr(hr, factory)))
    with pytest.raises(AttributeError, match="did you mean BoucWen"):
        _ = hr.models.BoucWn
    with pytest.raises(AttributeError, match="did you mean Pid"):
        _ = hr.controllers.Pidd


@pytest.mark.parametrize("name", MODELS)
def test_every_model_takes_keywords_and_is_its_block_bit_for_bit(name):
    declared = MODELS[name]
    model_class = getattr(hr.models, class_name(name))
    keywords = {key.replace(".", "__"): value for key, value in declared.example.to_mapping().items()}
    arrays = {key: np.array(value) if isinstance(value, tuple) else value for key, value in keywords.items()}
    model = model_class(**arrays, sample_time=1e-4)
    expected = declared.block(declared.example, 1e-4).simulate(VOLTAGE)
    np.testing.assert_array_equal(model.simulate(list(VOLTAGE)), expected)
    np.testing.assert_array_equal(model_class.example(1e-4).simulate(VOLTAGE), expected)
    assert pickle.loads(pickle.dumps(model)).p.tolist() == model.p.tolist()


FITTING = [(name, kind) for name, model in MODELS.items() for kind in model.inverses if kind != "duhem"]


@pytest.mark.parametrize("name, kind", FITTING)
def test_every_inverse_finds_the_voltage_of_every_model_it_fits(name, kind):
    model = getattr(hr.models, class_name(name)).example()
    wanted = model.simulate(VOLTAGE)
    inverse_class = getattr(hr.inverses, "Gain" if kind == "none" else class_name(kind))
    voltage = inverse_class(model, minimum=0.0, maximum=100.0).simulate(wanted)
    assert voltage.shape == wanted.shape and voltage.min() >= 0.0 and voltage.max() <= 100.0
    if kind not in ("none", "picard_steps"):
        model.reset()
        np.testing.assert_allclose(model.simulate(voltage), wanted, rtol=0.0, atol=1e-9 * np.ptp(wanted))


def test_an_inverse_that_does_not_fit_is_refused():
    with pytest.raises(HysteresisError, match="bouc_wen has no closed-form inverse; use general"):
        hr.inverses.Exact(hr.models.BoucWen.example(), minimum=0.0, maximum=100.0)
    with pytest.raises(KeywordError, match="hr.models"):
        hr.inverses.Exact(3.0, minimum=0.0, maximum=100.0)


@pytest.mark.parametrize("kind", LAWS)
def test_every_controller_takes_keywords_and_is_its_block_bit_for_bit(kind):
    node = single_axis(load_configuration("kim2009").override("motion_controller", type=kind, pid__Ki=10.0))
    values = dict(node.motion_controller.to_mapping())
    controller_class = getattr(hr.controllers, class_name(kind))
    taken = {row.name for row in controller_class.keywords.values()}
    keywords = {name.replace(".", "__"): value for name, value in values.items() if name in taken}
    controller = controller_class(**keywords, sample_time=1.0 / 3000.0)
    reference, measured = 1e-6 * np.sin(np.linspace(0.0, 9.0, 200)), 0.9e-6 * np.sin(np.linspace(-0.1, 8.9, 200))
    expected = LAWS[kind].block(controller.parameters, 1.0 / 3000.0).simulate(reference, measured)
    assert controller.parameters.type == kind
    np.testing.assert_array_equal(controller.simulate(list(reference), list(measured)), expected)
    with pytest.raises(HysteresisError, match="200 samples, measured 199"):
        controller.simulate(reference, measured[1:])


def test_short_names_are_short_where_they_are_clear():
    rows = {keyword: row.name for keyword, row in hr.controllers.Pid.keywords.items()}
    assert rows["Kp"] == "pid.Kp" and rows["A"] == "model.dynamics.A"
    assert rows["dynamics__sample_time"] == "model.dynamics.sample_time"
    assert rows["feedforward__type"] == "feedforward.type"
    assert not any(name.startswith(("kalman", "sliding_mode")) for name in rows.values()), "of other controllers"
    assert hr.controllers.Pid(Kp=0.5, pid__Ki=10.0).parameters.pid.Ki == 10.0


def test_a_chirp_begins_at_its_frequency():
    given = dict(amplitude=1e-6, final_frequency=100.0, duration=2.0, sample_time=1e-4)
    slow, fast = (hr.references.Chirp(frequency=f, **given).samples(10) for f in (1.0, 50.0))
    np.testing.assert_allclose(fast[1:] / slow[1:], 50.0, rtol=0.1)


def test_waveforms_give_their_samples():
    sine = hr.references.Sine(amplitude=1e-6, frequency=10.0, cycles=2, sample_time=1e-3)
    np.testing.assert_allclose(sine.samples(), 1e-6 * np.sin(2 * np.pi * 0.01 * np.arange(200)), atol=1e-21)
    assert hr.references.Steps(values=[1e-6, 2e-6], times=[0.0, 0.1]).samples(150)[-1] == 2e-6
    with pytest.raises(HysteresisError, match="no end"):
        hr.references.Sine(amplitude=1e-6).samples()
    with pytest.raises(HysteresisError, match="0 or more"):
        sine.samples(-1)


@pytest.mark.parametrize(
    "make, expected",
    [
        (lambda: hr.models.BoucWen(d_e=1e-7, alfa=1e-8), "no parameter alfa; did you mean alpha?"),
        (lambda: hr.models.BoucWen(d_e=1e-7), "alpha = None: missing"),
        (lambda: hr.models.BoucWen(d_e="much", alpha=0.0, beta=0.0, gamma=0.0), "d_e = 'much': wrong type"),
        (lambda: hr.models.BoucWen(hr.models.BoucWen.example().parameters, alpha=1.0), "not both: leave out alpha"),
        (lambda: hr.models.BoucWen.example().simulate(np.zeros((2, 2))), r"voltage has shape \(2, 2\)"),
        (lambda: hr.models.BoucWen.example().simulate(["a"]), "voltage: must be an array of real numbers"),
        (lambda: hr.controllers.Pid(Kpp=1.0), "no parameter Kpp; did you mean Kp"),
    ],
)
def test_wrong_arguments_are_named(make, expected):
    with pytest.raises(HysteresisError, match=expected):
        make()


@pytest.mark.parametrize("factory, name", CLASSES)
def test_every_keyword_is_in_the_signature_and_described(factory, name):
    made = getattr(getattr(hr, factory), name)
    text = inspect.getdoc(made)
    given = [item for item in inspect.signature(made).parameters.values() if item.name != "parameters"]
    assert set(made.keywords) == {item.name for item in given} - {"sample_time", "model"}
    for item in given:
        assert re.search(rf"^{item.name} : \S", text, re.MULTILINE), item.name


@pytest.fixture(scope="module")
def run():
    return hr.simulate("kim2009", duration=0.02)


def test_a_simulation_is_that_of_the_package(run):
    expected = simulate_axis(single_axis(load_configuration("kim2009")), duration=0.02)
    assert run.signals.keys() == expected.signals.keys()
    for name, values in expected.signals.items():
        np.testing.assert_array_equal(run[name], values)
    setpoints = np.linspace(0.0, 2e-6, 60)
    np.testing.assert_array_equal(hr.simulate("kim2009", setpoints=setpoints).setpoint, setpoints)
    np.testing.assert_array_equal(hr.simulate(run, duration=0.02).displacement, run.displacement)


def test_what_an_axis_can_hardly_follow_comes_as_a_warning():
    wide = hr.load("kim2009").override("reference_generator", maximum=5e-5)
    with pytest.warns(UserWarning, match="setpoints beyond it saturate"):
        hr.simulate(wide, duration=0.01)


def test_a_run_has_its_signals_by_name(run):
    assert run.displacement is run["displacement"] and "voltage" in dir(run) and run.units["voltage"] == "V"
    assert "60 samples" in repr(run) and "voltage [V]" in repr(run)
    with pytest.raises(AttributeError, match="the signals are setpoint, reference"):
        _ = run.voltag
    for same in (copy.deepcopy(run), pickle.loads(pickle.dumps(run))):
        np.testing.assert_array_equal(same.voltage, run.voltage)


@pytest.mark.slow
def test_a_run_as_dataframe(run):
    pytest.importorskip("pandas", reason="pandas is optional")
    table = run.to_dataframe()
    np.testing.assert_array_equal(table["displacement"].to_numpy(), run.displacement)
    np.testing.assert_array_equal(table.index.to_numpy(), run.time)
    assert table.attrs["units"]["time"] == "s"


def test_without_pandas_the_message_says_how_to_install_it(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(HysteresisError, match=r"pip install .*notebook"):
        run.to_dataframe()


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".mcap"])
def test_a_run_is_saved_and_loaded(run, tmp_path, suffix):
    run.save(tmp_path / f"run{suffix}")
    again = hr.load(tmp_path / f"run{suffix}")
    assert isinstance(again, hr.Run)
    np.testing.assert_array_equal(again.displacement, run.displacement)
    assert hr.report(again)["rms_error_m"] == pytest.approx(hr.report(run)["rms_error_m"])


def test_load_tells_configurations_from_recordings_and_refuses_the_rest(tmp_path):
    assert isinstance(hr.load("kim2009"), Configuration)
    (tmp_path / "notes.txt").write_text("words")
    (tmp_path / "empty").mkdir()
    for name, error, message in [
        ("notes.txt", ConfigurationError, "neither a configuration nor a recording"),
        ("missing.txt", ConfigurationError, "no such file"),
        ("missing.yaml", ConfigurationError, "no such file"),
        ("missing.npz", RecordingError, "no such file"),
        ("empty", RecordingError, "not a bag"),
    ]:
        with pytest.raises(error, match=f"{name}.*{message}"):
            hr.load(tmp_path / name)
    with pytest.raises(ConfigurationError, match="kim2009"):
        hr.load("kim2008")


def test_a_recording_without_configuration_cannot_be_simulated():
    with pytest.raises(ConfigurationError, match="has no configuration of its axis"):
        hr.simulate(hr.Run([0.0, 1.0], {"voltage": [0.0, 1.0]}), duration=0.01)


@pytest.mark.slow
def test_pages_of_all_kinds_are_written(run, tmp_path):
    pytest.importorskip("matplotlib", reason="pages have plots")
    actuator = hr.models.PrandtlIshlinskii.example()
    data = hr.Run(np.arange(VOLTAGE.size) * 1e-3, {"voltage": VOLTAGE, "measured": actuator.simulate(VOLTAGE)})
    found = hr.identify(data, linear="none", options={"play_count": 6, "zone_count": 0}, skip=0)
    found.save(tmp_path / "axis.yaml")
    checked = hr.validate(tmp_path / "axis.yaml", data)
    assert checked.figures["rmse_m"] == pytest.approx(found.figures["rmse_m"], rel=0.1)
    for name, source in {"run": run, "identified": found, "validated": checked}.items():
        figures = hr.report(source, tmp_path / f"{name}.html")
        assert figures and "</html>" in (tmp_path / f"{name}.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_design_is_a_configuration(tmp_path):
    design = hr.design("kim2009", "offset_free", bandwidth=200.0)
    assert "bandwidth reached" in str(design) and design.margins.stable
    design.save(tmp_path / "designed.yaml")
    from_file = hr.simulate(tmp_path / "designed.yaml", duration=0.01)
    np.testing.assert_array_equal(hr.simulate(design, duration=0.01).voltage, from_file.voltage)


@pytest.mark.slow
@pytest.mark.parametrize("module, examples", [(api, 8), (designing, 9), (studies, 2), (results, 6), (swept, 4)])
def test_examples_in_docstrings_are_true(module, examples):
    found = doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert found.attempted >= examples and found.failed == 0


@pytest.mark.slow
def test_a_response_is_measured_saved_and_borne_by_a_design(tmp_path):
    found = hr.frequency_response("kim2009", hr.Experiment(low=20.0, high=800.0, period=0.25, realisations=2))
    measured = found.plant.response
    # the controller's model equals the plant without hysteresis: they differ by at most the slope of the branches
    near = measured.frequency < 200.0
    assert np.max(np.abs(np.abs(measured.response[near, 0, 0] / found.model[near]) - 1.0)) < 0.2
    assert "signal-to-noise" in str(found)
    found.save(tmp_path / "response.npz")
    design = hr.design("kim2009", "offset_free", response=tmp_path / "response.npz")
    assert any(line.startswith("measured") for line in design.lines)
    assert str(hr.design("kim2009", "offset_free", response=found)) == str(design)
    with pytest.raises(HysteresisError, match="excitation of a recording cannot be changed"):
        hr.frequency_response(hr.simulate("kim2009", duration=0.01), amplitude=0.1)


@pytest.mark.slow
def test_a_learning_is_a_configuration():
    scan = hr.load("kim2009").override(
        "reference_generator",
        waveform__type="sine",
        waveform__amplitude=1e-6,
        waveform__offset=6e-6,
        waveform__frequency=10.0,
    )
    learned = hr.design_learning(hr.design(scan, "offset_free", bandwidth=200.0), "inversion")
    assert learned.parameters.type == "inversion" and "0.1 s, 300 samples" in str(learned)
    errors = hr.simulate(learned, duration=1.0)
    first, last = errors.between(0.1, 0.2), errors.between(0.9, 1.0)
    rms = [np.sqrt(np.mean((part.reference - part.displacement) ** 2)) for part in (first, last)]
    assert rms[1] < 0.1 * rms[0]


def test_a_sweep_says_how_many_meet_a_bound(tmp_path):
    vary, bounds = ["plant_simulator.gain=0.95,1,1.05"], ["rms_error_m=1m"]
    found = hr.sweep("kim2009", vary, tmp_path / "F.npz", bounds=bounds, duration=0.02, workers=1)
    assert found.met.tolist() == [True] * 3 and "rms_error_m" in str(found)
    again = hr.sweep("kim2009", vary, tmp_path / "F.npz", bounds=bounds, duration=0.02, workers=1)
    np.testing.assert_array_equal(again.results.metrics["rms_error_m"], found.results.metrics["rms_error_m"])
    with pytest.raises(HysteresisError, match="sensor.nois"):
        hr.sweep("kim2009", ["plant_simulator.sensor.nois=1nm,2nm"], duration=0.02)


@pytest.mark.slow
def test_faults_of_a_run_are_not_in_what_is_designed_from_it():
    run = hr.simulate("kim2009", duration=0.01, faults=hr.Fault("stale", 0.002, 0.002))
    again = hr.simulate(hr.design(run, "offset_free", bandwidth=100.0), duration=0.01)
    assert "stale:0.002" in run.configuration and "stale:0.002" not in again.configuration


@pytest.mark.slow
def test_changes_of_a_configuration_are_in_what_is_designed_from_it():
    changed = hr.load("kim2009").override("plant_simulator", sensor__noise=7e-9)
    design = hr.design(changed, "offset_free", bandwidth=200.0)
    assert single_axis(api.configuration_of(design)).plant_simulator.sensor.noise == 7e-9


def test_a_comparison_is_that_of_the_package(monkeypatch, tmp_path):
    """The candidates themselves are tested with the comparison."""
    given = {}

    def compared(configuration, conditions, **options):
        given.update(options, configuration=configuration, conditions=conditions)
        return Comparison(conditions, None, None, configuration)

    monkeypatch.setattr(studies, "compare_candidates", compared)
    found = hr.compare("kim2009", only={("PID", "none")}, draws=3, workers=1)
    assert given["conditions"].draws == 3 and given["only"] == {("PID", "none")} and given["workers"] == 1
    assert isinstance(found, hr.Ranking) and found.conditions is given["conditions"] and "Ranked by" in str(found)
    for name, message in [("best.yaml", "no combination has a rank"), ("best.txt", "must end in .yaml")]:
        with pytest.raises(ConfigurationError, match=message):
            found.save(tmp_path / name)


@pytest.mark.parametrize(
    "ask, expected",
    [
        (lambda: hr.compare("kim2009", drawn=1), "unknown condition drawn; did you mean draws?"),
        (lambda: hr.compare("kim2009", only={("PIT", "none")}), "no controller 'PIT'.*did you mean PID.*offset-free"),
        (
            lambda: hr.compare("kim2009", only={("PID", "exact invers")}),
            "no compensator 'exact invers'.*did you mean exact inverse.*there are: none",
        ),
        (lambda: hr.reproduce("kim2010"), "no paper 'kim2010'; .* did you mean kim2009?"),
        (
            lambda: hr.design_learning("kim2009", "inverse"),
            "learning = 'inverse': must be one of .*did you mean inversion?",
        ),
        (lambda: hr.plot(hr.Run([0.0, 1.0], {"displacement": [0.0, 0.0]}), "trace"), "did you mean traces?"),
    ],
)
def test_what_is_not_there_is_answered_with_the_nearest(ask, expected):
    with pytest.raises(HysteresisError, match=expected):
        ask()


@pytest.mark.parametrize("kind", ["traces", "error", "voltage"])
def test_a_run_is_drawn(run, tmp_path, kind):
    pytest.importorskip("matplotlib", reason="plots need it")
    figure = hr.plot(run, kind)
    assert figure.axes[0].lines
    with pytest.raises(HysteresisError, match="has the plots traces"):
        hr.plot(hr.Run([0.0, 1.0], {"reference": [0.0, 0.0], "displacement": [0.0, 0.0]}), "loops")
    stage = hr.simulate("xy_scanner", duration=0.005)
    with pytest.raises(hr.HysteresisError, match="a plot shows one: give namespace='x' or namespace='y'"):
        hr.plot(stage, kind)
    assert hr.plot(stage, namespace="y") is not None


@pytest.mark.slow
def test_every_line_of_the_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    snippets = re.findall(r"^```python\n(.*?)^```", (ROOT / "docs/api.md").read_text(encoding="utf-8"), re.M | re.S)
    names: dict = {}
    for snippet in snippets:
        exec(compile(snippet, "docs/api.md", "exec"), names)
    assert len(snippets) >= 8 and names["figures"]["rms_error_m"] > 0.0
    assert names["found"].figures["rmse_percent_of_stroke"] < 5.0


#: Checks of numpydoc for all public names: summary, every parameter with type and text, return value.
ASKED = {"GL08", "SS01", "SS03", "PR01", "PR02", "PR03", "PR04", "PR06", "PR07", "RT01", "RT03"}
PUBLIC = [
    *(f"{getattr(hr, name).__module__}.{name}" for name in hr.__all__ if name not in FACTORIES),
    *(f"hysteresis_ros.api.Run.{name}" for name in ("of", "between", "save", "to_dataframe")),
    *(f"hysteresis_ros.api.{name}.save" for name in ("Design", "DesignedLearning", "Response")),
    "hysteresis_ros.laboratory.comparison.table.Ranking.save",
    *(
        f"hysteresis_ros.{getattr(hr, factory).__name__.removeprefix('hysteresis_ros.')}.{name}"
        for factory, name in CLASSES
    ),
]


@pytest.mark.parametrize("path", PUBLIC)
def test_every_argument_is_documented(path):
    validate = pytest.importorskip("numpydoc.validate", reason="the check of docstrings is not installed").validate
    assert [text for code, text in validate(path)["errors"] if code in ASKED] == []
