# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Page of an identified stage: response matrix with bands, held-out realisation, loops, interaction, closed loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from hysteresis_ros.analysis.identification_report import loops_figure
from hysteresis_ros.analysis.page import render_page, write_page
from hysteresis_ros.analysis.plots import add_legend, data_uri, length_unit, new_figure
from hysteresis_ros.analysis.stage_response_plots import MOST_COLUMNS, response_figure
from hysteresis_ros.identification.frequency_response import PROBABILITY, ResponseMatrix
from hysteresis_ros.identification.workflow import Identified
from hysteresis_ros.units import readable

_MEASURED, _MODEL, _RESIDUAL = "#1f3b73", "#d1495b", "#2a9d8f"
_MICRO = 1e6
#: Part of the held-out realisation that is drawn in detail.
DETAIL = 0.05


class Held(Protocol):
    """A realisation that was held out, and its prediction."""

    time: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray


class Shown(Protocol):
    """The data of an identified stage that the page shows."""

    responses: tuple[ResponseMatrix, ...]
    structure: np.ndarray
    loops: tuple[Identified | None, ...]
    designs: dict[str, Any]
    figures: dict
    warnings: tuple[str, ...]

    @property
    def held_out(self) -> Held | None:
        """What was held out."""


@dataclass(frozen=True, eq=False)
class ClosedLoops:
    """Responses of the closed loops from references to displacements."""

    frequency: np.ndarray  #: shape (F,) [Hz]
    response: np.ndarray  #: shape (F, n, n)


def write_stage_identification_report(
    path,
    source: str,
    names: Sequence[str],
    found: Shown,
    interaction: Sequence[tuple[str, str]],
    closed: ClosedLoops | None,
) -> None:
    """Write the page of an identified stage as one self-contained HTML file.

    ``interaction`` has the rows of the table of relative gains, singular values, coupling and margins.
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
        plots=[dict(caption=caption, source=data_uri(one)) for caption, one in _plots(names, found, closed)],
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


def _plots(names: Sequence[str], found: Shown, closed: ClosedLoops | None) -> list[tuple[str, object]]:
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
            plots.append((f"Loops of {name}, and the residual over the voltage", figure))
    if closed is not None:
        plots.append(("Closed loops: from each reference to each axis", closed_figure(names, closed)))
    return plots


def held_out_figure(held: Held, output: int):
    """Return the figure of a detail of the held-out realisation, and of the whole residual."""
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
    """Return the figure of the closed loops: each axis, and what its reference moves of the others."""
    figure, (axis,) = new_figure(4.0)
    for j, reference in enumerate(names):
        for i, name in enumerate(names):
            own = i == j
            label = f"{name}" if own else f"{name} from the reference of {reference}"
            style = dict(linewidth=1.6) if own else dict(linewidth=0.9, linestyle="--")
            axis.plot(closed.frequency, np.abs(closed.response[:, i, j]), label=label, **style)
    axis.set(xscale="log", yscale="log", xlabel="frequency [Hz]", ylabel="gain [m/m]")
    if len(names) <= MOST_COLUMNS:
        add_legend(axis, 3)
    return figure
