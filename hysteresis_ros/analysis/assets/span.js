// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

// The span of time that a page shows, and the figures over it, added up from sums over blocks of samples
// (analysis/report.py). The page can be read without this script: it then shows pictures and the figures of whole runs.
"use strict";

const data = JSON.parse(document.getElementById("data").textContent);
const root = document.documentElement;
const times = []; // charts over time: one span for all
const paths = []; // charts that show the part of a path that lies in the span
let whole = [0, 1];
let span = whole;
let setting = false;

// -- numbers -----------------------------------------------------------------------------------------------------

function numbers(text, wide) {
  const raw = atob(text);
  const bytes = Uint8Array.from(raw, (letter) => letter.charCodeAt(0));
  return wide ? new Float64Array(bytes.buffer) : new Float32Array(bytes.buffer);
}

function gaps(values) {
  return Array.from(values, (value) => (Number.isFinite(value) ? value : null));
}

function digits(value, count) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return String(Number(value.toPrecision(count)));
}

// A figure as analysis/tables.py shows it: small values in the finer unit.
function shown(value, unit, factor) {
  if (value === null || !Number.isFinite(value)) return ["–", unit];
  const part = value * factor;
  if (part && data.finer[unit] && Math.abs(part) < data.fine) return [digits(1e3 * part, 4), data.finer[unit]];
  return [digits(part, 4), unit];
}

// -- figures of the span -----------------------------------------------------------------------------------------

const runs = (data.runs || []).map((run) => {
  const sums = {};
  for (const name in run.sums) sums[name] = numbers(run.sums[name], true);
  return { name: run.name, sums };
});

// First and last whole block of a span; null: the run has no samples there.
function blocksOf(sums, from, to) {
  const last = sums.from.length - 1;
  if (from > sums.to[last] || to < sums.from[0]) return null;
  const near = 1e-9 * Math.max(1, Math.abs(to));
  let i = sums.from.findIndex((value) => value >= from - near);
  if (i < 0) i = last;
  let j = last;
  while (j > 0 && sums.to[j] > to + near) j -= 1;
  if (j < i) i = j = Math.max(0, sums.to.findIndex((value) => value >= from));
  return [i, j];
}

function total(sums, name, i, j) {
  let sum = 0;
  for (let k = i; k <= j; k += 1) sum += sums[name][k];
  return sum;
}

function extreme(sums, name, i, j, sign) {
  let found = -Infinity;
  for (let k = i; k <= j; k += 1) if (sign * sums[name][k] > found) found = sign * sums[name][k];
  return sign * found;
}

// Sum of the terms between neighbouring samples, without the term that leads into the span.
function between(sums, name, counts, i, j) {
  let first = i;
  while (first < j && !sums[counts][first]) first += 1;
  return total(sums, name, i, j) - sums["joint_" + name][first];
}

function figuresOf(sums, i, j) {
  const found = { samples: total(sums, "samples", i, j), duration_s: sums.to[j] - sums.from[i] };
  const stroke = extreme(sums, "high", i, j, 1) - extreme(sums, "low", i, j, -1);
  if (Number.isFinite(stroke)) found.stroke_m = stroke;
  const errors = sums.errors ? total(sums, "errors", i, j) : 0;
  if (errors) {
    found.rms_error_m = Math.sqrt(total(sums, "square", i, j) / errors);
    found.max_error_m = extreme(sums, "largest", i, j, 1);
    found.iae_m_s = between(sums, "area", "errors", i, j);
    if (stroke > 0) {
      found.rms_error_percent_of_stroke = (100 * found.rms_error_m) / stroke;
      found.max_error_percent_of_stroke = (100 * found.max_error_m) / stroke;
    }
  }
  const volts = sums.volts ? total(sums, "volts", i, j) : 0;
  if (volts > 2) {
    found.voltage_rate_v_s = Math.sqrt(between(sums, "rates", "volts", i, j) / (volts - 1));
    found.voltage_variation_v = between(sums, "rises", "volts", i, j);
  }
  const flags = sums.flags ? total(sums, "flags", i, j) : 0;
  if (flags) found.saturated_percent = (100 * total(sums, "cut", i, j)) / flags;
  if (sums.late) found.lateness_max_s = extreme(sums, "late", i, j, 1);
  if (sums.skipped) found.skipped_samples = total(sums, "skipped", i, j);
  return found;
}

