# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Plots of a measured response matrix: magnitude and phase of each pair, with bands, noise and distortion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from hysteresis_ros.analysis.page import render_page, write_page
from hysteresis_ros.analysis.plots import add_legend, data_uri, new_figure
from hysteresis_ros.analysis.response_plots import require_picture
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.files import replacing
from hysteresis_ros.identification.frequency_response import PROBABILITY, ResponseMatrix

_MEASURED, _MODEL, _NOISE, _DISTORTION = "#1f3b73", "#d1495b", "#9a9a9a", "#e09f3e"
_MICRO = 1e6
#: Columns of a figure of responses; with more axes it shows the own actuator only.
MOST_COLUMNS = 4
#: Height of the plots of one output [inch].
HEIGHT = 5.6


class ShownMatrix(Protocol):
    """The data of a measured stage that the plots need."""

    names: tuple[str, ...]
    matrix: ResponseMatrix

    @property
    def distortion(self) -> np.ndarray | None:
        """Standard deviation by nonlinear distortion, shape (F, n, n) [m/V]."""

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
    """Write the plots of all pairs into one picture."""
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
    """Draw magnitudes in the first half of the axes, and phases below."""
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
            size.plot(f, _MICRO * np.abs(fitted), color=_MODEL, linewidth=1.0, label="model")
            phase.plot(f, np.degrees(np.angle(fitted)), ".", color=_MODEL, markersize=1.5)
        size.set(xscale="log", yscale="log", ylabel="gain [µm/V]" if place == 0 else None)
        size.text(0.03, 0.05, f"{names[row]} from {names[column]}", fontsize=11, transform=size.transAxes)
        phase.set(xscale="log", xlabel="frequency [Hz]", ylabel="phase [degrees]" if place == 0 else None)
        phase.set(ylim=(-190.0, 190.0), yticks=(-180, -90, 0, 90, 180))
    add_legend(axes[0], 2)
