# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The report page of an identification or validation: measurement, prediction and residual.

For an identified stage: response matrix with bands, held-out realisation, loops, interaction, and closed loops.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from hysteresis_ros.analysis.page import render_page, write_page
from hysteresis_ros.analysis.plots import add_legend, data_uri, envelope, length_unit, new_figure
from hysteresis_ros.analysis.response_plots import MOST_COLUMNS, response_figure
from hysteresis_ros.analysis.tables import shown_row
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.frequency_response import PROBABILITY, ResponseMatrix
from hysteresis_ros.identification.parameter_file import assumptions
from hysteresis_ros.identification.prediction import InverseValidation
from hysteresis_ros.identification.validation import CorrelationTest, Validation
from hysteresis_ros.identification.workflow import Compared, Identified
from hysteresis_ros.units import bare_name, figure_name, readable

_MEASURED, _MODEL, _RESIDUAL, _LIMIT = "#1f3b73", "#d1495b", "#2a9d8f", "#444444"
_MICRO = 1e6
#: Maximum number of samples drawn in a loop.
LOOP_POINTS = 20000
#: The beginning of the held-out realisation is drawn in detail: this fraction of it.
DETAIL = 0.05
#: Rows of the table: name, label, unit, factor that converts from the SI unit.
ROWS = (
    ("rmse_m", "RMS error of the prediction", "µm", 1e6),
    ("rmse_percent_of_stroke", "RMS error", "% of stroke", 1.0),
    ("maximum_error_m", "Largest error", "µm", 1e6),
    ("fit_percent", "Fit", "%", 1.0),
    ("fpe_m2", "Final prediction error", "µm²", 1e12),
    ("stroke_m", "Stroke", "µm", 1e6),
    ("offset_m", "Constant removed", "µm", 1e6),
    ("inverse_rmse_v", "RMS error of the voltage from the inverse", "V", 1.0),
    ("inverse_rmse_percent", "RMS error of the voltage from the inverse", "% of its range", 1.0),
    ("samples", "Samples compared", "", 1),
    ("skipped", "Samples omitted at the start", "", 1),
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
    """Return unit and factor of a row for a recording in ``units``; µm applies only to metres, V only to volts."""
    if unit.startswith("µm") and units[1] != "m":
        return units[1] + unit.removeprefix("µm"), 1.0
    return (units[0], 1.0) if unit == "V" else (unit, factor)


def _output_axis(data: IdentificationData, largest: float | None = None) -> tuple[str, str, float]:
    """Return name, unit and factor for the axis of an output; lengths are drawn in nm if ``largest`` [m] is small."""
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
        (f"Loops, and the residual versus the {_input_name(data)}", loops_figure(data, predicted, errors)),
        (
            f"Correlations of the residual, with {100 * errors.autocorrelation.confidence:g} % bounds for each lag",
            correlations_figure(errors),
        ),
    ]
    if found.inverse is not None:
        name = _input_name(data)
        caption = f"{name.capitalize()} computed by the inverse from the {_output_axis(data)[0]}, minus applied {name}"
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
    """Return the figure of the loops and of the residual versus the voltage [µm, V]."""
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
    """Return the figure of autocorrelation and input cross-correlation, with their bounds, versus the lag [samples]."""
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
    """Return the figure of the inverse's input error over time [mV or the input's unit, s]."""
    figure, (axis,) = new_figure(2.6)
    axis.axhline(0.0, color=_LIMIT, linewidth=0.8)
    time = data.time[data.time.size - inverse.error.size :]
    volts = data.input_unit == "V"
    axis.plot(*envelope(time, inverse.error * (1e3 if volts else 1.0)), color="#6a4c93", linewidth=0.9)
    axis.set(xlabel="time [s]", ylabel="voltage error [mV]" if volts else f"input error [{data.input_unit}]")
    return figure


def trajectory_figure(names, values):
    """Return the figure of the parameters versus the iteration, each divided by its final value."""
    figure, (axis,) = new_figure(3.0)
    values = np.asarray(values)
    for name, column in zip(names, values.T, strict=True):
        axis.plot(column / (column[-1] or 1.0), linewidth=1.2, label=name)
    axis.axhline(1.0, color=_LIMIT, linewidth=0.8)
    axis.set(xlabel="iteration", ylabel="parameter / final value")
    add_legend(axis)
    return figure


class Held(Protocol):
    """A held-out realisation and its prediction."""

    time: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray


class ShownStage(Protocol):
    """Data of an identified stage that the page shows."""

    responses: tuple[ResponseMatrix, ...]
    structure: np.ndarray
    loops: tuple[Identified | None, ...]
    designs: dict[str, Any]
    figures: dict
    warnings: tuple[str, ...]

    @property
    def held_out(self) -> Held | None:
        """The held-out realisation; None if no realisation was held out."""


@dataclass(frozen=True, eq=False)
class ClosedLoops:
    """Responses of the closed loops, from the references to the displacements of all axes."""

    frequency: np.ndarray  #: shape (F,) [Hz]
    response: np.ndarray  #: shape (F, n, n)


