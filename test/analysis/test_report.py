# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Plots and report: complete, self-contained, and with a message if a library is missing."""

import builtins
import html
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hysteresis_ros.analysis.plots import chart_figure, envelope, png
from hysteresis_ros.analysis.report import charts_of, render_report, write_report
from hysteresis_ros.analysis.run_charts import judged, traces_chart, voltage_chart
from hysteresis_ros.errors import HysteresisError, RecordingError
from hysteresis_ros.recordings import Recording

CONFIGURATION = """
/**/plant_simulator:
  ros__parameters:
    limits: {minimum: -30.0, maximum: 120.0}  # <assumed> & more
"""


@pytest.fixture
def recording():
    time = np.arange(4000) / 2000.0
    reference = 5e-6 * (1 - np.cos(2 * np.pi * 2 * time))
    return Recording.from_columns(
        {
            "time": time,
            "reference": reference,
            "displacement": 0.98 * reference,
            "voltage": reference / 0.1e-6,
            "measured": reference,
            "estimated": np.full(time.size, np.nan),
        },
        {"configuration": CONFIGURATION, "notes": ["3 samples < missing"], "namespace": "/left"},
    )


@pytest.mark.slow
def test_the_report_holds_everything_in_itself(recording):
    text = render_report(recording, "my <bag>")
    names = [chart.name for chart in charts_of(judged(recording))]
    assert names == ["traces", "error", "loops", "trace", "periods", "spectrum", "histogram", "voltage"]
    assert text.count('src="data:image/png;base64,') == len(names)
    own = re.sub(r"<script.*?</script>", "", text, flags=re.S)
    addresses = re.findall(r'(?:src|href)="([^"]*)"', own)
    assert all(address.startswith("data:") for address in addresses)
    assert not any(word in own for word in ("@import", "url(", "<link", "http"))
    assert html.escape(CONFIGURATION.strip()) in text
    assert "my &lt;bag&gt;" in text and "3 samples &lt; missing" in text and "/left" in text
    assert "RMS error" in text and "Loop width" in text


def test_every_axis_says_quantity_and_unit(recording):
    for chart in charts_of(judged(recording)):
        for label in (chart.across, chart.up):
            assert re.search(r"\[(s|ms|V|µm|nm|%|Hz|nm/√Hz|% of its range)\]$", label), label


def test_voltage_is_drawn_with_its_limits(recording):
    chart = voltage_chart(judged(recording))
    assert chart.levels == (-30.0, 120.0)
    (axis,) = chart_figure(chart).axes
    assert [line.get_ydata()[0] for line in axis.lines[1:]] == [-30.0, 120.0]


def test_signals_without_values_are_not_drawn(recording):
    (axis,) = chart_figure(traces_chart(judged(recording))).axes
    assert [line.get_label() for line in axis.lines] == ["displacement", "reference"]


@pytest.mark.slow
def test_charts_of_a_recording_without_voltage(recording):
    bare = Recording.from_columns({name: recording[name] for name in ("time", "reference", "displacement")})
    names = [chart.name for chart in charts_of(judged(bare))]
    assert "voltage" not in names and "loops" in names
    for chart in charts_of(judged(bare)):
        assert png(chart_figure(chart)).startswith(b"\x89PNG")


@given(size=st.integers(0, 5000), points=st.integers(4, 400), seed=st.integers(0, 10))
def test_thinning_keeps_every_peak(size, points, seed):
    random = np.random.default_rng(seed)
    time, values = np.arange(size, dtype=float), random.normal(size=size)
    values[random.random(size) < 0.1] = np.nan
    thin_time, thin = envelope(time, values, points)
    assert thin_time.size == thin.size <= max(3 * points, points + 2)
    assert np.all(np.diff(thin_time) >= 0)
    if np.any(np.isfinite(values)):
        assert np.nanmax(thin) == np.nanmax(values) and np.nanmin(thin) == np.nanmin(values)
    there = np.isfinite(thin)
    assert np.array_equal(values[thin_time[there].astype(int)], thin[there])


@pytest.mark.slow
@pytest.mark.parametrize(("library", "label"), [("matplotlib", "Matplotlib"), ("jinja2", "Jinja2")])
def test_a_missing_library_is_named_with_its_remedy(recording, monkeypatch, library, label):
    original = builtins.__import__

    def importing(name, *arguments, **keywords):
        if name.split(".")[0] == library:
            raise ImportError(name)
        return original(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", importing)
    with pytest.raises(HysteresisError, match=rf"{label} is not installed.*hysteresis_ros\[report\]"):
        render_report(recording, "run")


def test_a_report_that_cannot_be_written_says_so(recording, tmp_path):
    with pytest.raises(RecordingError, match="cannot be written"):
        write_report(recording, tmp_path / "absent" / "report.html", "run")
