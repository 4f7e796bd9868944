# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Results of the demonstration: a triangle without and with the inverse of the hysteresis, and steps."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.analysis.plots import new_figure
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.loops import loop_opening, turning_points

_MICRO = 1e6
_COLOURS = "#d1495b", "#1f3b73"
_MISSED = "#e08e0b"


def opening_of_stroke(run: Recording) -> float:
    """Return the width of the loop of displacement over reference, as a fraction of the stroke of the reference."""
    opening = loop_opening(run["reference"], run["displacement"]) or 0.0
    return opening / float(np.ptp(run["reference"]))


def message(here, alone, skipped, live: bool) -> list[str]:
    """Return the results as sentences: first those of the method (offline), then those of the runs on this machine."""
    without, inverse = (f"{100.0 * part:.2g} %" for part in alone)
    said = [
        f"The hysteresis loop is {without} of the stroke wide without the inverse of the hysteresis, {inverse} with it "
        f"(offline, where no deadline is missed)."
    ]
    if not live:
        return [*said, f"In lockstep, as run here: {100.0 * here[0]:.2g} % and {100.0 * here[1]:.2g} %."]
    if not any(skipped):
        return [*said, "This machine skipped no sample of either run: the results in real time, at 3 kHz, are equal."]
    return [
        *said,
        f"This machine skipped {skipped[0]:.2g} % and {skipped[1]:.2g} % of the samples of the two runs: "
        f"{100.0 * here[0]:.2g} % without the inverse, {100.0 * here[1]:.2g} % with it.",
    ]


def inverse_figure(without: Recording, with_inverse: Recording, *here: Recording):
    """Return the figures of displacement over reference and of error over reference, for all runs [µm].

    The first branch is omitted, because it starts at rest and belongs to no loop.
    """
    figure, (loop, error) = new_figure(4.4, 2)
    marked = False
    runs = zip((without, with_inverse), here or (None, None), _COLOURS, ("without", "with"), strict=True)
    for run, made, colour, words in runs:
        first = int(turning_points(run["reference"])[1])
        reference, displacement = run["reference"][first:] * _MICRO, run["displacement"][first:] * _MICRO
        label = f"{words} inverse: loop width {100.0 * opening_of_stroke(run):.2g} % of the stroke"
        loop.plot(reference, displacement, color=colour, linewidth=1.3, label=label)
        error.plot(reference, displacement - reference, color=colour, linewidth=1.3)
        missed = np.flatnonzero(made["skipped"][first:]) + first if made is not None else np.zeros(0, dtype=int)
        if made is not None and missed.size:
            x, y = made["reference"][missed] * _MICRO, made["displacement"][missed] * _MICRO
            style = dict(color=_MISSED, marker="x", markersize=5, linewidth=0.0, zorder=4)
            loop.plot(x, y, label=None if marked else "samples skipped by this machine", **style)
            error.plot(x, y - x, **style)
            marked = True
    loop.plot(loop.get_xlim(), loop.get_xlim(), color="#9a9a9a", linestyle=(0, (4, 3)), linewidth=0.9, zorder=1)
    error.axhline(0.0, color="#9a9a9a", linestyle=(0, (4, 3)), linewidth=0.9, zorder=1)
    loop.set(xlabel="reference [µm]", ylabel="displacement [µm]")
    error.set(xlabel="reference [µm]", ylabel="displacement − reference [µm]")
    loop.legend(loc="upper left", frameon=False, fontsize=9)
    return figure