def write_stage_identification_report(
    path,
    source: str,
    names: Sequence[str],
    found: ShownStage,
    interaction: Sequence[tuple[str, str]],
    closed: ClosedLoops | None,
) -> None:
    """Write the page of an identified stage as one self-contained HTML file.

    ``interaction`` contains the rows of the table of relative gains, singular values, coupling and margins.
    """
    figures = found.figures
    tables = [
        _table("Identification", (), _rows(figures)),
        _table("Static gain [µm/V]", ("", *(f"actuator {name}" for name in names)), _matrix(names, figures)),
        _table("Errors", ("", "held out", "as written", "noise", "noise in response", "and distortion", "loops"), [
            _errors(name, figures) for name in names
        ]),
        _table("Interaction and margins", (), interaction),
    ]  # fmt: skip
    if found.designs:
        head = ("", "controller", "bandwidth", "M_s", "delay margin")
        tables.append(_table("Controllers", head, [_controller(*one) for one in found.designs.items()]))
    html = render_page(
        "stage_identification.html.j2",
        title=f"Stage {', '.join(names)} identified from {source}",
        summary=f"{figures['type']}, order {figures['order']}; {figures['lines']} lines, "
        f"{figures['lowest_hz']:.4g} … {figures['highest_hz']:.4g} Hz",
        warnings=list(found.warnings),
        tables=tables,
        plots=[dict(caption=caption, source=data_uri(one)) for caption, one in _stage_plots(names, found, closed)],
    )
    write_page(path, html)


def _table(caption: str, head, rows) -> dict:
    return dict(caption=caption, head=list(head), rows=[list(row) for row in rows])


def _rows(figures: Mapping) -> list[tuple[str, str]]:
    delay = figures["delay_samples"]
    rows = [
        ("delay before the structure", f"{delay} sample{'s' if delay != 1 else ''}"),
        ("condition of the inputs", f"{figures['largest_condition']:.3g} at most"),
    ]
    if "realisations" in figures:
        text = f"{figures['realisations']} realisations, period {readable(figures['period_s'], 's')}"
        rows.append(("excitation", text))
    return rows


def _matrix(names: Sequence[str], figures: Mapping) -> list[list[str]]:
    gains = figures["gain_m_per_v"]
    return [
        [f"sensor {name}", *(f"{_MICRO * value:.4g}" for value in row)] for name, row in zip(names, gains, strict=True)
    ]


def _errors(name: str, figures: Mapping) -> list[str]:
    def shown(key: str) -> str:
        return readable(figures[key], "m") if key in figures else "-"

    keys = ("held_out_{}_rmse_m", "file_{}_rmse_m", "noise_{}_m", "noise_in_response_{}_m")
    row = [shown(key.format(name)) for key in (*keys, "noise_and_distortion_in_response_{}_m", "loops_{}_rmse_m")]
    percent = figures.get(f"loops_{name}_rmse_percent_of_stroke")
    return [name, *row[:-1], row[-1] if percent is None else f"{row[-1]}, {percent:.2g} % of the stroke"]


def _controller(name: str, design) -> list[str]:
    margins = design.margins
    late = f"{margins.delay_margin_samples:.3g} samples"
    bandwidth = f"{margins.bandwidth:.4g} Hz"
    return [name, design.parameters.type, bandwidth, f"{margins.sensitivity_peak:.3g}", late]


def _stage_plots(names: Sequence[str], found: ShownStage, closed: ClosedLoops | None) -> list[tuple[str, object]]:
    plots = []
    lowest = found.responses[0]
    for i, name in enumerate(names):
        caption = f"Response of {name} to each actuator, with {100 * PROBABILITY:g} % bands"
        if lowest.response.degrees is None:
            caption = f"Response of {name} to each actuator"
        plots.append((caption, response_figure(names, lowest, i, model=found.structure)))
    if found.held_out is not None:
        held = found.held_out
        for i, name in enumerate(names):
            plots.append((f"{name}: held-out realisation, measured and predicted", held_out_figure(held, i)))
    for name, one in zip(names, found.loops, strict=True):
        if one is not None:
            figure = loops_figure(one.data, one.predicted, one.validation)
            plots.append((f"Loops of {name}, and the residual versus the voltage", figure))
    if closed is not None:
        plots.append(("Closed loops: from each reference to each axis", closed_figure(names, closed)))
    return plots


def held_out_figure(held: Held, output: int):
    """Return the figure of the held-out realisation: the beginning in detail, and the residual of the whole."""
    figure, (detail, residual) = new_figure(3.2, 2)
    count = max(int(DETAIL * len(held.time)), 2)
    measured, predicted = held.measured[:, output], held.predicted[:, output]
    unit, factor = length_unit(float(np.max(np.abs(measured))))
    time = 1e3 * held.time
    detail.plot(time[:count], factor * measured[:count], color=_MEASURED, linewidth=2.0, label="measured")
    detail.plot(time[:count], factor * predicted[:count], color=_MODEL, linewidth=0.9, label="predicted")
    detail.set(xlabel="time [ms]", ylabel=f"displacement [{unit}]")
    error = measured - predicted
    unit, factor = length_unit(float(np.max(np.abs(error))))
    residual.plot(time, factor * error, color=_RESIDUAL, linewidth=0.6)
    residual.set(xlabel="time [ms]", ylabel=f"measured − predicted [{unit}]")
    add_legend(detail)
    return figure


def closed_figure(names: Sequence[str], closed: ClosedLoops):
    """Return the figure of the closed loops: how the reference of an axis moves this axis and the other axes."""
    figure, (axis,) = new_figure(4.0)
    for j, reference in enumerate(names):
        for i, name in enumerate(names):
            own = i == j
            label = f"{name}" if own else f"{name}, response to the reference of {reference}"
            style = dict(linewidth=1.6) if own else dict(linewidth=0.9, linestyle="--")
            axis.plot(closed.frequency, np.abs(closed.response[:, i, j]), label=label, **style)
    axis.set(xscale="log", yscale="log", xlabel="frequency [Hz]", ylabel="gain [m/m]")
    if len(names) <= MOST_COLUMNS:
        add_legend(axis, 3)
    return figure