// Shows the figures in the table, and the first few also in words; runs that end before the span have none.
function showFigures() {
  const rows = [...document.querySelectorAll("tr[data-figure]")];
  const heads = document.querySelectorAll(".span-head");
  const sentences = [];
  runs.forEach(({ name, sums }, column) => {
    const blocks = blocksOf(sums, span[0], span[1]);
    const found = blocks ? figuresOf(sums, ...blocks) : {};
    for (const row of rows) {
      const value = found[row.dataset.figure];
      const known = value !== undefined;
      const [text, unit] = shown(known ? value : null, row.dataset.unit, Number(row.dataset.factor));
      const other = known && unit !== row.dataset.shownUnit;
      row.querySelectorAll("td.shown")[column].textContent = other ? text + " " + unit : text;
    }
    const ends = blocks ? [sums.from[blocks[0]], sums.to[blocks[1]]] : null;
    heads[column].textContent = ends ? ends.map((value) => digits(value, 7)).join(" … ") + " s" : "not there";
    const said = [(name ? name + ": " : "") + heads[column].textContent];
    for (const [figure, label] of [["rms_error_m", "RMS error"], ["max_error_m", "maximum"], ["stroke_m", "stroke"]])
      if (found[figure] !== undefined) said.push(label + " " + shown(found[figure], "µm", 1e6).join(" "));
    if (ends) said.push(found.samples + " samples");
    sentences.push(said.join(" · "));
    if (column || !ends) return;
    const range = ends.map((value) => digits(value - data.first, 9)).join(":");
    document.getElementById("span-command").textContent =
      "hysteresis report RUN --range " + range + " -o part.html";
  });
  document.getElementById("span-figures").innerText = sentences.join("\n");
}

// -- the span ----------------------------------------------------------------------------------------------------

function setSpan(from, to) {
  from = Math.max(whole[0], Math.min(from, to));
  to = Math.min(whole[1], Math.max(from, to));
  if (!(to > from)) return;
  span = [from, to];
  setting = true;
  for (const chart of times) chart.setScale("x", { min: from, max: to });
  setting = false;
  for (const redraw of paths) redraw();
  document.getElementById("span-from").value = digits(from, 8);
  document.getElementById("span-to").value = digits(to, 8);
  const every = document.getElementById("span-name");
  const known = (data.spans || []).findIndex((one) => one[1] === from && one[2] === to);
  if (every) every.value = known < 0 ? "" : String(known);
  showFigures();
}

function move(part) {
  const width = span[1] - span[0];
  const from = Math.max(whole[0], Math.min(span[0] + part * width, whole[1] - width));
  setSpan(from, from + width);
}

function zoom(factor) {
  const middle = 0.5 * (span[0] + span[1]);
  const half = 0.5 * factor * (span[1] - span[0]);
  setSpan(middle - half, middle + half);
}

const actions = {
  whole: () => setSpan(whole[0], whole[1]),
  closer: () => zoom(0.5),
  wider: () => zoom(2),
  earlier: () => move(-0.5),
  later: () => move(0.5),
};
const keys = { "+": "closer", "-": "wider", ArrowLeft: "earlier", ArrowRight: "later", 0: "whole" };

function bindSpan() {
  for (const button of document.querySelectorAll("button[data-action]"))
    button.addEventListener("click", actions[button.dataset.action]);
  const ends = ["span-from", "span-to"].map((name) => document.getElementById(name));
  for (const field of ends)
    field.addEventListener("change", () => {
      const [from, to] = ends.map((one) => Number(one.value));
      if (Number.isFinite(from) && Number.isFinite(to) && to > from) setSpan(from, to);
      else setSpan(span[0], span[1]);
    });
  const every = document.getElementById("span-name");
  every.addEventListener("change", () => {
    const one = data.spans[Number(every.value)];
    if (every.value !== "" && one) setSpan(one[1], one[2]);
  });
  document.addEventListener("keydown", (event) => {
    const typing = /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName);
    if (typing || event.ctrlKey || event.altKey || event.metaKey || !keys[event.key]) return;
    event.preventDefault();
    actions[keys[event.key]]();
  });
}

