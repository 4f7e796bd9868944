# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The report of a run: one HTML file that needs nothing beside it."""

from __future__ import annotations

import os
import pathlib
import sys
import time
from collections.abc import Sequence

from hysteresis_ros.analysis.learning_plots import periods_figure
from hysteresis_ros.analysis.metrics import FIGURES, compute_metrics, shown_row
from hysteresis_ros.analysis.plots import ADAPTED, MissingExtraError, data_uri
from hysteresis_ros.analysis.plots import FIGURES as PLOTS
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.dataset import Recording

#: Caption and figure of a run that learned.
LEARNED = ("Error of each period that was learned (undelayed reference − displacement)", periods_figure)
#: Endings of the names of pages.
PAGES = (".html", ".htm")


def render_page(template: str, **values) -> str:
    """Return the page that a template of this package gives with ``values``.

    Raises
    ------
    MissingExtraError
        Jinja2 is not installed.
    """
    try:
        import jinja2
    except ImportError:
        raise MissingExtraError("Jinja2") from None
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("hysteresis_ros.analysis"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    # not imported: the package imports this module
    version = sys.modules[__name__.partition(".")[0]].__version__
    made = f"hysteresis_ros {version}, {_date(time.time())}"
    return environment.get_template(template).render(made=made, **values)


def _date(seconds: float) -> str:
    """Return an instant of the clock in words."""
    return time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(seconds))


def origin(recording: Recording) -> str:
    """Return where a run comes from: its axis, what it is stored in, and when it was recorded.

    Parameters
    ----------
    recording : Recording
    """
    said = [
        f"Axis in namespace {recording.metadata.get('namespace') or '/'}",
        str(recording.metadata.get("source", "")),
    ]
    recorded = recording.metadata.get("recorded_ns")
    said.append(f"recorded {_date(1e-9 * recorded)}" if recorded else "")
    return " · ".join(filter(None, said))


def require_page(path) -> None:
    """Raise RecordingError for a file whose name is not that of a page, or whose folder is not there."""
    suffix = pathlib.Path(path).suffix
    if suffix.lower() not in PAGES:
        raise RecordingError(f"{path}: unknown kind of report '{suffix}'; give the name of an .html file")
    if not pathlib.Path(path).absolute().parent.is_dir():
        raise RecordingError(f"{path}: cannot be written: there is no such folder; choose another place")


def write_page(path, html: str) -> None:
    """Write a page whole or not at all.

    Raises
    ------
    RecordingError
        The file cannot be written, or its name is not that of a page.
    """
    require_page(path)
    path = pathlib.Path(path)
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_text(html, encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}; choose another place") from None


def render_report(
    recording: Recording, title: str, figures: dict | None = None, first: Sequence[tuple[str, str]] = ()
) -> str:
    """Return the report as HTML: table of figures, plots, notes and configuration.

    Parameters
    ----------
    recording : Recording
        The run.
    title : str
        Heading, such as the name of the bag.
    figures : dict, optional
        What :func:`hysteresis_ros.analysis.metrics.compute_metrics` gave, when it is known already.
    first : sequence of (str, str)
        Further pictures before those of the run: caption, and :func:`hysteresis_ros.analysis.plots.data_uri`.

    Raises
    ------
    HysteresisError
        Matplotlib or Jinja2 is missing (the message says how to install them), or there is nothing to compare.
    """
    figures = figures or compute_metrics(recording)
    rows = [
        shown_row(label, figures[name], unit, factor) | dict(remark=figures["notes"].get(name, ""))
        for name, label, unit, factor in FIGURES
    ]
    drawn = [(caption, draw(recording)) for caption, draw in (*PLOTS, ADAPTED, LEARNED)]
    pictures = [*first, *((caption, data_uri(figure)) for caption, figure in drawn if figure is not None)]
    return render_page(
        "report.html.j2",
        title=title,
        rows=rows,
        plots=[dict(caption=caption, source=source) for caption, source in pictures],
        notes=figures["notes"]["recording"],
        configuration=recording.configuration,
        origin=origin(recording),
    )


def write_report(
    recording: Recording, path, title: str, figures: dict | None = None, first: Sequence[tuple[str, str]] = ()
) -> None:
    """Write the report; see :func:`render_report`.

    Raises
    ------
    RecordingError
        The file cannot be written.
    """
    write_page(path, render_report(recording, title, figures, first))
