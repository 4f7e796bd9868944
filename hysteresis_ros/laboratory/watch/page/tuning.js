// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

// Parameters of the nodes as sliders and fields; units and ranges come from the parameter table of the nodes.

const TITLES = { reference_generator: "Reference generator", inchworm_sequencer: "Sequencer", motion_controller: "Controller", hysteresis_compensator: "Hysteresis compensator", plant_simulator: "Plant" };
const ORDER = Object.keys(TITLES);
const STEPS = 400;

const made = (tag, given = {}, ...inside) => { const element = Object.assign(document.createElement(tag), given); element.append(...inside); return element; };

/** Return the span of a slider: the range of the table when it is narrow, else a quarter to four times the value. */
export function span(row) {
  const { value, low, high } = row;
  if (low !== null && high !== null && (value === 0 || high - low <= 16 * Math.abs(value))) return { low, high, log: false };
  if (value === 0 || !Number.isFinite(value)) return null;
  const ends = [value / 4, value * 4].sort((a, b) => a - b);
  const clipped = [Math.max(ends[0], low ?? -Infinity), Math.min(ends[1], high ?? Infinity)];
  return { low: clipped[0], high: clipped[1], log: clipped[0] > 0 };
}

const toStep = ({ low, high, log }, value) => Math.round(STEPS * (log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low)));
const toValue = ({ low, high, log }, step) => Math.min(high, Math.max(low, Number((log ? low * (high / low) ** (step / STEPS) : low + ((high - low) * step) / STEPS).toPrecision(4))));

/** Sends a value whenever it changes, but not before the last one was answered. */
export function throttled(send) {
  let busy = false, next = null;
  return async function give(value) {
    if (busy) { next = [value]; return; }
    busy = true;
    try { await send(value); } finally { busy = false; }
    if (next) { const [later] = next; next = null; give(later); }
  };
}

class Parameter {
  constructor(node, row, ask) {
    Object.assign(this, { node, row, ask });
    this.said = made("p", { className: "said" });
    this.field = this.makeField();
    const head = made("div", { className: "name" }, made("label", { textContent: row.name, title: `${row.about}\n${row.allowed}` }));
    const wide = row.type.endsWith("array");
    const pair = made("span", { className: "pair" }, this.field, made("span", { className: "unit", textContent: row.unit === "1" ? "" : row.unit }));
    this.box = made("div", { className: "parameter" }, head);
    if (wide) { this.field.classList.add("wide"); this.box.append(this.field); } else head.append(pair);
    this.field.setAttribute("aria-label", `${node} ${row.name}`);
    this.makeSlider();
    this.box.append(made("div", { className: "quiet", textContent: row.allowed }), this.said);
  }
  makeField() {
    const { row } = this;
    if (row.type === "bool") {
      const box = made("input", { type: "checkbox", checked: row.value });
      box.addEventListener("change", () => this.give(String(box.checked)));
      return box;
    }
    if (row.choices) {
      const list = made("select", {}, ...row.choices.map((choice) => made("option", { value: choice, textContent: choice || "(none)" })));
      list.value = row.value;
      list.addEventListener("change", () => this.give(list.value));
      return list;
    }
    const field = made("input", { value: this.text(row.value), spellcheck: false });
    field.addEventListener("change", () => this.give(field.value));
    field.addEventListener("keydown", (event) => { if (event.key === "Escape") { event.stopPropagation(); field.value = this.text(this.row.value); field.blur(); } });
    return field;
  }
  makeSlider() {
    if (!["double", "integer"].includes(this.row.type)) return;
    this.span = span(this.row);
    if (!this.span || !(this.span.high > this.span.low)) return;
    this.slider = made("input", { type: "range", min: 0, max: STEPS, step: 1, title: `${this.span.low} … ${this.span.high}` });
    this.slider.value = toStep(this.span, this.row.value);
    this.slider.setAttribute("aria-label", `${this.node} ${this.row.name} slider`);
    const give = throttled((value) => this.give(value));
    this.slider.addEventListener("input", () => {
      const value = toValue(this.span, Number(this.slider.value));
      this.field.value = this.text(this.row.type === "integer" ? Math.round(value) : value);
      give(this.field.value);
    });
    this.box.append(this.slider);
  }
  text(value) {
    if (Array.isArray(value)) return `[${value.map((one) => this.text(one)).join(", ")}]`;
    return typeof value === "number" && value !== 0 && Math.abs(value) < 1e-3 ? value.toExponential() : String(value);
  }
  async give(text) {
    const { ok, text: said } = await this.ask({ do: "set", node: this.node, values: { [this.row.name]: text } });
    this.said.textContent = ok ? "" : said;
    this.said.classList.toggle("bad", !ok);
    this.box.classList.toggle("changed", ok);
    this.box.classList.toggle("refused", !ok);
    if (!ok) this.show(this.row, true);
  }
  show(row, refused = false) {
    this.row = row;
    if (this.row.type === "bool") this.field.checked = row.value;
    else if (refused || document.activeElement !== this.field) this.field.value = row.choices ? row.value : this.text(row.value);
    if (!this.slider || (document.activeElement === this.slider && !refused)) return;
    this.span = span(row) || this.span;
    this.slider.value = toStep(this.span, row.value);
  }
}

