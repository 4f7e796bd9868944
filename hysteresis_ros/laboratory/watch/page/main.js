// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

// The page: its socket to the server, the display of the axis, and the actions of keys and buttons.

import { LoopChart, PlaneChart, SpectrumChart, TimeChart, Traces, lengthUnit, readFrame, readable } from "/charts.js";
import { Motor } from "/motor.js";
import { Tuning, throttled } from "/tuning.js";

const byId = (name) => document.getElementById(name);
const WINDOWS = [0.1, 0.5, 1, 5, 10, 30, 60];
const GONE = 3000;

const state = { socket: null, number: 0, waiting: new Map(), paused: false, window: 5, limits: {}, mine: false, live: false, dirty: false, heard: 0, marks: [], recording: null, motor: null, refused: false };
const traces = new Traces();
const loops = { voltage: [], command: [], measured: [] };
const charts = {};

/** A number with a fixed number of characters, so that nothing jumps; a figure space replaces a missing sign. */
const fixed = (value, word) => (Number.isFinite(value) ? value.toFixed(word === "mm" ? 6 : Math.abs(value) < 10 ? 3 : Math.abs(value) < 100 ? 2 : 1).replace(/^(?!-)/, "\u2007") : "–");

// -- requests ---------------------------------------------------------------------------------------------------------

function ask(words) {
  return new Promise((resolve) => {
    if (state.socket?.readyState !== WebSocket.OPEN) { resolve({ ok: false, text: "no connection to the server of this page" }); return; }
    state.number += 1;
    state.waiting.set(state.number, resolve);
    state.socket.send(JSON.stringify({ id: state.number, ...words }));
  });
}

function say(place, { ok, text }) {
  const element = byId(place);
  element.textContent = text;
  element.classList.toggle("bad", !ok);
}

const view = () => ask({ do: "view", window: state.window, columns: Math.min(Math.max(Math.round(byId("displacement").clientWidth / 2), 100), 1500) });

async function stop(event) {
  event?.preventDefault();
  let answer = await ask({ do: "stop" });
  if (state.socket?.readyState !== WebSocket.OPEN) { // the socket is closed, but the server may still run
    try {
      const response = await fetch("/stop", { method: "POST", headers: { "X-Hysteresis": "1" } });
      answer = { ok: response.ok, text: await response.text() };
    } catch { answer = { ok: false, text: "the server of this page does not answer: stop the axis elsewhere" }; }
  }
  say("run-said", answer);
}

const act = (words, place) => ask(words).then((answer) => say(place, answer));

// -- messages of the server -------------------------------------------------------------------------------------------

function connect() {
  const socket = new WebSocket(`ws://${location.host}/socket`);
  socket.binaryType = "arraybuffer";
  state.socket = socket;
  socket.onopen = view;
  socket.onmessage = ({ data }) => { state.heard = Date.now(); if (data instanceof ArrayBuffer) frame(data); else hear(JSON.parse(data)); };
  socket.onclose = () => {
    for (const resolve of state.waiting.values()) resolve({ ok: false, text: "the connection to the server of this page is lost" });
    state.waiting.clear();
    headline("no connection to the server of this page; reconnecting", "bad");
    setTimeout(connect, 1000);
  };
}

function hear(words) {
  if (words.answer !== undefined) {
    state.waiting.get(words.answer)?.(words);
    state.waiting.delete(words.answer);
  } else if (words.status) status(words.status);
  else if (words.axis) axis(words.axis);
  else if (words.spectrum) { if (!state.paused) byId("peak").textContent = charts.spectrum.draw(words.spectrum); }
  else if (words.plane !== undefined) plane(words.plane);
  else if (words.control) control(words.control, words.pages);
  else if (words.marker) state.marks = [...state.marks.slice(-50), words.marker];
  else if (words.refused !== undefined) say(words.refused.startsWith("speed") ? "motor-said" : "setpoint-said", { ok: false, text: words.refused });
}

function frame(buffer) {
  if (state.paused) { state.missed = true; return; }
  const [header, numbers] = readFrame(buffer);
  traces.take(header, numbers);
  const begin = 2 * header.shown.length * header.bins;
  Object.keys(loops).forEach((name, index) => {
    const own = numbers.subarray(begin + index * header.points, begin + (index + 1) * header.points);
    loops[name] = (header.loop_fresh ? [...own] : [...loops[name], ...own]).slice(-header.kept);
  });
  if (!state.dirty) { state.dirty = true; requestAnimationFrame(draw); }
}

