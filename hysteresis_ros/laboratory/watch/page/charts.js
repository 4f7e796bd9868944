// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

// The charts: signals over time, the loops before and after compensation, and the spectrum of the error.

const UNITS = [[2e-9, "pm", 1e12], [2e-6, "nm", 1e9], [2e-3, "µm", 1e6], [Infinity, "mm", 1e3]];
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/** Return a readable unit of length for a span [m], and the number of units in a metre. */
export function lengthUnit(span) {
  return UNITS.find(([below]) => !(Math.abs(span) >= below)).slice(1);
}

/** Return a number in metres or another SI unit as text, with four digits and its unit. */
export function readable(value, unit) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (unit !== "m") return `${Number(value.toPrecision(4))} ${unit}`;
  const [word, factor] = value === 0 ? ["µm", 1e6] : lengthUnit(value);
  return `${Number((value * factor).toPrecision(4))} ${word}`;
}

/** Return a power of ten in readable form. */
function power(value) {
  const exponent = Math.round(Math.log10(value));
  if (Math.abs(Math.log10(value) - exponent) > 1e-6) return "";
  return exponent >= -2 && exponent <= 3 ? String(10 ** exponent).slice(0, 5) : `10${[...String(exponent)].map((sign) => "⁰¹²³⁴⁵⁶⁷⁸⁹⁻"["0123456789-".indexOf(sign)]).join("")}`;
}

/** An axis range with hysteresis: it grows at once and shrinks when half of it is unused. */
class Range {
  constructor(least) { this.least = least; this.low = this.high = NaN; }
  of(low, high) {
    if (!(low <= high)) return [Number.isFinite(this.low) ? this.low : -1e-9, Number.isFinite(this.high) ? this.high : 1e-9];
    const span = Math.max(high - low, this.least, Math.abs(high) * 1e-9);
    const fits = low >= this.low && high <= this.high && this.high - this.low < 2.4 * span;
    if (!fits) { this.low = (low + high - span) / 2 - 0.1 * span; this.high = (low + high + span) / 2 + 0.1 * span; }
    return [this.low, this.high];
  }
}

function extent(arrays) {
  let low = Infinity, high = -Infinity;
  for (const array of arrays) for (const value of array) if (value < low || value > high) { low = Math.min(low, value); high = Math.max(high, value); }
  return [low, high];
}

/** Tick labels with just enough decimals to differ: down to nanometres for a position in millimetres. */
const ticks = (factor) => (chart, splits) => {
  const step = Math.abs((splits[1] - splits[0]) * factor);
  let digits = 0;
  while (digits < 9 && Math.abs(step - Number(step.toFixed(digits))) > 0.01 * step) digits += 1;
  return splits.map((value) => (value === null ? "" : String(Number((value * factor).toFixed(digits)))));
};

function axis(scale, label, more = {}) {
  return { scale, label, labelSize: 18, labelGap: 0, size: 58, font: "11px system-ui", labelFont: "12px system-ui", stroke: () => colour("quiet"),
    grid: { stroke: () => colour("grid"), width: 1 }, ticks: { stroke: () => colour("line"), size: 4 }, ...more };
}

const beside = { space: 24 };
const below = { size: 34, labelSize: 16 };

function made(place, options, data) {
  const chart = new uPlot({ width: place.clientWidth || 300, height: place.clientHeight || 150, legend: { show: false }, padding: [6, 10, 0, 0], ...options }, data, place);
  new ResizeObserver(() => chart.setSize({ width: place.clientWidth, height: place.clientHeight })).observe(place);
  return chart;
}

/** Return the header and the numbers of a frame of the server. */
export function readFrame(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  return [header, new Float32Array(buffer, 4 + length)];
}

/** Largest distance of a guest signal that stays in sight, as a multiple of the span of the others. */
const FAR = 20;

/** Signals over time: the minimum and the maximum of each column of the screen. */
export class Traces {
  constructor() { this.columns = 0; this.signals = {}; this.rate = 1; this.length = 1; this.end = 0; this.epoch = -1; this.next = -1; }
  take(header, numbers) {
    const { bins, columns, shown } = header;
    const fresh = header.fresh || columns !== this.columns || header.first !== this.next;
    if (fresh) this.signals = {};
    if (fresh) for (const name of shown) this.signals[name] = new Float32Array(2 * columns).fill(NaN);
    Object.assign(this, { columns, rate: header.rate, length: header.length, end: header.end, epoch: header.epoch, next: header.first + bins });
    shown.forEach((name, index) => {
      const own = this.signals[name], count = Math.min(2 * bins, own.length);
      own.copyWithin(0, count);
      own.set(numbers.subarray(index * 2 * bins + 2 * bins - count, (index + 1) * 2 * bins), own.length - count);
    });
    return fresh;
  }
  times() {
    const step = this.length / this.rate / 2;
    return Array.from({ length: 2 * this.columns }, (_, index) => (index + 1 - 2 * this.columns) * step);
  }
  values(name) { return Array.from(this.signals[name] || [], (value) => (Number.isNaN(value) ? null : value)); }
}

