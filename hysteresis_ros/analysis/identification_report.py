# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The report page of an identification or validation: measurement, prediction and residual."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.analysis.page import render_page, write_page
from hysteresis_ros.analysis.plots import add_legend, data_uri, envelope, length_unit, new_figure
from hysteresis_ros.analysis.tables import shown_row
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.parameter_file import assumptions
from hysteresis_ros.identification.prediction import InverseValidation
from hysteresis_ros.identification.validation import CorrelationTest, Validation
from hysteresis_ros.identification.workflow import Compared, Identified
from hysteresis_ros.units import bare_name, figure_name, readable

_MEASURED, _MODEL, _RESIDUAL, _LIMIT = "#1f3b73", "#d1495b", "#2a9d8f", "#444444"
#: Largest number of samples of a drawn loop.
LOOP_POINTS = 20000
#: Rows of the table: name, label, unit, factor from SI.
ROWS = (
    ("rmse_m", "RMS error of the prediction", "µm", 1e6),
    ("rmse_percent_of_stroke", "RMS error", "% of stroke", 1.0),
    ("maximum_error_m", "Largest error", "µm", 1e6),
    ("fit_percent", "Fit", "%", 1.0),
    ("fpe_m2", "Final prediction error", "µm²", 1e12),
    ("stroke_m", "Stroke", "µm", 1e6),
    ("offset_m", "Constant removed", "µm", 1e6),
    ("inverse_rmse_v", "RMS error of the voltage from the inverse", "V", 1.0),
    ("inverse_rmse_percent", "RMS error of that voltage", "% of its range", 1.0),
    ("samples", "Samples compared", "", 1),
    ("skipped", "Samples left out at the start", "", 1),
    ("lag_s", "Lag", "ms", 1e3),
    ("delay_s", "Delay", "ms", 1e3),
    ("creep_rate_per_decade", "Creep per decade", "% of the step", 100.0),
)


def write_identification_report(path, found: Identified) -> None:
    """Write the page of an identification as one self-contained HTML file."""
    plots, result = _plots(found), found.identification
    if result.trajectory is not None:
        plots.append(
            ("Parameters of the best run, each divided by its final value", trajectory_figure(*result.trajectory))
        )
    title = f"{result.model} identified from {found.data.source or 'a recording'}"
    _write(path, title, found, plots, assumptions(result))


def write_validation_report(path, found: Compared) -> None:
    """Write the page of a validation, like :func:`write_identification_report`."""
    title = f"{found.plant.hysteresis.type} validated on {found.data.source or 'a recording'}"
    _write(path, title, found, _plots(found), ())


def _write(path, title: str, found: Compared, plots, stated) -> None:
    rows, data, errors = [], found.data, found.validation
    units = found.plant.units
    for name, label, unit, factor in ROWS:
        value = found.figures.get(figure_name(name, units))
        if value is not None:
            unit, factor = _own_unit(unit, factor, units)
            rows.append(shown_row(label.replace("voltage", _input_name(data)), value, unit, factor))
    html = render_page(
        "identification.html.j2",
        title=title,
        summary=f"{len(data)} samples at {1.0 / data.sample_time:.6g} Hz; RMS error {readable(errors.rmse, units[1])}, "
        f"{errors.rmse_percent_of_stroke:.3g} % of stroke, fit {errors.fit_percent:.4g} %",
        recording=found.recording.lines if found.recording is not None else (),
        warnings=list(found.warnings),
        rows=rows,
        plots=[dict(caption=caption, source=data_uri(figure)) for caption, figure in plots],
        assumptions=stated,
    )
    write_page(path, html)


def _own_unit(unit: str, factor: float, units: tuple[str, str]) -> tuple[str, float]:
    """Return unit and factor of a row for a recording in ``units``: µm and V are for lengths and voltages only."""
    if unit.startswith("µm") and units[1] != "m":
        return units[1] + unit.removeprefix("µm"), 1.0
    return (units[0], 1.0) if unit == "V" else (unit, factor)


def _output_axis(data: IdentificationData, largest: float | None = None) -> tuple[str, str, float]:
    """Return name, unit and factor for the axis of an output; a length below ``largest`` may be drawn in nm."""
    if data.output_unit != "m":
        return bare_name(data.output_name), data.output_unit, 1.0
    return ("displacement", *(("µm", 1e6) if largest is None else length_unit(largest)))


def _input_name(data: IdentificationData) -> str:
    return "voltage" if data.input_unit == "V" else bare_name(data.input_name)


def _plots(found: Compared) -> list:
    data, predicted, errors = found.data, found.predicted, found.validation
    plots = [
        (f"Measured and predicted {_output_axis(data)[0]}", traces_figure(data, predicted, errors)),
        ("Residual (measured − predicted)", residual_figure(data, errors)),
        (f"Loops, and the residual over the {_input_name(data)}", loops_figure(data, predicted, errors)),
        (
            f"Correlations of the residual, with bounds of {100 * errors.autocorrelation.confidence:g} % for each lag",
            correlations_figure(errors),
        ),
    ]
    if found.inverse is not None:
        name = _input_name(data)
        caption = f"{name.capitalize()} that the inverse computes from the {_output_axis(data)[0]} − applied {name}"
        plots.append((caption, inverse_figure(data, found.inverse)))
    return plots


