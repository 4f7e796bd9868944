// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

// The card of an inchworm motor: the figures of its gait, its speed and its services.

import { readable } from "/charts.js";

const byId = (name) => document.getElementById(name);
const count = (value) => (value === null ? "–" : String(Math.round(value)));
const times = (value) => (value === null ? "–" : value.toFixed(4));
const SERVICES = {
  home: "moves to its home position", release: "opens the front clamp and relaxes the extender; the rear clamp holds",
  learn: "learns from the next whole cycle on", freeze: "uses the learned values without changing them", forget: "discards the learned values",
};

/** The card of a motor; `ask` asks the server, `say` shows its answer. */
export class Motor {
  constructor(ask, say) {
    this.about = null;
    const act = (words) => ask(words).then((answer) => say("motor-said", answer));
    const speed = byId("speed");
    speed.addEventListener("change", () => act({ do: "speed", value: /[a-zµ]\s*$/i.test(speed.value) ? speed.value : `${speed.value}um/s` }));
    for (const [service, title] of Object.entries(SERVICES)) {
      const button = Object.assign(document.createElement("button"), { id: service, type: "button", textContent: service, title });
      button.addEventListener("click", () => act({ do: "call", service }));
      byId("services").append(button);
    }
  }
  /** Takes the constants of a motor; null: no motor. */
  introduce(about) {
    this.about = about;
    for (const element of document.querySelectorAll(".of-motor")) element.hidden = !about;
    if (!about) return;
    for (const service of ["learn", "freeze", "forget"]) byId(service).hidden = !about.learns;
    byId("speed").title = `−${about.fastest * 1e6} … ${about.fastest * 1e6} µm/s; 0: to the setpoint`;
  }
  show(now) {
    if (!this.about || !now) return;
    const rows = [
      ["phase", now.phase === null ? "–" : this.about.phases[now.phase] ?? count(now.phase)],
      ["error", this.about.errors[now.error ?? 0] || "none"],
      ["arrived", now.arrived === null ? "–" : now.arrived ? "yes" : "no"],
      ["steps, forward minus backward", count(now.steps)],
      ["steps in total, missed", `${count(now.total_steps)}, ${count(now.missed)}`],
      ["last step: commanded, achieved", `${readable(now.step_commanded, "m")}, ${readable(now.step_achieved, "m")}`],
      ["last step: slip", readable(now.slip, "m")],
      ["learned: deflection by the load", readable(now.load_deflection, "m")],
      ["learned: gain forward, backward", `${times(now.forward_gain)}, ${times(now.backward_gain)}`],
    ];
    byId("motor").tBodies[0].replaceChildren(...rows.map(([name, text]) => {
      const row = document.createElement("tr");
      row.append(Object.assign(document.createElement("td"), { textContent: name, className: "quiet" }), Object.assign(document.createElement("td"), { textContent: text, className: "number" }));
      return row;
    }));
    const field = byId("speed");
    if (document.activeElement !== field && now.speed !== null) field.value = Number((now.speed * 1e6).toPrecision(6));
  }
}
