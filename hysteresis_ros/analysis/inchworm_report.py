# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The report of an inchworm motor's run, with plots of travel [mm], gait [µm, V, N] and arrival [nm]."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.analysis.inchworm import (
    COMMON_FIGURES,
    MOVE_FIGURES,
    RUN_FIGURES,
    InchwormRun,
    inchworm_figures,
    inchworm_run,
)
from hysteresis_ros.analysis.page import origin, write_page
from hysteresis_ros.analysis.plots import Chart, Line, add_legend, data_uri, envelope, new_figure
from hysteresis_ros.analysis.report import render_interactive, sampling_text
from hysteresis_ros.analysis.tables import format_value, shown_row
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.references import inchworm_layout as at

#: Number of steps drawn in detail.
SHOWN_STEPS = 3
#: Maximum number of arrivals shown: those of the first moves.
SHOWN_MOVES = 40
#: Time shown before and after an arrival [s].
BEFORE, AFTER = 0.1, 0.15
#: Number of bars of a histogram.
BARS = 60

#: Colours of the phases; the phase with both clamps closed is white.
PHASE_COLOURS = {
    at.RELEASING_REAR: "#fbe3b4",
    at.CARRYING: "#a9d6a4",
    at.GRIPPING_REAR: "#f6c667",
    at.RELEASING_FRONT: "#e3d5f0",
    at.RETURNING: "#a8c8ec",
    at.GRIPPING_FRONT: "#c3a5dc",
    at.POSITIONING: "#d8f0d6",
    at.RELEASED: "#e5e5e5",
    at.STOPPING: "#f7b5b0",
    at.STARTING: "#efefef",
}
#: Activity and colour of each phase, for plots that cannot show single steps.
ACTIVITIES = {
    "walking": ("#cfdff2", range(at.RELEASING_REAR, at.GRIPPING_FRONT + 1)),
    "fine positioning": ("#cdebc8", (at.POSITIONING,)),
    "stopping": ("#f7b5b0", (at.STOPPING,)),
    "released": ("#dddddd", (at.RELEASED,)),
}
#: A pause between the steps of a walk belongs to the walk if it is shorter than this [s].
PAUSE = 0.05

_SETPOINT, _SLIDER, _EXTENDER, _REFERENCE = "#444444", "#d1495b", "#1f6f8b", "#9a9a9a"
_FRONT, _REAR, _VOLTAGE = "#c2571a", "#6a4c93", "#1f6f8b"
_WAYS = ((1.0, "forward", "#1f6f8b"), (-1.0, "backward", "#d1495b"))


def travel_figure(run: InchwormRun):
    """Return the figure of setpoint and slider over time [mm, s], with the motor's activities as bands."""
    figure, (axis,) = new_figure(3.6)
    draw_activities(axis, run)
    time, values = envelope(run.time, run.setpoint * 1e3)
    axis.plot(time, values, color=_SETPOINT, linestyle=(0, (4, 3)), linewidth=1.1, label="setpoint", zorder=3)
    time, values = envelope(run.time, run.slider * 1e3)
    axis.plot(time, values, color=_SLIDER, linewidth=1.4, label="slider", zorder=4)
    axis.set(xlabel="time [s]", ylabel="position [mm]", xlim=(run.time[0], run.time[-1]))
    add_legend(axis)
    return figure


def gait_figure(run: InchwormRun):
    """Return the figure of a few steps over time [ms]: slider and extender [µm], voltages [V], clamp forces [N]."""
    forces = "front_force" in run.signals and "rear_force" in run.signals
    figure, axes = new_figure(7.4 if forces else 5.4, rows=3 if forces else 2)
    shown = steps_window(run)
    for axis in axes:
        draw_phases(axis, run, shown, labels=axis is axes[0])
    draw_steps(axes[0], run, shown)
    time = _milliseconds(run, shown)
    for name, colour, label in (
        ("front_voltage", _FRONT, "front clamp"),
        ("rear_voltage", _REAR, "rear clamp"),
        ("voltage", _VOLTAGE, "extender"),
    ):
        if name in run.signals:
            axes[1].plot(time, run.signals[name][shown], color=colour, linewidth=1.4, label=label)
    axes[1].set_ylabel("voltage [V]")
    if forces:
        for name, colour, label in (("front_force", _FRONT, "front clamp"), ("rear_force", _REAR, "rear clamp")):
            axes[2].plot(time, run.signals[name][shown], color=colour, linewidth=1.4, label=label)
        axes[2].set_ylabel("normal force [N]")
    for axis in axes[1:]:
        axis.legend(loc="center right", frameon=True, framealpha=0.9, edgecolor="none", fontsize=8)
    for axis in axes:
        axis.set_xlabel(f"time since {run.time[shown.start]:.4g} s [ms]")
        axis.set_xlim(time[0], time[-1])
    return figure