def traces_figure(data: IdentificationData, predicted, found: Validation):
    """Return the figure of measured and predicted displacement over time [µm, s]."""
    figure, (axis,) = new_figure(3.4)
    name, unit, factor = _output_axis(data)
    for label, values, colour, width in (
        ("measured", data.output, _MEASURED, 2.2),
        ("predicted", np.asarray(predicted) + found.offset, _MODEL, 1.0),
    ):
        axis.plot(*envelope(data.time, values * factor), color=colour, linewidth=width, label=label)
    if found.skipped:
        axis.axvspan(data.time[0], data.time[found.skipped], color="#eeeeee", zorder=0, label="not compared")
    axis.set(xlabel="time [s]", ylabel=f"{name} [{unit}]")
    add_legend(axis)
    return figure


def residual_figure(data: IdentificationData, found: Validation):
    """Return the figure of the residual over time [µm or nm, s]."""
    figure, (axis,) = new_figure(2.6)
    _, unit, factor = _output_axis(data, float(np.max(np.abs(found.residual))))
    axis.axhline(0.0, color=_LIMIT, linewidth=0.8)
    axis.plot(*envelope(data.time[found.skipped :], found.residual * factor), color=_RESIDUAL, linewidth=0.9)
    axis.set(xlabel="time [s]", ylabel=f"residual [{unit}]")
    return figure


def loops_figure(data: IdentificationData, predicted, found: Validation):
    """Return the figure of the loops, and of the residual, over the voltage [µm, V]."""
    figure, (loops, left) = new_figure(4.2, 2)
    first, stride = found.skipped, max(1, found.samples // LOOP_POINTS)
    u = data.input[first::stride]
    name, unit, factor = _output_axis(data)
    loops.plot(u, data.output[first::stride] * factor, color=_MEASURED, linewidth=2.0, label="measured")
    loops.plot(u, (predicted[first::stride] + found.offset) * factor, color=_MODEL, linewidth=0.8, label="predicted")
    over = f"{bare_name(data.input_name)} [{data.input_unit}]"
    loops.set(xlabel=over, ylabel=f"{name} [{unit}]")
    _, unit, factor = _output_axis(data, float(np.max(np.abs(found.residual))))
    left.plot(u, found.residual[::stride] * factor, color=_RESIDUAL, linewidth=0.6)
    left.axhline(0.0, color=_LIMIT, linewidth=0.8)
    left.set(xlabel=over, ylabel=f"residual [{unit}]")
    add_legend(loops)
    return figure


def correlations_figure(found: Validation):
    """Return the figure of autocorrelation and input cross-correlation over the lag [samples] with their bounds."""
    tests = [("autocorrelation", found.autocorrelation)]
    if found.cross_correlation is not None:
        tests.append(("input → residual", found.cross_correlation))
    figure, axes = new_figure(3.0, len(tests))
    for axis, (title, test) in zip(axes, tests, strict=True):
        _correlation(axis, title, test)
    return figure


def _correlation(axis, title: str, test: CorrelationTest) -> None:
    axis.axhspan(-test.bound, test.bound, color="#dfe7f3", zorder=0)
    axis.axhline(0.0, color=_LIMIT, linewidth=0.8)
    axis.vlines(test.lags, 0.0, test.correlation, color=_MEASURED, linewidth=1.6)
    verdict = "within the joint bounds" if test.passed else f"{test.outside} lags outside"
    axis.set_title(f"{title}: {verdict}", fontsize=11)
    axis.set(xlabel="lag [samples]", ylabel="correlation")


def inverse_figure(data: IdentificationData, inverse: InverseValidation):
    """Return the figure of the error of the recovered input over time [mV or the input's unit, s]."""
    figure, (axis,) = new_figure(2.6)
    axis.axhline(0.0, color=_LIMIT, linewidth=0.8)
    time = data.time[data.time.size - inverse.error.size :]
    volts = data.input_unit == "V"
    axis.plot(*envelope(time, inverse.error * (1e3 if volts else 1.0)), color="#6a4c93", linewidth=0.9)
    axis.set(xlabel="time [s]", ylabel="voltage error [mV]" if volts else f"input error [{data.input_unit}]")
    return figure


def trajectory_figure(names, values):
    """Return the figure of the parameters over the iterations, each divided by its final value."""
    figure, (axis,) = new_figure(3.0)
    values = np.asarray(values)
    for name, column in zip(names, values.T, strict=True):
        axis.plot(column / (column[-1] or 1.0), linewidth=1.2, label=name)
    axis.axhline(1.0, color=_LIMIT, linewidth=0.8)
    axis.set(xlabel="iteration", ylabel="parameter / final value")
    add_legend(axis)
    return figure