function draw() {
  state.dirty = false;
  const shown = Object.values(charts).filter((chart) => chart.legend);
  for (const chart of shown) chart.draw();
  charts.before.draw(loops); charts.after.draw(loops);
  for (const { legend, series, more } of shown)
    series.forEach(({ name, signal, scale, unit }, index) => {
      const { chart, unitOf } = legend.of(), values = traces.signals[signal] || [], at = chart.cursor.idx ?? values.length - 1;
      const [word, factor] = unit === "m" ? unitOf(scale) : [unit, 1];
      legend.items[index].textContent = more.names ? more.names[values[at]] ?? "–" : `${name} ${fixed(values[at] * factor, word)} ${word}`;
    });
}

// -- display ----------------------------------------------------------------------------------------------------------

function headline(text, level = "") {
  byId("headline").textContent = text;
  byId("headline").className = level;
  byId("lamp").className = `lamp ${level || "ok"}`;
}

function status(now) {
  state.live = now.live;
  state.recording = now.recording;
  const worst = now.health.filter(({ level, age }) => level !== "ok" && age < 5);
  if (!now.live) headline(now.health.some(({ age }) => age < 3) ? "the axis publishes no samples" : `no axis: waiting for one${now.elsewhere.length ? `; in other namespaces: hysteresis watch --namespace ${now.elsewhere.join(", ")}` : ""}`, "bad");
  else if (now.tripped) headline("stopped: safe voltage until started", "bad");
  else if (now.stands) headline(now.stands, "warning");
  else if (worst.length) headline(`${worst[0].node}: ${worst[0].message}`, worst.some(({ level }) => level === "error") ? "bad" : "warning");
  else headline("running");
  const { rms, largest, measured, voltage } = now.figures;
  const said = now.health.map(({ values }) => values.lateness_p99_us).find((value) => value !== undefined);
  const setpoint = byId("setpoint"), slider = byId("setpoint-slider");
  if (now.figures.setpoint !== null && state.factor && (state.refused || ![setpoint, slider].includes(document.activeElement))) {
    state.refused = false;
    slider.value = now.figures.setpoint * state.factor;
    setpoint.value = Number((now.figures.setpoint * state.factor).toPrecision(6));
  }
  const texts = { rms: readable(rms, "m"), largest: readable(largest, "m"), measured: measured === null || !state.factor ? "–" : `${fixed(measured * state.factor, state.unit)} ${state.unit}`, voltage: voltage === null ? "–" : `${fixed(voltage)} V`,
    ready: now.ready.now ? "yes" : now.ready.in === null ? "–" : `in ${readable(now.ready.in, "s")}`, rate: now.live ? `${Math.round(now.rate)} Hz` : "–", late: said === undefined ? "–" : `${Number(said)} µs`, skipped: String(now.skipped) };
  for (const [name, text] of Object.entries(texts)) byId(name).textContent = text;
  motor.show(now.motor);
  byId("lost").textContent = now.lost ? `${now.lost} samples did not reach this page` : "";
  const on = Boolean(now.recording) && !now.recording.stopped;
  byId("record").setAttribute("aria-pressed", on);
  byId("record").textContent = on ? "recording …" : "record";
  if (now.recording) say("record-said", { ok: on, text: on ? `${now.recording.path.split("/").at(-1)}: ${now.recording.samples} samples` : now.recording.stopped });
  const cells = ({ node, level, message, values, age }) => [
    [node.replaceAll("_", " "), ""], [age > 3 ? "silent" : level, `level-${age > 3 ? "stale" : level}`],
    [values.rate_hz ? `${Number(values.rate_hz).toFixed(0)} Hz` : "", "number"], [message === "OK" ? "" : message, "quiet"]];
  byId("health").tBodies[0].replaceChildren(...now.health.map((one) => {
    const row = document.createElement("tr");
    row.append(...cells(one).map(([text, name]) => Object.assign(document.createElement("td"), { textContent: text, className: name })));
    return row;
  }));
}

