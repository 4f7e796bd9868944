# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Draw docs/images/scans.png, a frame of each scan of docs/scans.md: ``python docs/images/draw_scans.py``."""

from __future__ import annotations

import pathlib

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hysteresis_ros.references.scans import scan_of

INK, GREY = "#1f3b73", "#b0b0b0"
#: Of each panel: title, scan and its parameters [m].
PANELS = (
    ("raster, trace_retrace", "raster", dict(width=80e-6, depth=80e-6, lines=16, flyback=2)),
    ("raster, bidirectional", "raster", dict(width=80e-6, depth=80e-6, lines=16, flyback=2, pattern="bidirectional")),
    ("spiral, cav", "spiral", dict(diameter=80e-6, turns=12)),
    ("lissajous", "lissajous", dict(width=80e-6, depth=80e-6, lines=24)),
    ("cycloid", "cycloid", dict(width=80e-6, diameter=40e-6, lines=16)),
    ("rosette", "rosette", dict(diameter=80e-6, lines=25)),
)
POINTS = 20_000


def main() -> None:
    """Draw one frame of each; turns and flyback are grey."""
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (title, kind, parameters) in zip(figure.subplots(2, 3).ravel(), PANELS, strict=True):
        scan = scan_of(kind, parameters)
        time = np.linspace(0.0, scan.frame_time, POINTS)
        x, y = scan.position(time) * 1e6
        on = scan.clock(time).line >= 0
        axes.plot(x, y, color=GREY, lw=0.8)
        axes.plot(np.where(on, x, np.nan), np.where(on, y, np.nan), color=INK, lw=0.9)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(title, fontsize=10)
        axes.set(xlabel="x [µm]", ylabel="y [µm]")
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(pathlib.Path(__file__).with_name("scans.png"), dpi=110)


if __name__ == "__main__":
    main()
