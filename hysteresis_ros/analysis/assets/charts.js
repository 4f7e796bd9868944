// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

// The charts of a page, drawn with uPlot from the JSON in the page (analysis/page.py). They replace the pictures that
// the page shows without scripts. Charts over time share the span of span.js.
"use strict";

// -- charts ------------------------------------------------------------------------------------------------------

function colour(name) {
  return getComputedStyle(root).getPropertyValue("--c-" + name).trim();
}

function ground(name) {
  return getComputedStyle(root).getPropertyValue("--" + name).trim();
}

function axes(chart) {
  const look = { stroke: ground("text"), grid: { stroke: ground("line"), width: 1 }, ticks: { stroke: ground("line") } };
  const font = "12px system-ui, sans-serif";
  const words = (values) => values.map((value) => (value === null ? "" : digits(value, 8)));
  return [
    { ...look, font, labelFont: font, label: chart.across, labelSize: 20, size: 34, values: (u, v) => words(v) },
    { ...look, font, labelFont: font, label: chart.up, labelSize: 20, size: 62, values: (u, v) => words(v) },
  ];
}

// Grey ranges are drawn below the lines, and levels above them.
function marks(chart) {
  return {
    drawAxes: (u) => {
      u.ctx.save();
      u.ctx.beginPath();
      u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
      u.ctx.clip();
      const fill = (range) => {
        const [left, right] = range.map((value) => u.valToPos(value, "x", true));
        u.ctx.fillRect(left, u.bbox.top, Math.max(right - left, 1), u.bbox.height);
      };
      u.ctx.fillStyle = ground("shade");
      if (chart.shaded) fill(chart.shaded);
      u.ctx.fillStyle = colour("late");
      u.ctx.globalAlpha = 0.3;
      (chart.marked || []).forEach(fill);
      u.ctx.restore();
    },
    draw: (u) => {
      u.ctx.save();
      u.ctx.strokeStyle = colour("limit");
      u.ctx.setLineDash([6, 4]);
      for (const level of chart.levels) {
        const y = u.valToPos(level, "y", true);
        if (y < u.bbox.top || y > u.bbox.top + u.bbox.height) continue;
        u.ctx.beginPath();
        u.ctx.moveTo(u.bbox.left, y);
        u.ctx.lineTo(u.bbox.left + u.bbox.width, y);
        u.ctx.stroke();
      }
      u.ctx.restore();
    },
  };
}

function vertical(chart, isWhole) {
  if (chart.logarithmic.includes("y")) return { distr: 3 };
  return {
    range: (u, low, high) => {
      if (low === null || !Number.isFinite(low)) return [0, 1];
      if (isWhole(u) && chart.limits) return chart.limits;
      if (isWhole(u)) {
        low = Math.min(low, ...chart.levels);
        high = Math.max(high, ...chart.levels);
      }
      const room = 0.05 * (high - low) || 0.05 * Math.abs(high) || 1;
      return [low - (chart.kind === "steps" ? 0 : room), high + room];
    },
  };
}

function lineSeries(chart, line) {
  const series = {
    label: line.label,
    stroke: colour(line.colour),
    width: line.width,
    dash: line.dash,
    points: { show: false },
    value: (u, value) => digits(value, 6),
  };
  if (line.dots) {
    series.paths = () => null;
    series.points = { show: true, size: 5, fill: colour(line.colour) };
  }
  if (chart.kind === "steps") {
    series.paths = uPlot.paths.stepped({ align: 1 });
    if (!line.dash.length) series.fill = colour(line.colour) + "26";
  }
  return series;
}

// The nearest point of a line: in charts of several runs, each line has its own times.
function nearest(u, series, index) {
  const values = u.data[series];
  if (values[index] !== null && values[index] !== undefined) return index;
  for (let away = 1; away < values.length; away += 1)
    for (const k of [index - away, index + away])
      if (k >= 0 && k < values.length && values[k] !== null && values[k] !== undefined) return k;
  return index;
}