function axis({ namespace, nodes, limits, mode, rate, motor: about }) {
  const other = JSON.stringify(about ?? null) !== JSON.stringify(state.motor);
  state.motor = about ?? null;
  if (other) { motor.introduce(state.motor); build(); }
  byId("name").textContent = namespace === "/" ? "axis" : namespace;
  document.title = `${namespace === "/" ? "axis" : namespace} – hysteresis watch`;
  byId("name").title = mode ? `${mode}, ${rate} Hz` : "";
  state.limits = limits;
  const lines = (name, scale, wide) => (limits[name] || []).map((value) => ({ scale, value, wide }));
  charts.displacement.limits = lines("setpoint", "m", false);
  charts.drive.limits = lines("voltage", "V", true);
  if (limits.slider) {
    const [low, high] = limits.slider, [unit, factor] = lengthUnit(Math.max(Math.abs(low), Math.abs(high)));
    Object.assign(state, { unit, factor });
    byId("setpoint-unit").textContent = unit;
    Object.assign(byId("setpoint-slider"), { min: low * factor, max: high * factor, step: ((high - low) * factor) / 1000 });
    byId("setpoint").title = byId("setpoint-slider").title = `${low * factor} … ${high * factor} ${unit}`;
  }
  tuning.show(nodes);
}

/** The plane of two axes of a stage; its chart is made when the first samples of both axes are there. */
function plane(now) {
  if (state.paused) return;
  for (const element of document.querySelectorAll(".of-stage")) element.hidden = !now;
  if (!now) { charts.plane?.destroy(); delete charts.plane; return; }
  charts.plane ??= new PlaneChart(byId("plane"));
  charts.plane.draw(now);
  byId("plane-title").textContent = `Plane ${now.names[0]}–${now.names[1]}`;
  byId("plane-said").textContent = `error in the plane: ${readable(now.rms, "m")} rms, largest ${readable(now.largest, "m")}`;
}

function control({ mine, holder, since }, pages) {
  state.mine = mine;
  for (const element of document.querySelectorAll("aside button, aside input, aside select"))
    if (element.id !== "filter" && element.id !== "take") element.disabled = !mine;
  const box = byId("control");
  box.hidden = mine;
  box.replaceChildren();
  if (mine) return;
  const text = holder ? `This page is read-only: another page controls the axis (${holder}, since ${new Date(since * 1000).toLocaleTimeString()}).` : "No page controls the axis.";
  const take = Object.assign(document.createElement("button"), { id: "take", type: "button", textContent: holder ? "take over" : "take control" });
  take.addEventListener("click", () => ask({ do: "control", by_force: true }));
  box.append(text, take);
  byId("name").title = `${pages} pages are open`;
}

// -- buttons, fields, keys ----------------------------------------------------------------------------------------------

function choose(window) {
  state.window = window;
  for (const button of byId("windows").children) button.setAttribute("aria-pressed", Number(button.dataset.window) === window);
  view();
}

function pause() {
  state.paused = !state.paused;
  byId("pause").setAttribute("aria-pressed", state.paused);
  byId("pause").textContent = state.paused ? "paused" : "pause";
  if (!state.paused && state.missed) { state.missed = false; view(); }
}

const mark = () => act({ do: "marker", text: byId("marker-text").value.trim() || `mark ${state.marks.length + 1}` }, "record-said");
const record = () => act({ do: "record", on: !(state.recording && !state.recording.stopped) }, "record-said");

/** Sends a setpoint; after a refusal, field and slider return to the setpoint in use, even while they have the focus. */
const move = throttled(async (text) => {
  const answer = await ask({ do: "setpoint", value: /[a-zµ]\s*$/i.test(text) ? text : `${text}${state.unit}` });
  state.refused = !answer.ok;
  say("setpoint-said", answer);
});
byId("setpoint-slider").addEventListener("input", (event) => {
  // four digits, but not beyond the limits: the limits themselves are sent exactly
  const { min, max, value } = event.target, [low, high] = state.limits.slider, shown = Number(Number(value).toPrecision(4));
  const end = shown <= Number(min) ? low : shown >= Number(max) ? high : null;
  byId("setpoint").value = end === null ? shown : Number((end * state.factor).toPrecision(6));
  move(end === null ? String(shown) : `${end}m`);
});
byId("setpoint").addEventListener("change", (event) => { byId("setpoint-slider").value = parseFloat(event.target.value); move(event.target.value); });

const KEYS = { " ": pause, r: record, m: mark, s: () => byId("setpoint").select(), "/": () => byId("filter").select() };
document.addEventListener("keydown", (event) => {
  const within = event.target.closest("input:not([type=range]):not([type=checkbox]), select");
  if (event.key === "Escape") { if (within) within.blur(); else stop(); return; }
  if (within || event.ctrlKey || event.altKey || event.metaKey) return;
  const window = WINDOWS[Number(event.key) - 1], button = event.target.closest("button, summary");
  if (window && event.key !== " ") choose(window);
  else if (KEYS[event.key] && !(event.key === " " && button)) { event.preventDefault(); KEYS[event.key](); }
});