def arrival_figure(run: InchwormRun):
    """Return the figure of the end of each move, on a scale of micrometres and on one of nanometres [µm, nm, ms]."""
    figure, (coarse, fine) = new_figure(4.0, 2)
    moves = [move for move in run.moves if move.arrival is not None][:SHOWN_MOVES]
    thin = 1.3 if len(moves) < 6 else 0.7
    for move in moves:
        start = int(np.searchsorted(run.time, run.time[move.arrival] - BEFORE))
        start, end = max(start, move.first), int(np.searchsorted(run.time, run.time[move.arrival] + AFTER))
        part = slice(start, min(end, move.last))
        time = (run.time[part] - run.time[move.arrival]) * 1e3
        away = run.slider[part] - move.goal
        colour = _WAYS[0 if move.goal >= run.slider[move.first] else 1][2]
        coarse.plot(time, away * 1e6, color=colour, linewidth=thin)
        fine.plot(time, away * 1e9, color=colour, linewidth=thin)
    limit = run.tolerance * 1e9
    for level in (-limit, limit):
        fine.axhline(level, color=_SETPOINT, linestyle=(0, (5, 3)), linewidth=1.0)
    fine.set_ylim(-3.0 * limit, 3.0 * limit)
    for axis, unit in ((coarse, "µm"), (fine, "nm")):
        axis.axvline(0.0, color="#b0b0b0", linewidth=0.9)
        axis.set(xlabel="time since arrival [ms]", ylabel=f"slider − setpoint [{unit}]")
    for _, label, colour in _WAYS:
        coarse.plot([], [], color=colour, label=label)
    fine.plot([], [], color=_SETPOINT, linestyle=(0, (5, 3)), label=f"tolerance {limit:.3g} nm")
    add_legend(coarse)
    add_legend(fine)
    return figure


def final_error_figure(run: InchwormRun):
    """Return the figure of slider - setpoint from arrival to the end of each move [nm, s]."""
    figure, (axis,) = new_figure(2.8)
    limit = run.tolerance * 1e9
    for move in run.moves:
        if move.arrival is not None:
            part = slice(move.arrival, move.last)
            time, away = envelope(run.time[part], (run.slider[part] - move.goal) * 1e9)
            colour = _WAYS[0 if move.goal >= run.slider[move.first] else 1][2]
            axis.plot(time, away, color=colour, linewidth=0.8)
    for level in (-limit, limit):
        axis.axhline(level, color=_SETPOINT, linestyle=(0, (5, 3)), linewidth=1.0)
    axis.set(xlabel="time [s]", ylabel="slider − setpoint [nm]", xlim=(run.time[0], run.time[-1]))
    return figure