function options(chart, place, more) {
  return {
    width: place.clientWidth,
    height: Math.max(200, Math.min(place.clientWidth * 0.42, chart.kind === "path" ? 420 : 290)),
    axes: axes(chart),
    legend: { live: true },
    ...more,
  };
}

function spread(place, chart) {
  const height = chart.height;
  new ResizeObserver(() => {
    const width = place.clientWidth;
    if (width && width !== chart.width) chart.setSize({ width, height: Math.min(height, Math.max(200, 0.7 * width)) });
  }).observe(place);
  return chart;
}

function timeChart(chart, place, time) {
  // the chart calls this before its own scale is set
  const whenWhole = () => span[0] === whole[0] && span[1] === whole[1];
  const marked = marks(chart);
  const u = new uPlot(
    options(chart, place, {
      scales: { x: { time: false, range: (u, low, high) => [low, high] }, y: vertical(chart, whenWhole) },
      series: [
        { label: chart.across, value: (u, value) => digits(value, 8) },
        ...chart.lines.map((line) => lineSeries(chart, line)),
      ],
      cursor: {
        sync: { key: "time", setSeries: false },
        drag: { x: true, y: false },
        // in charts of several runs, each line has its own times; in charts of a single run, the cursor shows its gaps
        dataIdx: (u, series, index) => (series && chart.kind === "overlay" ? nearest(u, series, index) : index),
        bind: { dblclick: () => () => actions.whole() },
      },
      hooks: {
        drawAxes: [marked.drawAxes],
        draw: [marked.draw],
        setScale: [
          (u, name) => {
            if (name === "x" && !setting && u.ready) setSpan(u.scales.x.min, u.scales.x.max);
          },
        ],
        ready: [(u) => (u.ready = true)],
      },
    }),
    time,
    place
  );
  times.push(u);
  return u;
}

function graphChart(chart, place) {
  const tables = chart.lines.map((line) => [Array.from(numbers(line.x, true)), gaps(numbers(line.y))]);
  const always = (u) => u.data[0].length && u.scales.x.min <= u.data[0][0];
  const marked = marks(chart);
  // a round first value gives round labels
  const ends = (u, low, high) => {
    const decade = 10 ** Math.floor(Math.log10(low));
    return [Math.floor(low / decade) * decade, high];
  };
  const wide = chart.logarithmic.includes("x") ? { time: false, distr: 3, range: ends } : { time: false };
  return new uPlot(
    options(chart, place, {
      scales: { x: wide, y: vertical(chart, always) },
      series: [
        { label: chart.across, value: (u, value) => digits(value, 6) },
        ...chart.lines.map((line) => ({ ...lineSeries(chart, line), spanGaps: true })),
      ],
      cursor: { dataIdx: (u, series, index) => (series ? nearest(u, series, index) : index) },
      hooks: { drawAxes: [marked.drawAxes], draw: [marked.draw] },
    }),
    uPlot.join(tables),
    place
  );
}

