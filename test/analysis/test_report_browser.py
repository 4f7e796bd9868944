# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The report in a browser: a zoom changes the plotted data and its figures, the cursor shows values."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="matplotlib is not installed: no plots")
pytest.importorskip("jinja2", reason="jinja2 is not installed: no pages")

from hysteresis_ros.analysis.metrics import FIGURES, compute_metrics
from hysteresis_ros.analysis.parts import within
from hysteresis_ros.analysis.report import render_report
from hysteresis_ros.analysis.tables import shown
from hysteresis_ros.recordings import Recording

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

#: Actions of a user and the resulting display, written as JSON into the last element of the page.
TRIAL = """
<pre id="seen"></pre>
<script>
  const figure = (name) => document.getElementById("chart-" + name);
  const pixels = (name) => figure(name).querySelector("canvas").toDataURL();
  const words = (place) => place.textContent.replace(/\\s+/g, " ").trim();
  const mouse = (over, kind, x, y) => {
    const box = over.getBoundingClientRect();
    const at = { clientX: box.left + x * box.width, clientY: box.top + y * box.height };
    const target = kind === "mouseup" ? document : over;
    target.dispatchEvent(new MouseEvent(kind, { bubbles: true, view: window, button: 0, movementX: 1, ...at }));
  };
  const soon = () => new Promise((go) => setTimeout(go, 50));
  const column = () => Object.fromEntries(
    [...document.querySelectorAll("tr[data-figure]")].map(
      (row) => [row.dataset.figure, words(row.querySelector(".shown"))])
  );
  (async () => {
    await soon();
    const names = [...document.querySelectorAll("figure.live")].map((one) => one.id.slice(6));
    const seen = { names, before: names.map(pixels), whole: column(), far: times[2].scales.y.max };
    const over = figure("error").querySelector(".u-over");
    mouse(over, "mouseenter", 0.25, 0.5);
    mouse(over, "mousemove", 0.25, 0.5);
    await soon();
    seen.legends = ["traces", "error"].map((name) => words(figure(name).querySelector(".u-legend")));
    const path = figure("loops").querySelector(".u-over");
    for (let x = 0.05; x < 1 && !seen.readout; x += 0.02) {
      mouse(path, "mousemove", x, 0.5);
      seen.readout = words(figure("loops").querySelector(".readout"));
    }
    mouse(over, "mousedown", 0.25, 0.5);
    mouse(over, "mousemove", 0.5, 0.5);
    mouse(over, "mouseup", 0.5, 0.5);
    await soon();
    seen.after = names.map(pixels);
    seen.closer = times[2].scales.y.max;
    seen.zoomed = column();
    seen.ends = [document.getElementById("span-from").value, document.getElementById("span-to").value];
    seen.head = words(document.querySelector(".span-head"));
    seen.command = words(document.getElementById("span-command"));
    document.querySelector("button[data-action=whole]").click();
    await soon();
    seen.back = names.map(pixels);
    seen.images = [...document.querySelectorAll(".live img")].map((one) => getComputedStyle(one).display);
    document.getElementById("seen").textContent = JSON.stringify(seen);
  })();
</script>
</body>
"""


@pytest.fixture(scope="module")
def run() -> Recording:
    time = np.arange(4000) / 1000.0
    reference = 5e-6 * (1.0 - np.cos(2 * np.pi * 2.0 * time))
    displacement = reference - 10e-9 * (1.0 + time) * np.sin(2 * np.pi * 31.0 * time)
    displacement[-1] += 80e-9  # the largest error of the run is in the last block
    columns = {"time": time, "reference": reference, "displacement": displacement, "voltage": 1e7 * reference}
    limits = "/**/hysteresis_compensator:\n  ros__parameters:\n    limits: {minimum: -30.0, maximum: 120.0}\n"
    return Recording.from_columns(columns, {"configuration": limits})


@pytest.fixture(scope="module")
def seen(run, tmp_path_factory) -> dict:
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed")
    folder = tmp_path_factory.mktemp("browser")
    page = folder / "page.html"
    page.write_text(render_report(run, "run").replace("</body>", TRIAL), encoding="utf-8")
    options = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}"]
    options += ["--window-size=1400,1000", "--virtual-time-budget=8000", "--dump-dom"]
    answer = subprocess.run(
        [CHROMIUM, *options, page.as_uri()], capture_output=True, text=True, timeout=180, encoding="utf-8"
    )
    text = re.search(r'<pre id="seen">(.*?)</pre>', answer.stdout, re.S)
    assert text and text.group(1), answer.stderr[-2000:]
    return json.loads(html.unescape(text.group(1)))


def test_every_chart_is_drawn_in_the_place_of_its_picture(seen):
    assert seen["names"] == ["traces", "error", "loops", "trace", "periods", "spectrum", "histogram", "voltage"]
    assert set(seen["images"]) == {"none"}


def test_the_cursor_says_values_in_all_charts_over_time(seen, run):
    traces, error = seen["legends"]
    instant = float(re.search(r"time \[s\]([\d.]+)", error).group(1))
    k = round(instant * 1000.0)
    assert traces.startswith(f"time [s]{instant:.8g}")
    assert float(re.search(r"error(-?[\d.]+)", error).group(1)) == pytest.approx(
        1e9 * (run["reference"][k] - run["displacement"][k]), rel=1e-4
    )
    assert float(re.search(r"reference([\d.]+)", traces).group(1)) == pytest.approx(1e6 * run["reference"][k], rel=1e-4)
    assert re.fullmatch(r"[-\d.]+ → [-\d.]+, at [-\d.]+ s", seen["readout"]), "of a loop"


def test_a_zoom_changes_what_is_drawn_and_its_figures(seen, run):
    changed = {name for name, a, b in zip(seen["names"], seen["before"], seen["after"], strict=True) if a != b}
    assert changed == {"traces", "error", "loops", "voltage"}, "charts over time, and the part of the loop"
    assert seen["back"] == seen["before"]
    assert seen["far"] > 120.0 > seen["closer"], "voltage limits are shown until the user zooms in"
    begin, end = (float(value) for value in seen["ends"])
    assert 0.8 < begin < 1.2 and 1.8 < end < 2.2
    first, last = (float(value) for value in re.findall(r"[\d.]+", seen["head"])[:2])
    assert begin - 1e-9 <= first < begin + 0.01 and end - 0.01 < last <= end + 1e-9
    assert f"--range {first:.9g}:{last:.9g}" in seen["command"]
    whole, part = compute_metrics(run), compute_metrics(within(run, first, last))
    for name, _, unit, factor in FIGURES:
        for figures, cells in ((whole, seen["whole"]), (part, seen["zoomed"])):
            if name in cells and figures[name] is not None:
                assert float(cells[name].split()[0]) == float(shown(figures[name], unit, factor)[0]), name
    assert int(seen["zoomed"]["samples"]) == part["samples"]
