# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Figures of continuous walking over the phase: deviation of the slider from its path before and after learning.

``python -m hysteresis_ros.laboratory.papers.kim2009.walking`` prints them. The motor differs from its models: its
extender deviates at random from the configured extender, and its voltages are a sample late. The motor is simulated at
four times the sample rate, and errors are those of the true displacement at this rate. The correction is learned at one
speed and used at all speeds.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import scipy

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.control.law import APPLIED, COMMAND, FEEDFORWARD
from hysteresis_ros.laboratory.papers.kim2009.inchworm import CREEP, MISMATCH, sequencer_of
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import mismatched
from hysteresis_ros.models.inchworm import Inchworm, InchwormPlantParameters
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references.inchworm_walk import carried

#: Simulated points per sample.
INSTANTS = 4
#: Speed of learning [m/s], and walking speeds as multiples of it.
SPEED = 5.0e-5
PARTS = (0.2, 0.4, 1.0, 2.0, 4.0)
#: Default number of learned cycles.
LEARNED = 15
#: Number of cycles before an evaluated part, in addition to the one to two cycles until its first whole cycle begins.
SETTLED = 1
#: Number of evaluated cycles.
JUDGED = 2
#: Parameters of the walk: the slider oscillates on the extender at 456 Hz, the extender itself at 635 Hz, and the
#: clamps lag by 0.2 ms.
PLAIN = {"walk__continuous": True, "walk__swing": 456.0, "walk__learning_speed": SPEED}
WALK = PLAIN | {"walk__resonance": 635.0, "walk__clamp_lead": 2.0e-4, "walk__quick_clamps": True}
#: Without ``walk.resonance`` the extender's lag at a constant speed, 2 ζ/ω, is a part of ``walk.lead``.
LAG = 1.5e-5


def contacts(kick: float) -> dict[str, float]:
    """Return the plant's parameters with contacts of 20 nm/N and a kick of ``kick`` [m/N]; 0: rigid contacts."""
    if not kick:
        return {}
    found = {"inchworm__slider__damping": 0.03, "inchworm__slider__substeps": 0}
    for clamp in ("front_clamp", "rear_clamp"):
        found |= {f"inchworm__{clamp}__compliance": 2.0e-8, f"inchworm__{clamp}__kick": kick}
    return found


def _finer(plant) -> InchwormPlantParameters:
    """Return the plant's parameters for the shorter sample time, with the linear dynamics continued between samples."""
    A = np.reshape(plant.dynamics.A, (2, 2))
    part = np.real(scipy.linalg.fractional_matrix_power(A, 1.0 / INSTANTS))
    B = (np.eye(2) - part) @ np.linalg.solve(np.eye(2) - A, np.asarray(plant.dynamics.B))
    values = {item.name: getattr(plant, item.name) for item in fields(InchwormPlantParameters)}
    values["dynamics"] = LinearParameters(A=tuple(part.ravel()), B=tuple(B), C=plant.dynamics.C)
    return InchwormPlantParameters(**values)


@dataclass(frozen=True)
class Deviation:
    """Deviation of the slider from a constant speed."""

    #: RMS of path minus slider over whole cycles [m]. The path has the requested speed, and begins each cycle at the
    #: position of the slider.
    off_path: float
    ripple: float  #: RMS of the periodic part: deviation of the slider from its own mean speed and position [m].
    speed_error: float  #: Relative error of the mean speed.


