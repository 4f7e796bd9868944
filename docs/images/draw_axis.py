# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Draw docs/images/axis.png, an axis and a recorded run of it: ``python docs/images/draw_axis.py demo/bag``."""

from __future__ import annotations

import pathlib
import sys

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run

BOXES = {
    "reference_\ngenerator": 0.9,
    "motion_\ncontroller": 3.3,
    "hysteresis_\ncompensator": 5.7,
    "plant_simulator\nor your driver": 8.1,
}
ARROWS = (("setpoint", -0.55, 0.2), ("reference", 1.65, 2.55), ("command", 4.05, 4.95), ("voltage", 6.45, 7.35))
WIDTH, HEIGHT, LEVEL = 1.5, 0.7, 1.0
INK, SOFT = "#1f3044", "#dbe7f3"


def draw_graph(axes) -> None:
    """Draw the four nodes and their topics."""
    axes.set_xlim(-0.8, 9.1)
    axes.set_ylim(-0.2, 1.7)
    axes.axis("off")
    for text, x in BOXES.items():
        corner = (x - WIDTH / 2, LEVEL - HEIGHT / 2)
        axes.add_patch(FancyBboxPatch(corner, WIDTH, HEIGHT, boxstyle="round,pad=0.02", fc=SOFT, ec=INK, lw=1.2))
        axes.text(x, LEVEL, text, ha="center", va="center", color=INK, fontsize=10)
    style = {"arrowstyle": "-|>", "color": INK, "lw": 1.2}
    for topic, start, end in ARROWS:
        axes.annotate("", (end, LEVEL + 0.1), (start, LEVEL + 0.1), arrowprops=style)
        axes.text((start + end) / 2, LEVEL + 0.2, topic, ha="center", fontsize=9, color=INK)
    axes.annotate("", (4.05, LEVEL - 0.15), (4.95, LEVEL - 0.15), arrowprops=style)
    axes.text(4.5, LEVEL - 0.34, "applied", ha="center", fontsize=9, color=INK)
    axes.plot([8.1, 8.1], [LEVEL - HEIGHT / 2, 0.15], color=INK, lw=1.2)
    axes.plot([0.9, 8.1], [0.15, 0.15], color=INK, lw=1.2)
    for x in (0.9, 3.3, 5.7):
        axes.annotate("", (x, LEVEL - HEIGHT / 2 - 0.02), (x, 0.14), arrowprops=style)
    axes.text(4.5, -0.08, "joint_states (the stamp is the key of the sample)", ha="center", fontsize=9, color=INK)


def draw_run(left, right, run) -> None:
    """Draw displacement and loop of a recorded run."""
    micro = 1e6
    left.step(run.time, run["reference"] * micro, where="post", color="#c2571a", lw=1.2, label="reference")
    left.plot(run.time, run["displacement"] * micro, color="#22639c", lw=1.2, label="displacement")
    left.set_xlabel("time [s]")
    left.set_ylabel("displacement [µm]")
    left.legend(frameon=False, fontsize=9)
    right.plot(run["voltage"], run["displacement"] * micro, color="#22639c", lw=0.9)
    right.set_xlabel("voltage [V]")
    right.set_ylabel("displacement [µm]")
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.3)


def moved_part(run: Recording, before: float, after: float) -> Recording:
    """Return the part of a run with setpoints; its time begins at zero.

    Units: ``before`` [s], ``after`` [s].
    """
    starts = np.flatnonzero(np.diff(run["setpoint"])) + 1
    begin = max(int(starts[0]) - round(before / run.sample_time), 0)
    stops = [change["sample"] for change in run.metadata.get("changes", ())]
    part = slice(begin, min(*stops, int(starts[-1]) + round(after / run.sample_time), run.time.size))
    signals = {name: values[part] for name, values in run.signals.items()}
    return Recording(run.time[part] - run.time[begin], signals, run.units, run.metadata)


def main(bag: str) -> None:
    """Draw the picture beside this script."""
    figure = Figure(figsize=(9.5, 5.6), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplot_mosaic(
        [["graph", "graph"], ["time", "loop"]], height_ratios=[1.0, 1.6], width_ratios=[1.7, 1]
    )
    draw_graph(axes["graph"])
    draw_run(axes["time"], axes["loop"], moved_part(load_run(bag), before=0.05, after=0.2))
    axes["time"].set_title("make demo: setpoints on a topic, 3 kHz in real time", fontsize=10, loc="left")
    axes["loop"].set_title("the loop that is compensated", fontsize=10, loc="left")
    figure.savefig(pathlib.Path(__file__).with_name("axis.png"), dpi=120)


if __name__ == "__main__":
    main(sys.argv[1])
