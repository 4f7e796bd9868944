# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The page of a commissioning: every stage with its findings and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from hysteresis_ros import __version__
from hysteresis_ros.analysis.page import render_page, write_page
from hysteresis_ros.analysis.pictures import Picture, picture_figure
from hysteresis_ros.analysis.plots import data_uri


class Found(Protocol):
    """What a stage found, as far as the page shows it."""

    lines: list[str]
    figures: dict
    pictures: list[Picture]
    seconds: float


def write_commissioning_report(path, source: str, found: Mapping[str, Found], titles: Mapping[str, str]) -> None:
    """Write the page: one HTML file that needs nothing beside it.

    Parameters
    ----------
    path : path-like
        HTML file.
    source : str
        The parameter file that was commissioned.
    found : mapping of str to Found
        By the names of the stages, in their order.
    titles : mapping of str to str
        A few words for each stage.

    Raises
    ------
    MissingExtraError
        Matplotlib or Jinja2 is not installed.
    RecordingError
        The file cannot be written.
    """
    stages = [
        dict(
            name=name,
            title=titles[name],
            seconds=f"{outcome.seconds:.3g} s" if outcome.seconds else "nothing moved",
            lines=outcome.lines,
            plots=[dict(caption=one.caption, source=data_uri(picture_figure(one))) for one in outcome.pictures],
        )
        for name, outcome in found.items()
    ]
    html = render_page(
        "commissioning.html.j2",
        title=f"Commissioning of {source}",
        version=__version__,
        stages=stages,
        seconds=f"{sum(outcome.seconds for outcome in found.values()):.3g}",
    )
    write_page(path, html)
