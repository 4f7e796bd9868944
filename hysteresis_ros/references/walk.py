# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Continuous walking of an inchworm motor: its parameters, and how its correction is learned over the phase.

What deviates from the path in the same way in each cycle (hysteresis that the inverse leaves over, clamps that push the
slider aside as they close, a step of the wrong length) depends on where the motor is in its cycle and hardly on how
fast it goes through it. A correction over the phase, learned at one speed, is therefore right at others [1]_.

With θ the coefficients of a periodic cubic spline and e the mean error of the slider in each bin of the phase, a cycle
changes θ by γ L e with L = (MᵀM + S)⁻¹ Mᵀ, the norm-optimal update of iterative learning [2]_. M says what the extender
can do: the slider follows it while the front clamp has gripped and the rear one is open, and keeps what it had when the
rear clamp closes. S weighs the change and its curvature.

References
----------
.. [1] van Meer, van Meijel, van Halsema, Verschueren, Witvoet & Oomen, Compensating hysteresis and mechanical
   misalignment in piezo-stepper actuators, arXiv:2503.13079 (2025): learning over the commutation angle.
.. [2] Amann, Owens & Rogers, Iterative learning control using optimal feedback and feedforward actions, Int. J. Control
   65 (1996) 277-293.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hysteresis_ros import elementary
from hysteresis_ros.errors import Problem
from hysteresis_ros.linear_algebra import product, solve
from hysteresis_ros.parameters import Parameters, parameter
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references.gait import GaitParameters, crossing

#: Bins of the error for each spline.
BINS_PER_SPLINE = 4
#: Weights of the change of the coefficients and of its curvature, as parts of the mean of the diagonal of MᵀM.
CHANGE_WEIGHT = 1.0e-3
CURVATURE_WEIGHT = 1.0e-2
#: How far off the motor may be from what the learning assumes: part of the extender's motion that reaches the slider,
#: when a clamp grips or lets go, as a part of its ramp, and the frequency of the slider's swing.
GAIN_RANGE = 0.1
GRIP_RANGE = 0.02
SWING_RANGE = 0.05
#: Steps of the swing in a bin.
STEPS_PER_BIN = 8
#: A mode of the learning that no cycle sees stays as it is; rounding may put it this far above one.
ROUNDING = 1.0e-9


class Offset(NamedTuple):
    """How a motor differs from what is assumed: factor on its motion, part of a clamp's ramp, factor on the swing."""

    gain: float = 1.0
    grip: float = 0.0
    swing: float = 1.0


NOMINAL = Offset()


