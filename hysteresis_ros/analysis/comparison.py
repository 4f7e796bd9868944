"""Plots and page of several runs side by side, and of claims beside what was found."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.analysis.plots import data_uri, envelope, new_figure
from hysteresis_ros.analysis.report import render_page, write_page
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.loops import loop_opening

_MICRO = 1e6
_REFERENCE = "#222222"
#: Colours of the runs in order: the first one, usually the worst, stays in the background.
_COLOURS = ("#b8b8b8", "#d1495b", "#1f6fb2", "#2a9d8f", "#e09f3e")


def traces_comparison(runs: dict[str, Recording], window: tuple[float, float]):
    """Return the figure of the displacements of several runs of one reference [µm, s]: whole, and a part of it.

    Parameters
    ----------
    runs : dict of str to Recording
        Label and run; the reference is that of the first one.
    window : (float, float)
        Beginning and end of the part shown larger [s].
    """
    figure, axes = new_figure(3.8, 2)
    first = next(iter(runs.values()))
    for axis, (start, stop) in zip(axes, ((first.time[0], first.time[-1]), window), strict=True):
        for (label, run), colour in zip(runs.items(), _COLOURS, strict=False):
            shown = (run.time >= start) & (run.time <= stop)
            time, values = envelope(run.time[shown], run["displacement"][shown] * _MICRO)
            axis.plot(time, values, color=colour, linewidth=1.3, label=label)
        shown = (first.time >= start) & (first.time <= stop)
        line = dict(color=_REFERENCE, linewidth=1.0, linestyle=(0, (4, 3)), label="reference", drawstyle="steps-post")
        axis.plot(first.time[shown], first["reference"][shown] * _MICRO, **line)
        axis.set(xlabel="time [s]", ylabel="displacement [µm]", xlim=(start, stop))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=4, frameon=False, fontsize=9)
    return figure


def loops_comparison(loops: dict[str, tuple[np.ndarray, np.ndarray]]):
    """Return the figure of loops beside each other [µm]; each title says how far its loop is open.

    Parameters
    ----------
    loops : dict of str to (array, array)
        Label; reference and displacement, shape (N,) each [m].
    """
    figure, axes = new_figure(4.4, len(loops))
    for axis, (label, (reference, displacement)), colour in zip(axes, loops.items(), _COLOURS[1:], strict=False):
        low, high = np.min(reference) * _MICRO, np.max(reference) * _MICRO
        axis.plot([low, high], [low, high], color=_REFERENCE, linewidth=0.8, linestyle=(0, (4, 3)))
        axis.plot(reference * _MICRO, displacement * _MICRO, color=colour, linewidth=1.2)
        opening = loop_opening(reference, displacement)
        width = "no loop" if opening is None else f"{100.0 * opening / np.ptp(reference):.3g} % of stroke"
        axis.set_title(f"{label}: {width}", fontsize=11)
        axis.set(xlabel="reference [µm]", ylabel="displacement [µm]")
    return figure


def write_claims_page(
    path, title: str, *, summary: str, headings, groups, remarks, assumptions, plots, configuration: str = ""
) -> None:
    """Write a page with a table of claims, plots, remarks and assumptions that needs nothing beside it.

    Parameters
    ----------
    path : path-like
        HTML file.
    title, summary : str
        Heading, and the result in one line.
    headings : sequence of str
        Heads of the columns.
    groups : dict of str to list of (sequence of str, bool or None)
        Heading of a group → the cells of its rows, and whether the claim of each row holds.
    remarks, assumptions : sequence of str
        Shown below; assumptions are numbered from 1.
    plots : sequence of (str, figure)
        Captions and figures.
    configuration : str
        Text of the configuration, shown at the end.

    Raises
    ------
    MissingExtraError
        Matplotlib or Jinja2 is not installed.
    RecordingError
        The file cannot be written.
    """
    html = render_page(
        "claims.html.j2",
        title=title,
        summary=summary,
        headings=headings,
        groups=groups,
        remarks=remarks,
        assumptions=assumptions,
        plots=[dict(caption=caption, source=data_uri(figure)) for caption, figure in plots],
        configuration=configuration,
    )
    write_page(path, html)