class Walker:
    """An inchworm motor that walks continuously, simulated also between samples; its voltages are one sample late."""

    def __init__(self, seed: int = 1, kick: float = 0.0, told: bool = True, inverse: bool = True, plain: bool = False):
        configuration = load_configuration("inchworm_travel").override("plant_simulator", **CREEP)
        configuration = configuration.override("hysteresis_compensator", **CREEP)
        delay = (1.0e-4 if told else 0.0) + (LAG if plain else 0.0)
        configuration = configuration.override("inchworm_sequencer", **(PLAIN if plain else WALK), walk__lead=delay)
        if seed:
            configuration = mismatched(configuration, MISMATCH, seed)
        if not inverse:
            configuration = configuration.override("hysteresis_compensator", inverse__type="none", creep__type="none")
        self.axis = Axis(single_axis(configuration.override("plant_simulator", **contacts(kick))))
        parameters = self.axis.parameters.plant_simulator
        self.motor = Inchworm(_finer(parameters), 1.0 / parameters.sample_rate / INSTANTS)
        self.sequencer = sequencer_of(self.axis)
        self._late = (0.0, 100.0, 100.0)

    def sample(self) -> np.ndarray:
        """Run one sample; return the true displacement at its points [m]."""
        part, compensator = self.axis.controller, self.axis.compensator.compensator
        slider, extender = self.motor.measure()[:2]
        reference = self.sequencer.step(0.0, slider, extender)
        delayed = part.feedforward.step(reference)
        state = part.controller.x
        state[FEEDFORWARD] = part.feedforward.command
        command = part.handover.step(part.controller.step(delayed, slider - self.sequencer.origin))
        voltage = compensator.step(command)
        state[COMMAND], state[APPLIED] = command, compensator.applied
        now, self._late = self._late, (voltage, self.sequencer.front_voltage, self.sequencer.rear_voltage)
        found = np.empty(INSTANTS)
        for i in range(INSTANTS):
            found[i] = self.motor.displacement
            self.motor.advance(*now)
        return found

    def walk(self, speed: float, cycles: float) -> tuple[np.ndarray, np.ndarray]:
        """Walk at ``speed`` [m/s] for some cycles; return phase and displacement [m] at all instants."""
        self.sequencer.walk(speed)
        step = self.sequencer.parameters.walk.step
        samples = round(cycles * step / abs(speed) * self.axis.sample_rate)
        phases, found = np.empty(samples + 1), np.empty((samples, INSTANTS))
        for k in range(samples):
            found[k] = self.sample()
            phases[k] = self.sequencer.x[at.CYCLE_PHASE]
        phases[samples] = phases[samples - 1] + self.sequencer.x[at.CYCLE_RATE]
        whole = np.unwrap(phases, period=1.0)
        between = np.interp(np.arange(samples * INSTANTS) / INSTANTS, np.arange(samples + 1), whole)
        return between, found.ravel()

    def judge(self, speed: float) -> Deviation:
        """Walk at ``speed`` [m/s] and evaluate some cycles."""
        self.walk(speed, SETTLED + 1)
        phase, slider = self.walk(speed, JUDGED + 2)
        p, walk = self.sequencer.p, self.sequencer.parameters.walk
        bounds = p[at.FORWARD_BOUNDS : at.FORWARD_BOUNDS + 8]
        cycle = np.floor(phase)
        part = (phase - cycle - bounds[at.CARRY]) / (bounds[at.CARRIED] - bounds[at.CARRY])
        path = walk.step * (cycle + np.array([carried(walk.blend, value) for value in part]))
        off, stands = [], phase - cycle < bounds[at.CLOSE_FRONT]
        first = cycle[0] + 1
        for number in range(JUDGED):
            now = cycle == first + number
            off.append((path - slider)[now] - np.mean((path - slider)[now & stands]))
        judged = (cycle >= first) & (cycle < first + JUDGED)
        line = np.polyfit(path[judged], slider[judged], 1)
        ripple = slider[judged] - np.polyval(line, path[judged])
        return Deviation(float(np.sqrt(np.mean(np.concatenate(off) ** 2))), float(np.std(ripple)), float(line[0] - 1.0))

    def learn(self, cycles: float = LEARNED) -> None:
        """Learn at the speed of learning, then freeze the correction."""
        self.walk(SPEED, 1.0)
        self.sequencer.request(at.LEARN_REQUEST)
        self.walk(SPEED, cycles)
        self.sequencer.request(at.FREEZE_REQUEST)
        self.sample()


def compared(seed: int, parts=PARTS, cycles: float = LEARNED, **motor) -> dict[float, tuple[Deviation, Deviation]]:
    """Return the results of a motor before and after learning for some cycles, at multiples of the learning speed."""
    walker = Walker(seed, **motor)
    for _ in range(100):
        walker.sample()
    before = {part: walker.judge(part * SPEED) for part in parts}
    walker.learn(cycles)
    return {part: (before[part], walker.judge(part * SPEED)) for part in parts}


#: The printed cases.
CASES: dict[str, dict[str, Any]] = {
    "rigid contacts": {},
    "kick of 1 nm/N": {"kick": 1.0e-9},
    "kick of 2 nm/N": {"kick": 2.0e-9},
    "rigid, the delay of a sample unknown to the sequencer": {"told": False},
    "kick of 1 nm/N, no inverse of hysteresis and creep": {"kick": 1.0e-9, "inverse": False},
    "rigid contacts, without walk.resonance, clamp_lead and quick_clamps": {"plain": True},
    "kick of 1 nm/N, without walk.resonance, clamp_lead and quick_clamps": {"kick": 1.0e-9, "plain": True},
}


def main(arguments=None) -> None:
    """Print the figures at each speed, for the motors with the smallest and with the largest improvement."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=5, help="number of random motors")
    parser.add_argument("--case", choices=CASES, help="only this case")
    options = parser.parse_args(arguments)
    for name in [options.case] if options.case else CASES:
        print(name)
        runs = [compared(seed, **CASES[name]) for seed in range(1, options.plants + 1)]
        for part in PARTS:
            pairs = [run[part] for run in runs]
            least, most = (best(pairs, key=lambda pair: pair[0].off_path / pair[1].off_path) for best in (min, max))
            before, after = (1e9 * max(pair[i].ripple for pair in pairs) for i in (0, 1))
            gains = " … ".join(
                f"{1e9 * one.off_path:.1f} -> {1e9 * other.off_path:.1f} nm ({one.off_path / other.off_path:.1f} x)"
                for one, other in (least, most)
            )
            print(
                f"  {part * SPEED * 1e6:5.0f} um/s: off the path {gains}, ripple {before:.1f} -> {after:.1f} nm, "
                f"speed off by {100 * max(abs(pair[1].speed_error) for pair in pairs):.3f} %",
                flush=True,
            )


if __name__ == "__main__":
    main()