/** A chart of some signals over time. */
export class TimeChart {
  constructor(place, traces, series, marks, more = {}) {
    Object.assign(this, { place, traces, series, marks, more, range: {} , limits: [] });
    for (const { scale, least } of series) this.range[scale] ??= new Range(least);
    this.units = {};
    this.make();
  }
  make() {
    const axes = [axis("x", this.more.x ? "time before now (s)" : "", this.more.x ? below : { size: 6, labelSize: 0, values: () => [] })];
    [...new Set(this.series.map((one) => one.scale))].forEach((scale, index) => {
      const { unit, title } = this.series.find((one) => one.scale === scale);
      const factor = () => (unit === "m" ? this.unitOf(scale) : [unit, 1]);
      const own = this.more.names ? { splits: () => this.more.names.map((name, place) => place), values: () => [] } : { values: (chart, splits) => ticks(factor()[1])(chart, splits) };
      axes.push(axis(scale, unit ? `${title} (${factor()[0]})` : title, { side: index ? 1 : 3, size: this.more.size || 58, ...own, ...beside, grid: { show: !index, stroke: () => colour("grid"), width: 1 } }));
    });
    const scales = { x: { time: false, range: () => [-(this.traces.columns * this.traces.length) / this.traces.rate, 0] } };
    for (const scale of Object.keys(this.range)) scales[scale] = { range: () => this.spanOf(scale) };
    const lines = this.series.map((one) => ({ scale: one.scale, label: one.name, stroke: () => colour(one.colour), width: one.width || 1.5, dash: one.dash, points: { show: false } }));
    this.chart = made(this.place, { axes, scales, series: [{}, ...lines], padding: [6, axes.length > 2 || this.more.size ? 10 : 86, 0, 0], cursor: { sync: { key: "time" }, drag: { setScale: false, x: false, y: false }, points: { size: 6 } }, hooks: { draw: [() => this.decorate()] } }, [[], ...lines.map(() => [])]);
  }
  unitOf(scale) { const { low, high } = this.range[scale]; return Number.isFinite(low) ? lengthUnit(Math.max(Math.abs(low), Math.abs(high), 1e-10)) : ["µm", 1e6]; }
  spanOf(scale) {
    if (this.more.names) return [-0.6, this.more.names.length - 0.4];
    const of = (guests) => extent(this.series.filter((one) => one.scale === scale && Boolean(one.guest) === guests).map((one) => this.traces.signals[one.signal] || []));
    const found = of(false), guests = of(true), reach = FAR * Math.max(found[1] - found[0], this.range[scale].least);
    if (guests[0] > found[1] - reach && guests[1] < found[0] + reach) { found[0] = Math.min(found[0], guests[0]); found[1] = Math.max(found[1], guests[1]); }
    const limits = this.limits.filter((limit) => limit.scale === scale && limit.wide).map((limit) => limit.value);
    return this.range[scale].of(Math.min(found[0], ...limits), Math.max(found[1], ...limits));
  }
  draw() {
    this.chart.setData([this.traces.times(), ...this.series.map((one) => this.traces.values(one.signal))]);
    for (const one of this.series.filter((given) => given.unit === "m")) {
      const label = `${one.title} (${this.unitOf(one.scale)[0]})`, own = this.chart.axes.find((given) => given.scale === one.scale);
      if (own.label !== label) { this.chart.destroy(); this.make(); return; }
    }
  }
  rebuild() { this.chart.destroy(); this.make(); }
  destroy() { this.chart.destroy(); }
  line(ctx, x0, y0, x1, y1, stroke, dash) { ctx.strokeStyle = stroke; ctx.setLineDash(dash); ctx.beginPath(); ctx.moveTo(x0, y0); ctx.lineTo(x1, y1); ctx.stroke(); }
  decorate() {
    const { ctx, bbox } = this.chart;
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    ctx.lineWidth = devicePixelRatio;
    for (const { scale, value } of this.limits) {
      const y = this.chart.valToPos(value, scale, true);
      this.line(ctx, bbox.left, y, bbox.left + bbox.width, y, colour("limit"), [6, 4]);
    }
    ctx.font = `${11 * devicePixelRatio}px system-ui`; ctx.textAlign = "left"; ctx.textBaseline = "middle"; ctx.fillStyle = colour("quiet");
    (this.more.names || []).forEach((name, place) => ctx.fillText(name, bbox.left + 4 * devicePixelRatio, this.chart.valToPos(place, this.series[0].scale, true)));
    ctx.textBaseline = "alphabetic";
    for (const { sample, text, epoch } of this.marks.marks) {
      if (epoch !== this.traces.epoch) continue;
      const x = this.chart.valToPos((sample - this.traces.end) / this.traces.rate, "x", true);
      this.line(ctx, x, bbox.top, x, bbox.top + bbox.height, colour("quiet"), [2, 3]);
      ctx.fillStyle = colour("quiet"); if (this.more.words) ctx.fillText(text, x + 4, bbox.top + 12 * devicePixelRatio);
    }
    for (const [name, mark] of [["saturated", "warning"], ["skipped", "bad"]]) this.flags(ctx, bbox, this.traces.signals[name] || [], colour(mark));
    ctx.restore();
  }
  flags(ctx, bbox, values, fill) {
    if (!this.more.flags) return;
    ctx.fillStyle = fill;
    const step = bbox.width / Math.max(values.length, 1);
    values.forEach((value, index) => { if (value > 0) ctx.fillRect(bbox.left + index * step, bbox.top + bbox.height - 5 * devicePixelRatio, Math.max(step, 1.5), 5 * devicePixelRatio); });
  }
}