/** All parameters; rebuilt when the set of parameters in use changes, else only the values are updated. */
export class Tuning {
  constructor(place, filter, ask) {
    Object.assign(this, { place, filter, ask, rows: new Map(), shape: "" });
    filter.addEventListener("input", () => this.choose());
  }
  show(nodes) {
    const found = ORDER.filter((node) => nodes[node]).flatMap((node) => nodes[node].map((row) => [node, row]));
    const shape = found.map(([node, row]) => `${node} ${row.name}`).join();
    if (shape !== this.shape) this.build(nodes, shape);
    else for (const [node, row] of found) this.rows.get(`${node} ${row.name}`).show(row);
  }
  build(nodes, shape) {
    const open = new Set([...this.place.querySelectorAll("details[open]")].map((one) => one.dataset.name));
    const first = !this.shape;
    this.shape = shape;
    this.rows.clear();
    this.place.replaceChildren();
    for (const node of ORDER.filter((name) => nodes[name])) {
      const box = made("details", { open: first ? node === "motion_controller" : open.has(node) }, made("summary", { textContent: TITLES[node] }));
      box.dataset.name = node;
      const law = nodes[node].find((row) => row.name === "type")?.value;
      const groups = new Map();
      for (const row of nodes[node]) {
        const group = row.name.includes(".") ? row.name.split(".")[0] : "";
        groups.set(group, [...(groups.get(group) || []), row]);
      }
      for (const [group, rows] of [...groups].sort(([a], [b]) => (b === law) - (a === law))) {
        const hint = group === "waveform" ? [made("p", { className: "quiet", textContent: "Press hold first: a waveform can change only while the reference is held. Start begins the waveform." })] : [];
        const inner = made("details", { open: first ? group === law || node === "reference_generator" : open.has(`${node} ${group}`) }, made("summary", { textContent: group || "general" }));
        inner.dataset.name = `${node} ${group}`;
        inner.append(...hint);
        for (const row of rows.sort((a, b) => a.type.endsWith("array") - b.type.endsWith("array"))) {
          const parameter = new Parameter(node, row, this.ask);
          this.rows.set(`${node} ${row.name}`, parameter);
          inner.append(parameter.box);
        }
        box.append(inner);
      }
      this.place.append(box);
    }
    this.choose();
  }
  choose() {
    const words = this.filter.value.trim().toLowerCase();
    for (const [name, { box, row }] of this.rows) box.hidden = Boolean(words) && !`${name} ${row.unit} ${row.about}`.toLowerCase().includes(words);
    for (const one of this.place.querySelectorAll("details")) {
      const any = [...one.querySelectorAll(".parameter")].some((box) => !box.hidden);
      one.hidden = !any;
      if (words && any) one.open = true;
    }
  }
}