@dataclass(frozen=True)
class WalkParameters(Parameters):
    """Continuous walking over the phase of the cycle, and the correction that is learned over it."""

    continuous: bool = parameter(
        False,
        read_only=True,
        description="walk at a speed without a rest: extender and clamps move over the phase of the cycle",
    )
    step: float = parameter(
        6.0e-6, unit="m", low=1.0e-12, high=1.0, read_only=True, description="length of a cycle of continuous walking"
    )
    blend: float = parameter(
        0.4,
        low=0.05,
        high=0.5,
        read_only=True,
        description="part of the carrying motion in which its speed rises, and in which it falls; the rest is straight",
    )
    lead: float = parameter(
        0.0,
        unit="s",
        low=0.0,
        high=1.0,
        read_only=True,
        description="delay of drive and sensor, which the outputs are ahead by, beside the half sample they are held",
    )
    learning: bool = parameter(False, read_only=True, description="learn from the start; ~/learn, ~/freeze")
    gain: float = parameter(
        0.5, low=0.0, high=2.0, read_only=True, description="part of the error that a cycle takes away"
    )
    bound: float = parameter(
        1.0e-6, unit="m", low=0.0, high=1.0, read_only=True, description="largest coefficient of the correction"
    )
    splines: int = parameter(
        32, low=8, high=128, read_only=True, description="splines of the correction over the phase"
    )
    learning_speed: float = parameter(
        1.0e-4,
        unit="m/s",
        low=1.0e-12,
        high=1.0,
        read_only=True,
        description="speed at which is learned (within 2 %); at others what was learned is used",
    )
    touch_voltage: float = parameter(
        25.0,
        unit="V",
        low=-1.0e4,
        high=1.0e4,
        read_only=True,
        description="voltage at which a clamp touches the slider",
    )
    swing: float = parameter(
        0.0,
        unit="Hz",
        low=0.0,
        high=1.0e6,
        read_only=True,
        description="natural frequency of the slider on the extender: sqrt(stiffness/mass)/2π; 0: it does not swing",
    )
    swing_damping: float = parameter(
        0.03, low=1.0e-4, high=0.9, read_only=True, description="damping ratio of the slider's swing"
    )
    file: str = parameter(
        "",
        read_only=True,
        description="file of what was learned, as ~/save writes it, to begin with; empty: nothing",
        place="files",
    )
    save_file: str = parameter(
        "", read_only=True, description="file that the service ~/save writes; empty: none", place="files"
    )

    @property
    def inertia(self) -> float:
        """How far the extender goes ahead of the slider for each acceleration of it [s²]: 1/ω² of the swing."""
        return 1.0 / (2.0 * math.pi * self.swing) ** 2 if self.swing > 0.0 else 0.0

    def fastest(self, gait: GaitParameters) -> float:
        """Return the highest speed [m/s]: a step in the gait's period."""
        return self.step / gait.period

    def gait_problems(self, gait: GaitParameters):
        """Yield what does not fit the gait: overlap, step, bound, and a learning that would not contract."""
        if not self.continuous:
            return
        if gait.overlap > 0.0:
            yield Problem("gait.overlap", gait.overlap, "must be 0 with walk.continuous, which knows no overlap")
        spare = 0.5 * (gait.stroke - self.step)
        if not self.bound <= spare * (1.0 + 1e-9):
            allowed = (
                f"with the correction beyond the gait's extensions: bound = {self.bound:g} m must be at most half of "
                f"stroke {gait.stroke:g} m − step, {spare:.3g} m"
            )
            yield Problem("walk.step", self.step, allowed)
        if self.learning_speed > self.fastest(gait) * (1.0 + 1e-9):
            allowed = f"beyond what continuous walking reaches, {self.fastest(gait):g} m/s: nothing would be learned"
            yield Problem("walk.learning_speed", self.learning_speed, allowed)
        if abs(gait.walking_speed) > self.fastest(gait) * (1.0 + 1e-9):
            allowed = f"continuous walking reaches {self.fastest(gait):g} m/s (walk.step in the gait's period)"
            yield Problem("gait.walking_speed", gait.walking_speed, allowed)
        if gait.overlap == 0.0 and self.gain > 0.0:
            worst = max(contraction(self, gait, direction) for direction in (1, -1))
            if worst > 1.0 + ROUNDING:
                allowed = (
                    f"would not contract at walk.learning_speed = {self.learning_speed:g} m/s: on a motor off by "
                    f"{100 * GAIN_RANGE:g} % a cycle multiplies an error by {worst:.3g}; lower one of them"
                )
                yield Problem("walk.gain", self.gain, allowed)


def phase_bounds(gait: GaitParameters, direction: int) -> np.ndarray:
    """Return the phases at which the processes of a cycle end, shape (8,), in the order of the layout.

    Parameters
    ----------
    gait : GaitParameters
    direction : int
        1 forward (carrying extends), −1 backward.
    """
    carrying, returning = (gait.extend, gait.contract)[::direction]
    durations = (0.5 * returning, gait.settle, gait.grip, gait.release, carrying, gait.settle, gait.grip, gait.release)
    total, found = 0.0, []
    for duration in durations:
        total += duration
        found.append(total / gait.period)
    return np.array(found)


def basis(phases, splines: int) -> np.ndarray:
    """Return the periodic cubic B-splines at ``phases``, shape (N, splines)."""
    s = np.mod(np.asarray(phases, dtype=float), 1.0) * splines
    first = np.minimum(s.astype(int), splines - 1)
    u = s - first
    v = 1.0 - u
    values = np.zeros((len(s), splines))
    parts = v * v * v, 3 * u * u * u - 6 * u * u + 4, 3 * v * v * v - 6 * v * v + 4, u * u * u
    for offset, part in zip((-1, 0, 1, 2), parts, strict=True):
        values[np.arange(len(s)), (first + offset) % splines] += part / 6.0
    return values