/** A curve of one signal over another; older parts are fainter. */
export class LoopChart {
  constructor(place, names, labels, unit) {
    Object.assign(this, { place, names, labels, unit });
    this.ranges = [new Range(unit === "V" ? 0.01 : 1e-9), new Range(1e-9)];
    this.points = [[], []];
    this.make();
  }
  words() {
    const of = ({ low, high }) => (Number.isFinite(low) ? lengthUnit(Math.max(Math.abs(low), Math.abs(high))) : ["µm", 1e6]);
    return [this.unit === "V" ? ["V", 1] : of(this.ranges[0]), of(this.ranges[1])];
  }
  make() {
    this.made = this.words();
    const [[xUnit, xFactor], [yUnit, yFactor]] = this.made;
    const axes = [axis("x", `${this.labels[0]} (${xUnit})`, { ...below, values: ticks(xFactor) }), axis("y", `${this.labels[1]} (${yUnit})`, { ...beside, values: ticks(yFactor) })];
    const scales = { x: { time: false, range: () => this.ranges[0].of(...extent([this.points[0]])) }, y: { range: () => this.ranges[1].of(...extent([this.points[1]])) } };
    this.chart = made(this.place, { axes, scales, series: [{}, { scale: "y", points: { show: false } }], cursor: { show: false }, hooks: { draw: [() => this.curve()] } }, [[0, 1], [null, null]]);
  }
  rebuild() { this.chart.destroy(); this.make(); }
  destroy() { this.chart.destroy(); }
  draw(loops) {
    this.points = this.names.map((name) => loops[name]);
    this.chart.setData([[0, 1], [null, null]]);
    if (this.words().join() !== this.made.join()) this.rebuild();
  }
  curve() {
    const { ctx, bbox } = this.chart, [xs, ys] = this.points;
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    ctx.strokeStyle = colour("measured"); ctx.lineWidth = 1.5 * devicePixelRatio; ctx.lineJoin = "round";
    const parts = 4, size = xs.length;
    for (let part = 0; part < parts; part++) {
      ctx.globalAlpha = 0.2 + (0.8 * (part + 1)) / parts ** 1 * (part === parts - 1 ? 1 : 0.5);
      ctx.beginPath();
      let pen = false;
      for (let index = Math.max(Math.floor((part * size) / parts) - 1, 0); index < ((part + 1) * size) / parts; index++) {
        const x = xs[index], y = ys[index];
        if (Number.isNaN(x) || Number.isNaN(y)) { pen = false; continue; }
        const [left, top] = [this.chart.valToPos(x, "x", true), this.chart.valToPos(y, "y", true)];
        if (pen) ctx.lineTo(left, top); else ctx.moveTo(left, top);
        pen = true;
      }
      ctx.stroke();
    }
    ctx.restore();
  }
}

