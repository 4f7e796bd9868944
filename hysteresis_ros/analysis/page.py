# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Pages: one HTML file each, which needs nothing beside it."""

from __future__ import annotations

import pathlib
import sys
import time
from importlib import resources

from hysteresis_ros.analysis.charts import COLOURS
from hysteresis_ros.analysis.plots import MissingExtraError
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.files import write_text
from hysteresis_ros.recordings.dataset import Recording

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
    return environment.get_template(template).render(made=made, colours=COLOURS, **values)


def asset(name: str) -> str:
    """Return the text of a file that pages carry in themselves.

    Parameters
    ----------
    name : str
        In ``analysis/assets``.
    """
    return (resources.files("hysteresis_ros.analysis") / "assets" / name).read_text(encoding="utf-8")


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

    Parameters
    ----------
    path : path-like
        HTML file.
    html : str
        What :func:`render_page` gave.

    Raises
    ------
    RecordingError
        The file cannot be written, or its name is not that of a page.
    """
    require_page(path)
    write_text(path, html, RecordingError)
