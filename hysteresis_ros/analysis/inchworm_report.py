# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The report of an inchworm's run: one HTML file that needs nothing beside it."""

from __future__ import annotations

from hysteresis_ros.analysis.inchworm import (
    COMMON_FIGURES,
    MOVE_FIGURES,
    RUN_FIGURES,
    inchworm_figures,
)
from hysteresis_ros.analysis.inchworm_moves import inchworm_run
from hysteresis_ros.analysis.inchworm_plots import IN_THE_PLACE, INCHWORM_PLOTS, inchworm_charts
from hysteresis_ros.analysis.page import origin, write_page
from hysteresis_ros.analysis.plots import data_uri
from hysteresis_ros.analysis.report import render_interactive, sampling_text
from hysteresis_ros.analysis.shown_figures import format_value, shown_row
from hysteresis_ros.recordings.dataset import Recording


def render_inchworm_report(recording: Recording, title: str, figures: dict | None = None) -> str:
    """Return the report as HTML: a table of moves, figures of the run, plots, notes and configuration.

    Parameters
    ----------
    recording : Recording
        The run.
    title : str
        Heading, such as the name of the bag.
    figures : dict, optional
        What :func:`hysteresis_ros.analysis.inchworm.inchworm_figures` gave, when it is known already.

    Raises
    ------
    HysteresisError
        Matplotlib or Jinja2 is missing, or the recording lacks signals; the message says which.
    """
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
    """Write the report; see :func:`render_inchworm_report`.

    Raises
    ------
    RecordingError
        The file cannot be written.
    """
    write_page(path, render_inchworm_report(recording, title, figures))