/** The path of two axes in their plane over its reference; the larger the error, the redder the path. Both scales are equal. */
export class PlaneChart {
  constructor(place) {
    Object.assign(this, { place, now: { names: ["x", "y"], reference: [[], []], path: [[], []], error: [], largest: 0 }, ranges: [new Range(1e-9), new Range(1e-9)] });
    this.make();
  }
  words() {
    const size = Math.max(...this.ranges.map(({ low, high }) => (Number.isFinite(low) ? Math.max(Math.abs(low), Math.abs(high)) : 1e-6)));
    return [...lengthUnit(size), ...this.now.names];
  }
  spans() {
    const own = this.ranges.map((range, index) => range.of(...extent([this.now.reference[index], this.now.path[index]])));
    const box = this.chart?.bbox, [width, height] = box?.width ? [box.width, box.height] : [2, 1];
    const scale = Math.max((own[0][1] - own[0][0]) / width, (own[1][1] - own[1][0]) / height);
    return own.map(([low, high], index) => { const half = (scale * [width, height][index]) / 2, middle = (low + high) / 2; return [middle - half, middle + half]; });
  }
  make() {
    this.made = this.words();
    const [unit, factor, x, y] = this.made;
    const axes = [axis("x", `${x} (${unit})`, { ...below, values: ticks(factor) }), axis("y", `${y} (${unit})`, { ...beside, values: ticks(factor) })];
    const scales = { x: { time: false, range: () => this.spans()[0] }, y: { range: () => this.spans()[1] } };
    this.chart = made(this.place, { axes, scales, series: [{}, { scale: "y", points: { show: false } }], cursor: { show: false }, hooks: { draw: [() => this.paths()] } }, [[0, 1], [null, null]]);
  }
  rebuild() { this.chart.destroy(); this.make(); }
  destroy() { this.chart.destroy(); }
  draw(now) {
    this.now = now;
    this.chart.setData([[0, 1], [null, null]]);
    if (this.words().join() !== this.made.join()) this.rebuild();
  }
  curve(ctx, [xs, ys], stroke, width) {
    ctx.strokeStyle = colour(stroke); ctx.lineWidth = width * devicePixelRatio;
    ctx.beginPath();
    xs.forEach((x, index) => { const place = [this.chart.valToPos(x, "x", true), this.chart.valToPos(ys[index], "y", true)]; if (index) ctx.lineTo(...place); else ctx.moveTo(...place); });
    ctx.stroke();
  }
  paths() {
    const { ctx, bbox } = this.chart, { reference, path, error, largest } = this.now;
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    ctx.lineJoin = "round";
    ctx.globalAlpha = 0.45;
    this.curve(ctx, reference, "reference", 5);
    ctx.globalAlpha = 1;
    this.curve(ctx, path, "measured", 1.5);
    ctx.strokeStyle = colour("bad"); ctx.lineWidth = 2.5 * devicePixelRatio;
    for (let index = 1; index < error.length && largest > 0; index++) {
      const share = error[index] / largest;
      if (share < 0.5) continue;
      ctx.globalAlpha = share;
      ctx.beginPath();
      ctx.moveTo(this.chart.valToPos(path[0][index - 1], "x", true), this.chart.valToPos(path[1][index - 1], "y", true));
      ctx.lineTo(this.chart.valToPos(path[0][index], "x", true), this.chart.valToPos(path[1][index], "y", true));
      ctx.stroke();
    }
    ctx.restore();
  }
}

/** Amplitude density of the error over frequency, both logarithmic. */
export class SpectrumChart {
  constructor(place) { this.place = place; this.data = [[1, 10], [null, null]]; this.make(); }
  make() {
    const decade = (low, high) => [10 ** Math.floor(Math.log10(low)), 10 ** Math.ceil(Math.log10(high))];
    const powers = (chart, splits) => splits.map((value) => (value === null ? "" : power(value)));
    const axes = [axis("x", "frequency (Hz)", { ...below, values: powers }), axis("y", "error (nm/√Hz)", { values: powers })];
    const scales = { x: { time: false, distr: 3, range: (chart, low, high) => [low || 1, high || 10] }, y: { distr: 3, range: (chart, low, high) => (low > 0 ? decade(low, high) : [1e-3, 10]) } };
    this.chart = made(this.place, { axes, scales, series: [{}, { scale: "y", stroke: () => colour("error"), width: 1.5, points: { show: false }, fill: () => `${colour("error")}22` }], cursor: { drag: { setScale: false, x: false, y: false } } }, this.data);
  }
  rebuild() { this.chart.destroy(); this.make(); }
  destroy() { this.chart.destroy(); }
  draw({ frequency, density }) {
    if (!frequency.length) return "";
    const shown = density.map((value) => Math.max(value * 1e9, 1e-9));
    this.data = [frequency, shown];
    this.chart.setData(this.data);
    const best = shown.indexOf(Math.max(...shown));
    return `highest at ${Number(frequency[best].toPrecision(3))} Hz`;
  }
}
