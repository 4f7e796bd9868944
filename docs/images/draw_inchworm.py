# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Draw docs/images/inchworm.png, a walk of 5 mm: ``python docs/images/draw_inchworm.py run.npz``.

The run is that of ``hysteresis simulate inchworm_travel -o run.npz``.
"""

from __future__ import annotations

import pathlib
import sys

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hysteresis_ros.analysis.inchworm import InchwormRun, inchworm_run
from hysteresis_ros.analysis.inchworm_report import draw_activities, draw_phases, draw_steps, steps_window
from hysteresis_ros.recordings.files import load_run

ORANGE, BLUE, RED, GREY = "#c2571a", "#1f6f8b", "#d1495b", "#444444"
#: Time shown around the arrival [s].
BEFORE, AFTER = 0.02, 0.1


def draw_travel(axes, run: InchwormRun) -> None:
    """Draw setpoint and slider over the whole run."""
    draw_activities(axes, run)
    wanted = axes.step(run.time, run.setpoint * 1e3, where="post", color=GREY, ls=(0, (5, 3)), lw=1.2)
    slider = axes.plot(run.time[::50], run.slider[::50] * 1e3, color=RED, lw=1.8)
    axes.set_xlim(run.time[0], run.time[-1])
    axes.set_xlabel("time [s]")
    axes.set_ylabel("position [mm]")
    axes.legend([*wanted, *slider], ["setpoint", "slider"], frameon=False, fontsize=8, loc="upper left", borderpad=1.4)


def draw_gait(positions, voltages, run: InchwormRun) -> None:
    """Draw three steps: where slider and extender are, and the voltages."""
    shown = steps_window(run)
    time = (run.time[shown] - run.time[shown.start]) * 1e3
    for axes in (positions, voltages):
        draw_phases(axes, run, shown, labels=axes is positions)
        axes.set_xlim(time[0], time[-1])
    draw_steps(positions, run, shown)
    positions.legend(loc="upper left", frameon=False, fontsize=8)
    positions.tick_params(labelbottom=False)
    voltages.plot(time, run.signals["front_voltage"][shown], color=ORANGE, lw=1.3, label="front clamp")
    voltages.plot(time, run.signals["rear_voltage"][shown], color="#6a4c93", lw=1.3, label="rear clamp")
    voltages.plot(time, run.signals["voltage"][shown], color=BLUE, lw=1.3, label="extender")
    voltages.legend(loc="lower left", bbox_to_anchor=(0.0, 0.97), frameon=False, fontsize=8, ncols=3, columnspacing=1.0)
    voltages.set_xlabel(f"time since {run.time[shown.start]:.4g} s [ms]")
    voltages.set_ylabel("voltage [V]")


def draw_end(axes, run: InchwormRun) -> None:
    """Draw the last nanometres of the last move."""
    move = [move for move in run.moves if move.arrival is not None][-1]
    time = (run.time - run.time[move.arrival]) * 1e3
    part = slice(*np.searchsorted(time, (-1e3 * BEFORE, 1e3 * AFTER)))
    axes.plot(time[part], (run.slider[part] - move.goal) * 1e9, color=RED, lw=1.2)
    for level in (-run.tolerance, run.tolerance):
        axes.axhline(level * 1e9, color=GREY, lw=0.9, ls=(0, (5, 3)))
    axes.set_ylim(-30.0, 30.0)
    axes.set_xlim(-1e3 * BEFORE, 1e3 * AFTER)
    axes.set_xlabel("time since arrival [ms]")
    axes.set_ylabel("slider − setpoint [nm]")


def main(path: str) -> None:
    """Draw the picture beside this script."""
    run = inchworm_run(load_run(path))
    figure = Figure(figsize=(9.5, 6.2), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplot_mosaic(
        [["travel", "end"], ["steps", "steps"], ["volts", "volts"]],
        height_ratios=[1.5, 1.0, 0.9],
        width_ratios=[1.5, 1.0],
    )
    draw_travel(axes["travel"], run)
    draw_gait(axes["steps"], axes["volts"], run)
    draw_end(axes["end"], run)
    stroke = "" if run.gait is None else f" of {run.gait.stroke * 1e6:.3g} µm"
    axes["travel"].set_title(
        f"{len(run.steps.index)} steps (blue), then fine positioning (green)", fontsize=10, loc="left"
    )
    axes["steps"].set_title(f"three of the steps{stroke}, and their phases", fontsize=10, loc="left", pad=20)
    axes["end"].set_title("the last nanometres, and the tolerance", fontsize=10, loc="left")
    for one in axes.values():
        one.spines[["top", "right"]].set_visible(False)
        one.grid(alpha=0.3)
    figure.savefig(pathlib.Path(__file__).with_name("inchworm.png"), dpi=110)


if __name__ == "__main__":
    main(sys.argv[1])