function pathChart(chart, place) {
  const lines = chart.lines.map((line) => ({
    ...line,
    x: numbers(line.x),
    y: numbers(line.y),
    key: line.key ? numbers(line.key) : null,
  }));
  const least = (name) => Math.min(...lines.map((line) => line[name].reduce((a, b) => Math.min(a, b), Infinity)));
  const most = (name) => Math.max(...lines.map((line) => line[name].reduce((a, b) => Math.max(a, b), -Infinity)));
  const box = { x: [least("x"), most("x")], y: [least("y"), most("y")] };
  const padded = ([low, high]) => [low - 0.03 * (high - low), high + 0.03 * (high - low)];
  const within = (line, k) => !line.key || (line.key[k] >= span[0] - 1e-6 && line.key[k] <= span[1] + 1e-6);
  const readout = document.createElement("p");
  readout.className = "readout";
  const stroke = (u, line) => {
    u.ctx.strokeStyle = colour(line.colour);
    u.ctx.lineWidth = line.width * devicePixelRatio;
    u.ctx.setLineDash(line.dash.map((length) => length * devicePixelRatio));
    u.ctx.beginPath();
    let pen = false;
    for (let k = 0; k < line.x.length; k += 1) {
      if (!within(line, k)) {
        pen = false;
        continue;
      }
      const [x, y] = [u.valToPos(line.x[k], "x", true), u.valToPos(line.y[k], "y", true)];
      if (pen) u.ctx.lineTo(x, y);
      else u.ctx.moveTo(x, y);
      pen = true;
    }
    u.ctx.stroke();
  };
  const find = (u) => {
    let best = { distance: 900 };
    for (const line of lines)
      for (let k = 0; k < line.x.length; k += 1) {
        if (!within(line, k)) continue;
        const [x, y] = [u.valToPos(line.x[k], "x") - u.cursor.left, u.valToPos(line.y[k], "y") - u.cursor.top];
        if (x * x + y * y < best.distance) best = { distance: x * x + y * y, line, k };
      }
    return best;
  };
  const u = new uPlot(
    options(chart, place, {
      legend: { show: false },
      scales: {
        x: { time: false, range: (u, low, high) => (low === box.x[0] && high === box.x[1] ? padded(box.x) : [low, high]) },
        y: { range: (u, low, high) => (low === box.y[0] && high === box.y[1] ? padded(box.y) : [low, high]) },
      },
      series: [{}, { label: "", stroke: "transparent", points: { show: false } }],
      cursor: { drag: { x: true, y: true, uni: 30 }, points: { show: false } },
      hooks: {
        draw: [
          (u) => {
            u.ctx.save();
            u.ctx.beginPath();
            u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
            u.ctx.clip();
            for (const line of lines) stroke(u, line);
            u.ctx.restore();
          },
        ],
        setCursor: [
          (u) => {
            if (u.cursor.left < 0) return;
            const { line, k } = find(u);
            const at = line && line.key ? ", at " + digits(line.key[k], 7) + " s" : "";
            readout.textContent = line ? digits(line.x[k], 6) + " → " + digits(line.y[k], 6) + at : "";
          },
        ],
      },
    }),
    [box.x, box.y],
    place
  );
  const legend = document.createElement("p");
  legend.className = "legend";
  for (const line of lines) {
    const item = document.createElement("span");
    const mark = document.createElement("i");
    mark.style.borderTop = (line.dash.length ? "2px dotted " : "2px solid ") + colour(line.colour);
    item.append(mark, line.label);
    legend.append(item);
  }
  place.append(legend, readout);
  paths.push(() => u.redraw(false));
  return u;
}

function draw() {
  times.length = paths.length = 0;
  const time = data.time ? Array.from(numbers(data.time, true)) : [];
  for (const chart of data.charts) {
    const figure = document.getElementById("chart-" + chart.name);
    const place = figure.querySelector(".plot");
    place.replaceChildren();
    place.setAttribute("role", "group");
    place.setAttribute("aria-label", figure.querySelector("figcaption").textContent);
    figure.classList.add("live");
    try {
      let made;
      if (chart.kind === "time") {
        const columns = chart.lines.map((line) => gaps(numbers(line.y)));
        made = timeChart(chart, place, [time, ...columns]);
      } else if (chart.kind === "overlay") {
        const tables = chart.lines.map((line) => [Array.from(numbers(line.x, true)), gaps(numbers(line.y))]);
        made = timeChart(chart, place, uPlot.join(tables));
      } else made = chart.kind === "path" ? pathChart(chart, place) : graphChart(chart, place);
      spread(place, made);
    } catch (error) {
      figure.classList.remove("live"); // the picture stays
      console.error(chart.name, error);
    }
  }
}

whole = data.whole || whole;
span = whole;
draw();
root.classList.add("scripted");
if (times.length) {
  root.classList.add("spans");
  bindSpan();
  setSpan(whole[0], whole[1]);
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  const kept = span;
  draw();
  setSpan(kept[0], kept[1]);
});
