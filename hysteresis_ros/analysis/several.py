# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Several runs judged side by side, of actuators or of inchworm motors."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

from hysteresis_ros.analysis.inchworm_moves import is_inchworm
from hysteresis_ros.analysis.motors_side_by_side import compare_motors, format_motors, render_motors
from hysteresis_ros.analysis.page import write_page
from hysteresis_ros.analysis.side_by_side import compare_runs, format_runs, render_side_by_side
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.dataset import Recording


class Kind(NamedTuple):
    """How runs of a kind are judged together.

    Parameters
    ----------
    judge : callable
        ``judge(runs)`` returns the figures of each.
    table : callable
        ``table(figures)`` returns lines for a terminal.
    render : callable
        ``render(runs, title, figures)`` returns a page.
    """

    judge: Callable[..., dict[str, dict]]
    table: Callable[..., str]
    render: Callable[..., str]


def labels_of(paths: Sequence[str | os.PathLike[str]]) -> dict[str, pathlib.Path]:
    """Return a name for each recording: that of its file, or as much of its path as tells it from the others.

    Parameters
    ----------
    paths : sequence of path-like

    Raises
    ------
    RecordingError
        One is given twice.
    """
    whole = [pathlib.Path(path).resolve() for path in paths]
    if len(set(whole)) < len(whole):
        again = next(path for path, full in zip(paths, whole, strict=True) if whole.count(full) > 1)
        raise RecordingError(f"{again} is given more than once")
    for parts in range(1, max((len(path.parts) for path in whole), default=1) + 1):
        labels = ["/".join(path.parts[-parts:]) for path in whole]
        if len(set(labels)) == len(labels):
            break
    return dict(zip(labels, map(pathlib.Path, paths), strict=True))


def kind_of(runs: dict[str, Recording]) -> Kind:
    """Return how runs are judged together.

    Parameters
    ----------
    runs : dict of str to Recording
        Label and run.

    Raises
    ------
    RecordingError
        Some are runs of an inchworm, which is judged by its moves, and others are not.
    """
    motors = [name for name, run in runs.items() if is_inchworm(run)]
    others = [name for name in runs if name not in motors]
    if motors and others:
        raise RecordingError(
            f"{motors[0]} is a run of an inchworm, which is judged by its moves, and {others[0]} is none: "
            "report runs of one kind together"
        )
    if motors:
        return Kind(compare_motors, format_motors, render_motors)
    return Kind(compare_runs, format_runs, render_side_by_side)


def report_several(runs: dict[str, Recording], path=None, title: str | None = None) -> tuple[dict[str, dict], str]:
    """Judge runs side by side, and write a page of them; return the figures of each, and lines for a terminal.

    Parameters
    ----------
    runs : dict of str to Recording
        Label and run.
    path : path-like, optional
        HTML file.
    title : str, optional
        Heading; by default the labels.

    Raises
    ------
    HysteresisError
        There are no runs, one cannot be judged, or the page not be written.
    """
    if not runs:
        raise RecordingError("there is no run to report: give at least one")
    kind = kind_of(runs)
    figures = kind.judge(runs)
    if path is not None:
        write_page(path, kind.render(runs, title or " · ".join(runs), figures))
    return figures, kind.table(figures)
