# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Report pages: self-contained HTML files, including the data that their scripts draw."""

from __future__ import annotations

import base64
import json
import pathlib
import sys
import time
from collections.abc import Sequence
from importlib import resources

import numpy as np

from hysteresis_ros.analysis.plots import COLOURS, Chart, envelope, thin, thin_path
from hysteresis_ros.errors import MissingExtraError, RecordingError
from hysteresis_ros.files import write_text
from hysteresis_ros.recordings.dataset import Recording

#: Suffixes of pages.
PAGES = (".html", ".htm")


def render_page(template: str, **values) -> str:
    """Return the page made from a template of this package with ``values``."""
    try:
        import jinja2
    except ImportError:
        raise MissingExtraError("Jinja2") from None
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("hysteresis_ros.analysis"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    # an import of the package would be circular, because the package imports this module
    version = sys.modules[__name__.partition(".")[0]].__version__
    made = f"hysteresis_ros {version}, {_date(time.time())}"
    return environment.get_template(template).render(made=made, colours=COLOURS, **values)


def asset(name: str) -> str:
    """Return the text of a file that pages embed."""
    return (resources.files("hysteresis_ros.analysis") / "assets" / name).read_text(encoding="utf-8")


def _date(seconds: float) -> str:
    """Return a Unix time as text."""
    return time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(seconds))


def origin(recording: Recording) -> str:
    """Return the origin of a run: axis, file, and time of the recording."""
    said = [
        f"Axis in namespace {recording.metadata.get('namespace') or '/'}",
        str(recording.metadata.get("source", "")),
    ]
    recorded = recording.metadata.get("recorded_ns")
    said.append(f"recorded {_date(1e-9 * recorded)}" if recorded else "")
    return " · ".join(filter(None, said))


def require_page(path) -> None:
    """Raise RecordingError if the suffix is neither ``.html`` nor ``.htm``, or if the folder does not exist."""
    suffix = pathlib.Path(path).suffix
    if suffix.lower() not in PAGES:
        raise RecordingError(f"{path}: unknown kind of report '{suffix}'; give the name of an .html file")
    if not pathlib.Path(path).absolute().parent.is_dir():
        raise RecordingError(f"{path}: cannot be written: the folder does not exist; choose another one")


def write_page(path, html: str) -> None:
    """Write a page completely or not at all."""
    require_page(path)
    write_text(path, html, RecordingError)


#: Maximum number of points of the time axis that all charts over time share.
TIME_POINTS = 12000
#: Maximum number of points of any other line, except that a path has up to twice as many.
LINE_POINTS = 4000


def packed(values, kind: str = "<f4") -> str:
    """Return an array as text: little-endian floats in base64."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")


def chart_payload(charts: Sequence[Chart], points: int = TIME_POINTS) -> dict:
    """Return charts as data for the page.

    Charts over time share one thinned time axis; every other line has an x of its own.
    """
    over_time = [line for chart in charts if chart.kind == "time" for line in chart.lines]
    # float32 (7 digits) suffices for a drawn value, but not for a late time
    time, columns, size = thin(over_time[0].x, [line.y for line in over_time], points) if over_time else ([], [], 1)
    kept = iter(columns)
    return {
        "time": packed(time, "<f8"),
        "samples": size,
        "charts": [_chart(chart, kept, min(LINE_POINTS, points // 3)) for chart in charts],
    }


def _chart(chart: Chart, columns, points: int) -> dict:
    lines = []
    for line in chart.lines:
        described: dict = {"label": line.label, "colour": line.colour, "width": line.width, "dash": list(line.dash)}
        described["dots"] = line.dots
        if chart.kind == "time":
            described["y"] = packed(next(columns))
        elif chart.kind == "path":
            path = thin_path(line, 2 * points)
            described |= {"x": packed(path.x), "y": packed(path.y)}
            if path.key is not None:
                described["key"] = packed(path.key)
        else:
            x, y = (line.x, line.y) if line.x.size <= points else envelope(line.x, line.y, points)
            described |= {"x": packed(x, "<f8"), "y": packed(y)}
        lines.append(described)
    return {
        "name": chart.name,
        "kind": chart.kind,
        "across": chart.across,
        "up": chart.up,
        "logarithmic": chart.logarithmic,
        "levels": list(chart.levels),
        "shaded": None if chart.shaded is None else [float(end) for end in chart.shaded],
        "marked": [] if chart.marked is None else chart.marked.tolist(),
        "limits": None if chart.limits is None else [float(end) for end in chart.limits],
        "lines": lines,
    }


def script_text(payload: dict) -> str:
    """Return JSON for a script element, escaped so that no text can end the element."""
    text = json.dumps(payload, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
