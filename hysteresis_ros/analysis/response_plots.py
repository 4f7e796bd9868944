# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Plots of a measured frequency response: Bode with bands and distortion, sensitivities, Nyquist with margins.

For a stage: magnitude and phase of each entry of the response matrix, with bands, noise and distortion.
"""

from __future__ import annotations

import pathlib
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from hysteresis_ros.analysis.page import render_page, write_page
from hysteresis_ros.analysis.plots import add_legend, data_uri, new_figure
from hysteresis_ros.control.margins import REQUIRED, MeasuredLoop
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.files import replacing
from hysteresis_ros.identification.frequency_response import PROBABILITY, Analysis, ResponseMatrix

_MEASURED, _MODEL, _SECOND = "#1f3b73", "#8a8a8a", "#2a9d8f"
_LEVELS = {"noise": ("noise", "#9a9a9a"), "odd": ("odd distortion", "#d1495b"), "even": ("even distortion", "#e09f3e")}
#: Limit of the real and imaginary parts in the Nyquist plot.
NYQUIST = 2.5

#: Further colours in the plots of a stage.
_FITTED, _NOISE, _DISTORTION = "#d1495b", "#9a9a9a", "#e09f3e"
_MICRO = 1e6
#: Maximum number of columns of a figure of responses. For a stage with more axes the figure shows only the response of
#: each axis to its own actuator.
MOST_COLUMNS = 4
#: Height of the plots of one output [inch].
HEIGHT = 5.6


class Shown(Protocol):
    """Data of a measured axis that the plots show."""

    plant: Analysis
    loop: MeasuredLoop | None
    model: np.ndarray | None
    model_loop: np.ndarray | None

    def lines(self) -> list[str]:
        """Return the printed table."""


def response_figures(found: Shown) -> list[tuple[str, object]]:
    """Return captions and figures: Bode plot of the plant and, for a loop, sensitivities and Nyquist plot."""
    figure, axes = new_figure(6.4 if found.plant.response.coherence is None else 8.0, rows=_rows(found))
    _bode(axes, found)
    figures = [("Frequency response", figure)]
    if found.loop is not None:
        figure, (axis,) = new_figure(3.8)
        _sensitivities(axis, found.loop, found.model_loop)
        figures.append(("Sensitivity and complementary sensitivity", figure))
        figure, (axis,) = new_figure(6.0)
        _nyquist(axis, found.loop, found.model_loop)
        figures.append(("Nyquist", figure))
    return figures


def require_picture(path) -> None:
    """Raise RecordingError if the suffix is not ``.png``, or if the folder does not exist."""
    path = pathlib.Path(path)
    if path.suffix.lower() != ".png":
        raise RecordingError(f"{path}: unknown kind of picture '{path.suffix}'; give the name of a .png file")
    if not path.absolute().parent.is_dir():
        raise RecordingError(f"{path}: cannot be written: the folder does not exist; choose another one")


def write_response_picture(path, found: Shown) -> None:
    """Write all plots into one picture."""
    require_picture(path)
    rows = _rows(found)
    loop = found.loop
    looped = loop is not None
    figure, axes = new_figure(3.2 * rows + (9.2 if looped else 0.0), rows=rows + 2 * looped)
    _bode(axes[:rows], found)
    if loop is not None:
        axes[0].get_gridspec().set_height_ratios([1.0] * (rows + 1) + [2.0])
        _sensitivities(axes[rows], loop, found.model_loop)
        _nyquist(axes[rows + 1], loop, found.model_loop)
    with replacing(path, RecordingError) as beside:
        figure.savefig(beside, format="png")


def write_response_report(path, title: str, found: Shown) -> None:
    """Write the page as one self-contained HTML file."""
    plots = [dict(caption=caption, source=data_uri(figure)) for caption, figure in response_figures(found)]
    write_page(path, render_page("response.html.j2", title=title, lines=found.lines(), plots=plots))


def _rows(found: Shown) -> int:
    return 2 if found.plant.response.coherence is None else 3


def _bode(axes, found: Shown) -> None:
    """Draw magnitude and phase with confidence bands, levels of noise and distortion and, if known, the coherence."""
    response, levels = found.plant.response, found.plant.distortion
    f, G = response.frequency, response.single
    magnitude, phase = axes[:2]
    spread = None if response.degrees is None else response.radius(PROBABILITY)[:, 0, 0]
    angle = np.degrees(np.unwrap(np.angle(G)))
    if found.model is not None:
        magnitude.plot(f, np.abs(found.model), color=_MODEL, linewidth=1.0, label="model")
        model = np.degrees(np.unwrap(np.angle(found.model)))
        model += 360.0 * np.round((angle[0] - model[0]) / 360.0)
        phase.plot(f, model, color=_MODEL, linewidth=1.0)
    magnitude.plot(f, np.abs(G), ".-", color=_MEASURED, linewidth=1.0, markersize=2.5, label="measured")
    phase.plot(f, angle, ".-", color=_MEASURED, linewidth=1.0, markersize=2.5)
    if spread is not None:
        _band(magnitude, f, np.abs(G), spread, f"{100 * PROBABILITY:g} % band")
        wide = np.degrees(np.arcsin(np.minimum(spread / np.abs(G), 1.0)))
        phase.fill_between(f, angle - wide, angle + wide, color=_MEASURED, alpha=0.22, linewidth=0.0)
    for name, (label, colour) in _LEVELS.items():
        values = np.full(f.size, np.nan) if levels is None else getattr(levels, name)
        if np.any(values > 0.0):
            seen = np.where(values > 0.0, values, np.nan)
            magnitude.plot(f, seen, ".", color=colour, markersize=3.0, label=label)
    magnitude.set(xscale="log", yscale="log", ylabel=f"magnitude [{response.output_unit}/{response.input_unit}]")
    phase.set(xscale="log", ylabel="phase [degrees]")
    add_legend(magnitude)
    if response.coherence is not None:
        axes[2].plot(f, response.coherence[:, 0], color=_MEASURED, linewidth=1.0)
        axes[2].set(xscale="log", ylabel="coherence [1]", ylim=(0.0, 1.05))
    axes[len(axes) - 1].set(xlabel="frequency [Hz]")


def _band(axis, f, size, radius, label: str | None = None) -> None:
    """Fill the band from size − radius (but at least 0.01 size) to size + radius."""
    axis.fill_between(
        f,
        np.maximum(size - radius, 0.01 * size),
        size + radius,
        color=_MEASURED,
        alpha=0.22,
        linewidth=0.0,
        label=label,
    )


def _sensitivities(axis, loop: MeasuredLoop, model: np.ndarray | None) -> None:
    """Draw |S| and |T| with their confidence bands, and the limit of M_s for every design."""
    curves = ((loop.sensitivity, "sensitivity S", _MEASURED), (loop.complementary, "complementary T", _SECOND))
    if model is not None:
        S = 1.0 / (1.0 + model)
        for place, values in enumerate((S, model * S)):
            label = "model" if place == 0 else None
            axis.plot(loop.frequency, np.abs(values), color=_MODEL, linewidth=1.0, label=label)
    for values, label, colour in curves:
        size, radius = np.abs(values), loop.sensitivity_radius
        axis.plot(loop.frequency, size, ".-", color=colour, linewidth=1.0, markersize=2.5, label=label)
        low = np.maximum(size - radius, 0.01 * size)
        axis.fill_between(loop.frequency, low, size + radius, color=colour, alpha=0.22, linewidth=0.0)
    bound = REQUIRED.sensitivity_peak
    axis.axhline(bound, color="#444444", linewidth=0.8, linestyle=(0, (4, 3)), label=f"M_s = {bound:g}")
    axis.set(xscale="log", yscale="log", xlabel="frequency [Hz]", ylabel="magnitude [1]")
    add_legend(axis)


def _nyquist(axis, loop: MeasuredLoop, model: np.ndarray | None) -> None:
    """Draw L with the uncertainty circles at the lines, the point −1, the unit circle and the M_s circle."""
    turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 400))
    bound = REQUIRED.sensitivity_peak
    axis.plot(turn.real, turn.imag, color="#bbbbbb", linewidth=0.8)
    circle = -1.0 + turn / bound
    axis.plot(circle.real, circle.imag, color="#d1495b", linewidth=1.0, linestyle=(0, (4, 3)), label=f"M_s = {bound:g}")
    axis.plot(-1.0, 0.0, "+", color="#d1495b", markersize=9.0)
    near = np.flatnonzero(np.abs(loop.loop + 1.0) < 2.0 * NYQUIST)
    for place in near[np.abs(loop.loop[near]) > 0.05]:
        around = loop.loop[place] + loop.radius[place] * turn[::16]
        axis.fill(around.real, around.imag, color=_MEASURED, alpha=0.1, linewidth=0.0)
    if model is not None:
        axis.plot(model.real, model.imag, color=_MODEL, linewidth=1.0, label="model")
    axis.plot(
        loop.loop.real,
        loop.loop.imag,
        ".-",
        color=_MEASURED,
        linewidth=0.9,
        markersize=3.0,
        label="measured, with uncertainty circles",
    )
    for name, (value, direction) in _margins(loop).items():
        axis.annotate(name, value, xytext=direction, textcoords="offset points", fontsize=8,
                      arrowprops={"arrowstyle": "-", "color": "#444444", "linewidth": 0.7})  # fmt: skip
    axis.set_aspect("equal", adjustable="box")
    axis.set(xlim=(-NYQUIST, NYQUIST), ylim=(-NYQUIST, 0.6 * NYQUIST), xlabel="Re L", ylabel="Im L")
    add_legend(axis)


def _margins(loop: MeasuredLoop) -> dict[str, tuple[tuple[float, float], tuple[float, float]]]:
    """Return, for each label, a point in the complex plane and the offset of the text."""
    found = {}
    if np.isfinite(loop.gain_margin.value):
        found[f"gain margin {loop.gain_margin.value:.1f} dB"] = (
            (-(10.0 ** (-loop.gain_margin.value / 20.0)), 0.0), (25.0, 45.0)
        )  # fmt: skip
    if np.isfinite(loop.phase_margin.value):
        angle = np.pi + np.radians(loop.phase_margin.value)
        text = f"phase margin {loop.phase_margin.value:.0f}°, delay margin {loop.delay_margin.value:.2g} samples"
        found[text] = ((float(np.cos(angle)), float(np.sin(angle))), (40.0, -55.0))
    worst = int(np.argmin(np.abs(1.0 + loop.loop)))
    text = f"M_s {loop.sensitivity_peak.value:.2f} at {loop.frequency[worst]:.3g} Hz"
    found[text] = ((float(loop.loop[worst].real), float(loop.loop[worst].imag)), (-185.0, -25.0))
    return found


class ShownMatrix(Protocol):
    """Data of a measured stage that the plots show."""

    names: tuple[str, ...]
    matrix: ResponseMatrix

    @property
    def distortion(self) -> np.ndarray | None:
        """Standard deviation of the response due to nonlinear distortion, shape (F, n, n) [m/V]."""

    def lines(self) -> list[str]:
        """Return the printed table."""


def response_figure(
    names: Sequence[str],
    found: ResponseMatrix,
    row: int,
    *,
    model: np.ndarray | None = None,
    distortion: np.ndarray | None = None,
):
    """Return the figure of the responses of an output to the inputs: magnitude and phase, measured and modelled."""
    inputs = _inputs(names, row)
    figure, axes = new_figure(HEIGHT, len(inputs), 2)
    _draw(axes, names, found, row, model, distortion)
    return figure


def write_matrix_picture(path, found: ShownMatrix) -> None:
    """Write the plots of all entries of the response matrix into one picture."""
    require_picture(path)
    count = len(_inputs(found.names, 0))
    figure, axes = new_figure(HEIGHT * len(found.names), count, 2 * len(found.names))
    for row in range(len(found.names)):
        own = axes[2 * count * row : 2 * count * (row + 1)]
        _draw(own, found.names, found.matrix, row, None, found.distortion)
    with replacing(path, RecordingError) as beside:
        figure.savefig(beside, format="png")


def write_matrix_report(path, title: str, found: ShownMatrix) -> None:
    """Write the page as one self-contained HTML file."""
    plots = []
    for row, name in enumerate(found.names):
        figure = response_figure(found.names, found.matrix, row, distortion=found.distortion)
        plots.append(dict(caption=f"Response of {name} to each actuator", source=data_uri(figure)))
    write_page(path, render_page("response.html.j2", title=title, lines=found.lines(), plots=plots))


def _inputs(names: Sequence[str], row: int) -> list[int]:
    return list(range(len(names))) if len(names) <= MOST_COLUMNS else [row]


def _draw(axes, names: Sequence[str], found: ResponseMatrix, row: int, model, distortion) -> None:
    """Draw magnitudes in the first half of ``axes``, and phases in the second half."""
    response, inputs = found.response, _inputs(names, row)
    f = response.frequency
    radius = None if response.degrees is None else response.radius(PROBABILITY)
    noise = None if response.noise_variance is None else np.sqrt(response.noise_variance)
    levels = ((noise, "noise", _NOISE), (distortion, "distortion", _DISTORTION))
    for place, column in enumerate(inputs):
        size, phase = axes[place], axes[place + len(inputs)]
        measured = response.response[:, row, column]
        size.plot(f, _MICRO * np.abs(measured), color=_MEASURED, linewidth=1.0, label="measured")
        phase.plot(f, np.degrees(np.angle(measured)), ".", color=_MEASURED, markersize=1.5)
        if radius is not None:
            around = radius[:, row, column]
            least = np.maximum(np.abs(measured) - around, 0.03 * np.abs(measured))
            most = np.abs(measured) + around
            label = f"{100 * PROBABILITY:g} % band"
            size.fill_between(f, _MICRO * least, _MICRO * most, color=_MEASURED, alpha=0.25, linewidth=0.0, label=label)
        for values, label, colour in levels:
            if values is not None and np.any(values[:, row, column] > 0.0):
                shown = np.where(values[:, row, column] > 0.0, values[:, row, column], np.nan)
                size.plot(f, _MICRO * shown, ".", color=colour, markersize=1.5, label=label)
        if model is not None:
            fitted = model[:, row, column]
            size.plot(f, _MICRO * np.abs(fitted), color=_FITTED, linewidth=1.0, label="model")
            phase.plot(f, np.degrees(np.angle(fitted)), ".", color=_FITTED, markersize=1.5)
        size.set(xscale="log", yscale="log", ylabel="gain [µm/V]" if place == 0 else None)
        size.text(0.03, 0.05, f"{names[row]} from {names[column]}", fontsize=11, transform=size.transAxes)
        phase.set(xscale="log", xlabel="frequency [Hz]", ylabel="phase [degrees]" if place == 0 else None)
        phase.set(ylim=(-190.0, 190.0), yticks=(-180, -90, 0, 90, 180))
    add_legend(axes[0], 2)
