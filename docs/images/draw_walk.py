# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Draw docs/images/walk.png, continuous walking before and after learning: ``python docs/images/draw_walk.py``."""

from __future__ import annotations

import pathlib

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hysteresis_ros.laboratory.papers.kim2009.walking import SPEED, Walker
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references.inchworm_walk import carried

BLUE, RED, GREY = "#1f6f8b", "#d1495b", "#444444"
PARTS = (0.2, 1.0, 2.0)


def cycle(walker: Walker, speed: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return phase, path and slider [m] of a cycle from where the slider stands, between the samples."""
    walker.walk(speed, 4.0)
    phase, slider = walker.walk(speed, 2.2)
    walk, bounds = walker.sequencer.parameters.walk, walker.sequencer.p[at.FORWARD_BOUNDS :]
    number = np.floor(phase)
    shown = number == number[0] + 1
    phase, slider = phase[shown] - number[shown], slider[shown]
    part = (phase - bounds[at.CARRY]) / (bounds[at.CARRIED] - bounds[at.CARRY])
    path = walk.step * np.array([carried(walk.blend, value) for value in part])
    return phase, path, slider - np.mean(slider[phase < bounds[at.CLOSE_FRONT]])


def main() -> None:
    """Draw."""
    walker = Walker(seed=3, kick=1.0e-9)
    for _ in range(100):
        walker.sample()
    before = [cycle(walker, part * SPEED) for part in PARTS]
    walker.learn()
    after = [cycle(walker, part * SPEED) for part in PARTS]
    figure = Figure(figsize=(9.0, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplot_mosaic([["path", "path", "path"], [*map(str, PARTS)]], height_ratios=(1.0, 1.4))
    bounds = walker.sequencer.p[at.FORWARD_BOUNDS : at.FORWARD_BOUNDS + 8]
    path = grid["path"]
    path.plot(before[1][0], before[1][1] * 1e6, color=GREY, ls=(0, (5, 3)), lw=1.4, label="path")
    path.plot(before[1][0], before[1][2] * 1e6, color=RED, lw=1.4, label="slider, before learning")
    path.set_ylabel("slider [µm]")
    path.legend(frameon=False, fontsize=8, loc="upper left")
    names = ("returns", "", "front closes", "rear opens", "carries", "", "rear closes", "front opens", "returns")
    edges = [0.0, *bounds, 1.0]
    for name, first, last in zip(names, edges, edges[1:], strict=False):
        path.text(0.5 * (first + last), 1.02, name, transform=path.get_xaxis_transform(), ha="center", fontsize=7)
    for part, one, other in zip(PARTS, before, after, strict=True):
        axes = grid[str(part)]
        for (phase, wanted, slider), color, label in ((one, RED, "before"), (other, BLUE, "after learning")):
            off = (slider - wanted) * 1e9
            axes.plot(phase, off, color=color, lw=1.1, label=f"{label}: {np.sqrt(np.mean(off**2)):.1f} nm RMS")
        axes.set_title(f"{part * SPEED * 1e6:g} µm/s" + (", where it learned" if part == 1.0 else ""), fontsize=9)
        axes.set_xlabel("phase of the cycle")
        axes.legend(frameon=False, fontsize=8, loc="lower left")
        axes.set_ylim(-320.0, 100.0)
    grid[str(PARTS[0])].set_ylabel("off the path [nm]")
    for axes in grid.values():
        axes.set_xlim(0.0, 1.0)
        for edge in bounds:
            axes.axvline(edge, color="0.88", lw=0.8, zorder=0)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(pathlib.Path(__file__).with_name("walk.png"), dpi=110)


if __name__ == "__main__":
    main()
