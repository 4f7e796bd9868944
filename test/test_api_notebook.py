# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Models are evaluated and used without a file; runs, models and designs are displayed in a cell of a notebook."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import hysteresis_ros as hr
from hysteresis_ros.errors import HysteresisError

VOLTAGE = 50.0 * (1.0 - np.cos(np.linspace(0.0, 15.0, 400)))


@pytest.fixture(scope="module")
def data():
    actuator = hr.models.PrandtlIshlinskii.example()
    return hr.Run(np.arange(VOLTAGE.size) * 1e-3, {"voltage": VOLTAGE, "measured": actuator.simulate(VOLTAGE)})


@pytest.fixture(scope="module")
def found(data):
    return hr.identify(data, linear="none", options={"play_count": 6, "zone_count": 0}, skip=0)


@pytest.mark.slow
def test_a_model_is_validated_without_a_file_between(found, data, tmp_path):
    found.save(tmp_path / "axis.yaml")
    direct, written = hr.validate(found, data), hr.validate(tmp_path / "axis.yaml", data)
    np.testing.assert_array_equal(direct.predicted, written.predicted)
    assert direct.figures == written.figures and direct.warnings == written.warnings
    assert isinstance(found, hr.Compared) and isinstance(direct, hr.Compared)
    assert hr.validate(hr.load(tmp_path / "axis.yaml"), data).figures == written.figures


@pytest.mark.slow
def test_a_score_is_what_validate_returns(found, data):
    scored = found.score(data)
    assert type(scored) is hr.Compared
    assert scored.figures["rmse_m"] == hr.validate(found, data).figures["rmse_m"]
    assert scored.score(data).figures == scored.figures and "<table>" in scored._repr_html_()


def test_a_model_is_saved_as_yaml_only(found, tmp_path):
    with pytest.raises(HysteresisError, match=r"x.json: .* must end in .yaml or .yml"):
        found.save(tmp_path / "x.json")


@pytest.mark.parametrize(
    "ask, message",
    [
        (lambda data: hr.identify((data.voltage, data.measured)), "source is of type tuple: must be one file, or a"),
        (lambda data: hr.identify(["a.csv", "b.csv"]), "source is of type list: must be one file"),
        (lambda data: hr.validate("kim2009", dict(data.signals)), "source is of type dict: must be one file"),
        (lambda data: hr.identify(data, columns={"V": "m"}), "columns is of type dict: must be Columns"),
        (lambda data: hr.identify(data, skip=2.5), "skip = 2.5: must be a whole number of samples"),
        (lambda data: hr.identify(data, options=["play_count=3"]), "options = .*: must be a dictionary, such as"),
        (lambda data: hr.identify(data, "prandtl_ishlinskii", options={"plays": 3}), "there is no option 'plays'"),
    ],
)
def test_arguments_of_an_identification_are_named(data, ask, message):
    with pytest.raises(HysteresisError, match=message):
        ask(data)


def test_a_model_is_no_run_to_draw(found):
    with pytest.raises(HysteresisError, match="source is of type Identified: must be a run or its file; hr.report"):
        hr.plot(found)


@pytest.mark.parametrize("evaluate", [hr.metrics, hr.report])
@pytest.mark.parametrize("source", [5, [5], None, np.zeros(3)])
def test_what_is_no_run_is_not_evaluated(evaluate, source):
    with pytest.raises(HysteresisError, match=f"source is of type {type(source).__name__}: must be a run, a result of"):
        evaluate(source)


def test_a_model_predicts_what_it_said_of_its_recording(found, data):
    np.testing.assert_array_equal(found.predict(data.voltage), found.predicted)
    np.testing.assert_array_equal(found.predict(data), found.predicted)
    np.testing.assert_array_equal(found.predict(list(data.voltage), 1e-3), found.predicted)
    # the play operators are rate-independent: the same path at another rate
    np.testing.assert_allclose(found.predict(data.voltage, 1e-2), found.predicted, rtol=0.0, atol=1e-15)
    checked = hr.validate(found, data)
    np.testing.assert_array_equal(checked.predict(data.voltage), checked.predicted)


@pytest.mark.parametrize("voltage", [[], [[1.0]], [0.0, np.nan], "much"])
def test_a_voltage_that_is_no_row_of_numbers_is_refused(found, voltage):
    with pytest.raises(HysteresisError, match="voltage"):
        found.predict(voltage)


def test_metrics_are_those_of_the_report(found):
    run = hr.simulate("kim2009", duration=0.02)
    assert hr.metrics(run) == hr.report(run) and hr.metrics(found) is found.figures
    assert set(hr.metrics({"one": run, "other": run})) == {"one", "other"}


def shown():
    """Return the objects that a notebook displays."""
    run = hr.simulate("kim2009", duration=0.02)
    return {"run": run, "signals": run.between(0.0, 0.01), "design": hr.design("kim2009", "offset_free")}


@pytest.mark.slow
def test_what_a_notebook_shows_fits_a_cell(found, data):
    pytest.importorskip("matplotlib", reason="cells have plots")
    objects = {**shown(), "found": found, "checked": hr.validate(found, data), "data": data}
    for name, item in objects.items():
        assert len(repr(item)) < 600 and "\n" not in repr(item), name
        text = item._repr_html_()
        assert text.startswith("<div>") and text.endswith("</div>") and len(text) < 300_000, name
        assert ("data:image/png;base64," in text) == (name != "design"), name
    assert "prandtl_ishlinskii" in repr(found) and "RMS error" in repr(found)
    assert "bandwidth" in repr(objects["design"])


@pytest.mark.slow
def test_without_matplotlib_a_cell_has_no_plot(found, monkeypatch):
    for name in ("matplotlib.figure", "matplotlib.backends.backend_agg", "matplotlib"):
        monkeypatch.setitem(sys.modules, name, None)
    for item in (shown()["run"], found):
        text = item._repr_html_()
        assert "<table>" in text and "<img" not in text


@pytest.mark.slow
def test_exchange_and_plots_are_not_loaded_before_they_are_used():
    code = "import hysteresis_ros as hr, sys; hr.simulate; print('loaded', *sys.modules)"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"control", "matplotlib", "pandas", "hysteresis_ros.exchange"} & set(answer.stdout.split())