def _swing_steps(walk: WalkParameters, dt: float) -> tuple[float, float, float, float]:
    """Return A, row by row, of the slider's swing over ``dt`` [s]; states: displacement from the tip and velocity/ω."""
    omega = 2.0 * math.pi * walk.swing
    damping = walk.swing_damping
    root = math.sqrt(1.0 - damping * damping)
    fall, turned = elementary.exp(-damping * omega * dt), math.fmod(root * omega * dt, 2.0 * math.pi)
    even, odd = fall * elementary.cos(turned), fall * elementary.sin(turned) / root
    return even + damping * odd, odd, -odd, even - damping * odd


def response(walk: WalkParameters, gait: GaitParameters, direction: int, off: Offset = NOMINAL) -> np.ndarray:
    """Return M, shape (bins, splines): how the slider moves with the coefficients, by phase, at the speed of learning.

    The front contact takes the extension at which it grips for its zero. From when the rear clamp is open the slider
    follows, swinging; where the rear clamp grips it stays.

    Parameters
    ----------
    walk : WalkParameters
    gait : GaitParameters
    direction : int
        1 forward, −1 backward.
    off : Offset
        How the motor differs from what is assumed.
    """
    bounds = phase_bounds(gait, direction)
    span = gait.grip_voltage - gait.release_voltage
    level, linear = (walk.touch_voltage - gait.release_voltage) / span, gait.clamp_ramp == "linear"
    grips = gait.grip * (crossing(linear, level) + off.grip) / gait.period
    opens = gait.release * (crossing(linear, 1.0 - level) - off.grip) / gait.period
    front, rear = bounds[at.CLOSE_FRONT] + grips, bounds[at.CLOSE_REAR] + grips
    released = bounds[at.OPEN_REAR] + opens
    count = BINS_PER_SPLINE * walk.splines * STEPS_PER_BIN
    phases = (np.arange(count) + 0.5) / count
    wanted = basis(phases, walk.splines) - basis([front], walk.splines)
    moved = np.zeros_like(wanted)
    swinging = walk.swing > 0.0
    if swinging:
        dt = walk.step / walk.learning_speed / count
        a, b, c, d = _swing_steps(replace(walk, swing=walk.swing * off.swing), dt)
    behind, velocity = np.zeros(walk.splines), np.zeros(walk.splines)
    for k in np.flatnonzero(phases >= released):
        if phases[k] >= rear:
            moved[k] = moved[k - 1]
        elif swinging:
            behind = moved[k - 1] - wanted[k]
            behind, velocity = a * behind + b * velocity, c * behind + d * velocity
            moved[k] = wanted[k] + behind
        else:
            moved[k] = wanted[k]
    total = np.zeros((count // STEPS_PER_BIN, walk.splines))
    for i in range(STEPS_PER_BIN):
        total += moved[i::STEPS_PER_BIN]
    return total * (off.gain / STEPS_PER_BIN)


@functools.cache
def learning_matrix(walk: WalkParameters, gait: GaitParameters, direction: int) -> np.ndarray:
    """Return L, shape (splines, bins), in a fixed order of arithmetic."""
    moved = response(walk, gait, direction)
    squares = product(moved.T, moved)
    curvature = -2.0 * np.eye(walk.splines)
    curvature += np.roll(np.eye(walk.splines), 1, axis=0) + np.roll(np.eye(walk.splines), -1, axis=0)
    mean = float(np.add.accumulate(np.diagonal(squares))[-1]) / walk.splines
    weights = CHANGE_WEIGHT * np.eye(walk.splines) + CURVATURE_WEIGHT * product(curvature.T, curvature)
    return solve(squares + mean * weights, moved.T)


@functools.cache
def contraction(walk: WalkParameters, gait: GaitParameters, direction: int) -> float:
    """Return by how much a cycle multiplies an error on the worst motor: the spectral radius of I − γ L M.

    The motors are the corners around the assumed one: :data:`GAIN_RANGE`, :data:`GRIP_RANGE` and :data:`SWING_RANGE`.
    """
    learned, worst = learning_matrix(walk, gait, direction), 0.0
    for gain in (1.0 - GAIN_RANGE, 1.0 + GAIN_RANGE):
        for grip in (-GRIP_RANGE, GRIP_RANGE):
            for swing in (1.0 - SWING_RANGE, 1.0 + SWING_RANGE):
                moved = response(walk, gait, direction, Offset(gain, grip, swing))
                worst = max(worst, float(np.max(np.abs(1.0 - walk.gain * np.linalg.eigvals(product(learned, moved))))))
    return worst