byId("stopform").addEventListener("submit", stop);
byId("start").addEventListener("click", () => act({ do: "start" }, "run-said"));
byId("hold").addEventListener("click", () => act({ do: "hold" }, "run-said"));
byId("record").addEventListener("click", record);
byId("marker").addEventListener("click", mark);
byId("pause").addEventListener("click", pause);
WINDOWS.forEach((window, index) => {
  const button = Object.assign(document.createElement("button"), { type: "button", textContent: window < 1 ? `${window * 1000} ms` : `${window} s`, title: `key ${index + 1}` });
  button.dataset.window = window;
  button.addEventListener("click", () => choose(window));
  byId("windows").append(button, " ");
});

// -- start ----------------------------------------------------------------------------------------------------------------

const tuning = new Tuning(byId("parameters"), byId("filter"), ask);
const motor = new Motor(ask, say);
const length = { unit: "m", scale: "m", least: 1e-9, title: "displacement" };

function legend(place, chart) {
  const items = chart.series.map(({ name, colour }) => {
    const item = Object.assign(document.createElement("span"), { textContent: name });
    item.style.setProperty("--of", `var(--${colour})`);
    return item;
  });
  byId(place).replaceChildren(...items);
  chart.legend = { items, of: () => ({ chart: chart.chart, unitOf: (scale) => chart.unitOf(scale) }) };
}

/** Makes the charts of an actuator or of a motor; a motor's setpoint and displacement are the slider's, the rest the extender's. */
function build() {
  for (const [name, chart] of Object.entries(charts)) { chart.destroy(); delete charts[name]; }
  const inchworm = state.motor;
  // room for a position in millimetres written to the nanometre
  const make = (place, series, more) => new TimeChart(byId(place), traces, series, state, { size: inchworm ? 84 : 0, ...more });
  const line = (signal, more) => ({ name: signal, signal, colour: signal, ...length, ...more });
  const volts = { unit: "V", scale: "V", least: 0.01, title: "voltage" };
  byId("displacement-title").textContent = inchworm ? "Slider" : "Displacement";
  const place = inchworm ? [line("measured", { least: 2e-7 }), line("setpoint", { dash: [6, 3], least: 2e-7, guest: true })] : [line("estimated", { width: 1 }), line("measured"), line("reference", { dash: [6, 3] })];
  charts.displacement = make("displacement", place, { words: true });
  charts.error = make("error", [line("error", { title: "error" })], { });
  if (inchworm) {
    charts.extender = make("extender", [line("command", { width: 1, title: "extension" }), line("extender", { title: "extension" }), line("reference", { dash: [6, 3], title: "extension" })], {});
    const clamps = ["front", "rear"].map((name) => line(`${name}_voltage`, { ...volts, name: `${name} clamp`, colour: name }));
    charts.drive = make("drive", [line("voltage", { ...volts, name: "extender" }), ...clamps], { flags: true });
    charts.phase = make("phase", [{ name: "phase", signal: "phase", colour: "phase", unit: "", scale: "phase", least: 1, title: "phase" }], { names: inchworm.phases, x: true });
  } else charts.drive = make("drive", [line("voltage", volts), line("command", { title: "command", scale: "command" })], { flags: true, x: true });
  charts.before = new LoopChart(byId("before"), ["voltage", "measured"], ["voltage", "displacement"], "V");
  charts.after = new LoopChart(byId("after"), ["command", "measured"], ["command", "displacement"], "m");
  charts.spectrum = new SpectrumChart(byId("spectrum"));
  for (const [name, chart] of Object.entries(charts).filter(([, chart]) => chart instanceof TimeChart)) legend(`legend-${name}`, chart);
}

build();
for (const query of ["(prefers-color-scheme: dark)"]) matchMedia(query).addEventListener("change", () => Object.values(charts).forEach((chart) => chart.rebuild()));
let resized;
addEventListener("resize", () => { clearTimeout(resized); resized = setTimeout(view, 300); });
setInterval(() => { if (Date.now() - state.heard > GONE && state.socket?.readyState === WebSocket.OPEN) headline("the server of this page is silent", "bad"); }, 1000);
choose(state.window);
connect();
window.hysteresis = { state, traces, charts, loops };