def step_length_figure(run: InchwormRun):
    """Return histograms of commanded and achieved step lengths [µm], and of their difference [nm]."""
    figure, (lengths, errors) = new_figure(4.0, 2)
    steps = run.steps
    if steps.index.size:
        values = np.concatenate([steps.commanded, steps.achieved]) * 1e6
        edges = np.linspace(*_span(values), BARS + 1)
        lengths.hist(steps.commanded * 1e6, edges, color=_REFERENCE, label="commanded", alpha=0.75)
        for sign, label, colour in _WAYS:
            chosen = steps.achieved[steps.direction == sign] * 1e6
            if chosen.size:
                style = dict(histtype="step", color=colour, linewidth=1.6, label=f"achieved, {label}")
                lengths.hist(chosen, edges, **style)
        difference = steps.direction * (steps.commanded - steps.achieved) * 1e9
        # with outliers (missed grips, the first step) in the range, all other steps would fall into one bar
        middle = np.median(difference)
        spread = max(float(np.median(np.abs(difference - middle))), 1e-3)
        low, high = _span(np.clip(difference, middle - 6.0 * spread, middle + 6.0 * spread))
        edges = np.linspace(low, high, BARS // 2 + 1)
        for sign, label, colour in _WAYS:
            chosen = difference[steps.direction == sign]
            if chosen.size:
                text = f"{label}, 1 σ {np.std(chosen):.3g} nm"
                errors.hist(np.clip(chosen, low, high), edges, color=colour, alpha=0.55, label=text)
        if steps.index.size > 20:
            lengths.set_yscale("log")
            lengths.set_ylim(bottom=0.7)
    lengths.set(xlabel="step length [µm]", ylabel="steps [1]")
    errors.set(xlabel="commanded − achieved [nm]", ylabel="steps [1]")
    for axis, columns in ((lengths, 3), (errors, 2)):
        place = dict(loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, borderaxespad=0.2)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(ncols=columns, fontsize=8, columnspacing=1.0, handlelength=1.4, **place)
    return figure


def slip_figure(run: InchwormRun):
    """Return the figure of slip, missed grips, and commanded − achieved length versus the step number [nm]."""
    figure, (slip, lack) = new_figure(4.8, rows=2)
    steps = run.steps
    number = np.arange(1, steps.index.size + 1)
    lacking = steps.direction * (steps.commanded - steps.achieved)
    for sign, label, colour in _WAYS:
        chosen = steps.direction == sign
        if np.any(chosen):
            dots = dict(color=colour, linestyle="none", marker=".", markersize=4, label=label)
            slip.plot(number[chosen], steps.slip[chosen] * 1e9, **dots)
            lack.plot(number[chosen], lacking[chosen] * 1e9, **dots)
    if np.any(steps.missed):
        cross = dict(color="#b00020", linestyle="none", marker="x", markersize=7, label="missed grip")
        slip.plot(number[steps.missed], steps.slip[steps.missed] * 1e9, **cross)
    slip.set(xlabel="step [1]", ylabel="slip [nm]")
    lack.set(xlabel="step [1]", ylabel="commanded − achieved [nm]")
    for axis in (slip, lack):
        axis.axhline(0.0, color="#444444", linewidth=0.8)
    if steps.index.size:
        add_legend(slip)
    return figure


#: Interactive charts that the page shows as a more detailed picture if scripts are disabled: name, caption, picture.
IN_THE_PLACE = (
    ("travel", "Position over time", travel_figure),
    ("final_error", "Final error, from each arrival to the end of the move", final_error_figure),
)
#: Plots of the page: caption, and the function that draws the plot of an :class:`InchwormRun`.
INCHWORM_PLOTS = (
    (f"{SHOWN_STEPS} steps: positions, voltages and clamp forces", gait_figure),
    ("Arrival: the last micrometres and the last nanometres", arrival_figure),
    ("Length of the steps (the last bar on the right includes all longer steps)", step_length_figure),
    ("Slip and missed grips", slip_figure),
)


def inchworm_charts(run: InchwormRun) -> list[Chart]:
    """Return the interactive charts over time: position, final error, voltages."""
    captions = {name: caption for name, caption, _ in IN_THE_PLACE}
    away = np.full(len(run.time), np.nan)
    for move in run.moves:
        if move.arrival is not None:
            away[move.arrival : move.last] = (run.slider[move.arrival : move.last] - move.goal) * 1e9
    travel = [
        Line("setpoint", "limit", run.time, run.setpoint * 1e3, 1.1, (4.0, 3.0)),
        Line("slider", "displacement", run.time, run.slider * 1e3, 1.4),
    ]
    charts = [Chart("travel", captions["travel"], "time [s]", "position [mm]", travel)]
    if np.any(np.isfinite(away)):
        limit, label = run.tolerance * 1e9, "slider − setpoint [nm]"
        line = Line("slider − setpoint", "displacement", run.time, away, 1.0)
        charts.append(Chart("final_error", captions["final_error"], "time [s]", label, [line], levels=(-limit, limit)))
    voltages = (("front_voltage", "late", "front clamp"), ("rear_voltage", "voltage", "rear clamp"))
    lines = [
        Line(label, colour, run.time, run.signals[name], 1.0)
        for name, colour, label in (*voltages, ("voltage", "reference", "extender"))
        if name in run.signals
    ]
    return [*charts, Chart("voltages", "Voltages of clamps and extender", "time [s]", "voltage [V]", lines)]


def steps_window(run: InchwormRun, count: int = SHOWN_STEPS) -> slice:
    """Return the samples of ``count`` steps in the middle of the move with most steps; without moves, of the run."""
    parts = [run.steps.between(move.first, move.last).index for move in run.moves] or [run.steps.index]
    index = max(parts, key=len)
    if len(index) < 2:
        middle = int(index[0]) if len(index) else 0
        near = int(np.searchsorted(run.time, run.time[middle] - BEFORE))
        return slice(near, max(int(np.searchsorted(run.time, run.time[middle] + BEFORE)), near + 2))
    start = max(0, (len(index) - 1 - count) // 2)
    return slice(int(index[start]), int(index[min(start + count, len(index) - 1)]) + 1)


def draw_steps(axis, run: InchwormRun, shown: slice) -> None:
    """Draw slider (relative to its first value) and extender in the samples ``shown`` [µm, ms]."""
    time = _milliseconds(run, shown)
    slider = run.slider[shown]
    axis.plot(time, (slider - slider[0]) * 1e6, color=_SLIDER, linewidth=1.8, label="slider", zorder=4)
    name = next((name for name in ("extender_displacement", "extender") if name in run.signals), None)
    if name:
        extender = run.signals[name][shown]
        axis.plot(time, extender * 1e6, color=_EXTENDER, linewidth=1.4, label="extender", zorder=3)
    axis.set_ylabel("displacement [µm]")
    axis.legend(loc="center right", frameon=True, framealpha=0.9, edgecolor="none", fontsize=8)


def draw_phases(axis, run: InchwormRun, shown: slice, labels: bool = True) -> None:
    """Draw the phases in the samples ``shown`` as bands [ms], with a legend above the axes."""
    phase, time = run.signals["phase"][shown], _milliseconds(run, shown)
    bands = {}
    for first, last, code in _stretches(phase):
        if code in PHASE_COLOURS:
            end = time[min(last, len(time) - 1)]
            bands[code] = axis.axvspan(time[first], end, color=PHASE_COLOURS[code], linewidth=0, zorder=0)
    if labels and bands:
        codes = sorted(bands)
        names = [at.PHASE_NAMES[code].replace("_", " ") for code in codes]
        place = dict(loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, fontsize=8, borderaxespad=0.2)
        handles = [bands[code] for code in codes]
        axis.add_artist(axis.legend(handles, names, ncols=6, columnspacing=1.0, handlelength=1.2, **place))


def draw_activities(axis, run: InchwormRun) -> None:
    """Draw walking, fine positioning, stops and releases as bands [s]; short pauses between steps count as walking."""
    codes = np.zeros(len(run.time))
    for number, (_, phases) in enumerate(ACTIVITIES.values(), 1):
        codes[np.isin(run.signals["phase"], list(phases))] = number
    names, seen = list(ACTIVITIES), set()
    stretches = _stretches(codes)
    for i, (first, last, code) in enumerate(stretches):
        end = run.time[min(last, len(codes) - 1)]
        walked = code == 0 and i > 0 and stretches[i - 1][2] == 1 and end - run.time[first] < PAUSE
        if code == 0 and not walked:
            continue
        name = names[0 if walked else code - 1]
        label = None if name in seen else name
        seen.add(name)
        axis.axvspan(run.time[first], end, color=ACTIVITIES[name][0], linewidth=0, label=label, zorder=0)


def _stretches(codes) -> list[tuple[int, int, int]]:
    """Return (first, last, code) for each interval ``first`` ≤ k < ``last`` with constant code."""
    cuts = [0, *(np.flatnonzero(np.diff(codes)) + 1).tolist(), len(codes)]
    return [(first, last, int(codes[first])) for first, last in zip(cuts, cuts[1:], strict=False) if last > first]


def _milliseconds(run: InchwormRun, shown: slice):
    return (run.time[shown] - run.time[shown.start]) * 1e3


def _span(values) -> tuple[float, float]:
    """Return a range slightly wider than that of ``values``, never of width 0."""
    low, high = float(np.min(values)), float(np.max(values))
    room = max(0.03 * (high - low), 1e-3 * max(abs(low), abs(high)), 1e-6)
    return low - room, high + room


def render_inchworm_report(recording: Recording, title: str, figures: dict | None = None) -> str:
    """Return the report as HTML: a table of moves, figures of the run, plots, notes and configuration."""
    figures = figures or inchworm_figures(recording)
    run = inchworm_run(recording)
    begin, end = float(run.time[0]), float(run.time[-1])
    ends = [(float(run.time[move.first]), float(run.time[move.last - 1])) for move in run.moves]
    spans = [["whole run", begin, end], *([f"move {i + 1}", *pair] for i, pair in enumerate(ends))]
    drawn_already = {name: draw(run) for name, _, draw in IN_THE_PLACE}
    moves = [
        dict(outcome=move["outcome"], cells=[format_value(move[name], factor) for name, _, _, factor in MOVE_FIGURES])
        for move in figures["moves"]
    ]
    remarks = figures["notes"]
    rows = [
        shown_row(label, values[name], unit, factor) | dict(remark=remarks.get(name, ""))
        for values, names in ((figures["run"], RUN_FIGURES), (figures, COMMON_FIGURES))
        for name, label, unit, factor in names
    ]
    return render_interactive(
        "inchworm.html.j2",
        inchworm_charts(run),
        {"whole": [begin, end], "spans": spans, "runs": []},
        drawn_already,
        title=title,
        spans=spans,
        headings=[(label, unit) for _, label, unit, _ in MOVE_FIGURES],
        moves=moves,
        rows=rows,
        plots=[dict(caption=caption, source=data_uri(draw(run))) for caption, draw in INCHWORM_PLOTS],
        notes=remarks["recording"],
        configuration=recording.configuration,
        origin=origin(recording),
        judged=sampling_text(recording),
    )


def write_inchworm_report(recording: Recording, path, title: str, figures: dict | None = None) -> None:
    """Write the report; see :func:`render_inchworm_report`."""
    write_page(path, render_inchworm_report(recording, title, figures))
