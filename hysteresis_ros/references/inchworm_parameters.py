# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameters of the inchworm sequencer: gait, continuous walking, fine positioning, guards, schedule.

The rear clamp sits on the body, the front clamp on the tip of the extender, and a slider runs through both. With the
front clamp closed and the rear one open the slider is *carried*: it follows the extender. With the rear clamp closed
and the front one open the slider stands still, and the extender *returns*. One cycle is

    release rear, carry, grip rear, release front, return, grip front

In forward motion the extender extends while it carries and contracts while it returns; in backward motion it does the
reverse. Extension profiles are cycloidal, e(s) = s − sin(2 π s)/(2 π): velocity and acceleration are zero at both ends.

Some deviations from the path repeat in every cycle: residual hysteresis, motion of the slider as a clamp closes, a
wrong step length. They depend on the phase of the cycle and hardly on its speed. A correction as a function of the
phase, learned at one speed, is therefore valid at other speeds [1]_.

Let θ be the coefficients of a periodic cubic spline, and e the mean error of the slider in each bin of the phase. Each
cycle changes θ by γ (L e − K θ) with L = (MᵀM + S + W)⁻¹ Mᵀ and K = (MᵀM + S + W)⁻¹ W, the norm-optimal update of
iterative learning [2]_. M is the motion of the slider per unit of each coefficient: the slider follows the
extender while the front clamp is closed and the rear one open, and keeps its position when the rear clamp closes. S is
the weight of the change of θ. W is the weight of the curvature of the correction, so that the correction stays smooth
where the error does not determine it.

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

from hysteresis_ros.configuration import Parameters, group, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import kernel
from hysteresis_ros.models.linear_algebra import product, solve
from hysteresis_ros.references import inchworm_layout as at


@kernel
def cycloid(s):
    """Return the cycloidal profile, 0 at s ≤ 0 and 1 at s ≥ 1."""
    if s <= 0.0:
        return 0.0
    if s >= 1.0:
        return 1.0
    return s - elementary.sin(2.0 * math.pi * s) / (2.0 * math.pi)


@kernel
def ramp(linear, s):
    """Return the profile of a clamp's voltage: a straight line if ``linear`` is not 0, otherwise a cycloid."""
    if linear != 0.0:
        return min(max(s, 0.0), 1.0)
    return cycloid(s)


def inertia(frequency: float) -> float:
    """Return 1/ω² of a mode at ``frequency`` [Hz]: the mode's lag divided by the acceleration [s²]; 0 Hz: rigid."""
    return 1.0 / (2.0 * math.pi * frequency) ** 2 if frequency > 0.0 else 0.0


def crossing(linear: bool, level: float) -> float:
    """Return the fraction of a ramp's duration after which its profile passes ``level`` (0 … 1)."""
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if ramp(float(linear), middle) < level else (low, middle)
    return 0.5 * (low + high)


def _duration(default: float, description: str):
    return parameter(default, unit="s", low=1.0e-6, high=100.0, read_only=True, description=description)


@dataclass(frozen=True)
class GaitParameters(Parameters):
    """Durations, voltages and strokes of the gait."""

    release: float = _duration(3.0e-3, "duration of the voltage ramp that opens a clamp")
    grip: float = _duration(3.0e-3, "duration of the voltage ramp that closes a clamp")
    extend: float = _duration(6.0e-3, "duration of the extender's motion to the larger displacement")
    contract: float = _duration(6.0e-3, "duration of the extender's motion to the smaller displacement")
    settle: float = parameter(
        1.0e-3,
        unit="s",
        low=0.0,
        high=100.0,
        read_only=True,
        description="time for which the extender waits before a clamp closes",
    )
    overlap: float = parameter(
        0.0,
        unit="s",
        low=0.0,
        high=100.0,
        read_only=True,
        description="time in which one clamp already opens while the other one still closes",
    )
    clamp_ramp: str = parameter(
        "cycloidal", choices=("cycloidal", "linear"), read_only=True, description="shape of the clamps' voltage ramps"
    )
    grip_voltage: float = parameter(
        100.0, unit="V", low=-1.0e4, high=1.0e4, read_only=True, description="voltage of a closed clamp"
    )
    release_voltage: float = parameter(
        0.0, unit="V", low=-1.0e4, high=1.0e4, read_only=True, description="voltage of an open clamp"
    )
    initial_voltage: float = parameter(
        0.0,
        unit="V",
        low=-1.0e4,
        high=1.0e4,
        read_only=True,
        description="voltage of both clamps before the start, as the amplifiers output it",
    )
    threshold_voltage: float = parameter(
        50.0,
        unit="V",
        low=-1.0e4,
        high=1.0e4,
        read_only=True,
        description="voltage above which a clamp counts as closed; the two clamps are never both below it",
    )
    clamp_settling: float = parameter(
        1.0e-3,
        unit="s",
        low=0.0,
        high=100.0,
        read_only=True,
        description="settling time of a clamp's force after a change of its voltage; no ramp may be shorter",
    )
    lowest_extension: float = parameter(
        1.0e-6, unit="m", read_only=True, description="extension at one end of a full step"
    )
    highest_extension: float = parameter(
        9.0e-6, unit="m", read_only=True, description="extension at the other end of a full step"
    )
    fine_margin: float = parameter(
        0.5e-6,
        unit="m",
        low=0.0,
        read_only=True,
        description="how far fine positioning may go beyond the ends of a step; beyond this limit the extender "
        "is re-centred",
    )
    fine_window: float = parameter(
        1.0e-6,
        unit="m",
        low=1.0e-9,
        read_only=True,
        description="largest distance from the middle of the range at which fine positioning begins; beyond it the "
        "extender is re-centred",
    )
    walking_speed: float = parameter(
        0.0,
        unit="m/s",
        read_only=True,
        description="walking speed from the start; negative: backward; 0: walk to setpoints",
    )

    @property
    def stroke(self) -> float:
        """Extension of a full step [m]."""
        return self.highest_extension - self.lowest_extension

    @property
    def period(self) -> float:
        """Duration of one cycle [s]."""
        clamps = 2.0 * (self.release + self.grip - self.overlap)
        return clamps + self.extend + self.contract + 2.0 * self.settle

    @property
    def frequency(self) -> float:
        """Cycles per second [Hz]."""
        return 1.0 / self.period

    @property
    def speed(self) -> float:
        """Speed of full steps without slip [m/s]: stroke times frequency."""
        return self.stroke / self.period

    @property
    def closed_margin(self) -> float:
        """Time for which both clamps are above the threshold voltage while one clamp takes over from the other [s]."""
        span = self.grip_voltage - self.release_voltage
        level = (self.threshold_voltage - self.release_voltage) / span
        linear = self.clamp_ramp == "linear"
        closed = self.grip * crossing(linear, level)
        opens = self.grip - self.overlap + self.release * crossing(linear, 1.0 - level)
        return opens - closed

    def refuse_speed(self, speed: float) -> str | None:
        """Return why the gait cannot walk at ``speed`` [m/s], with the highest possible speed; None if it can."""
        if math.isfinite(speed) and abs(speed) <= self.speed * (1.0 + 1e-9):
            return None
        return (
            f"speed {speed:g} m/s refused: the gait reaches {self.speed:g} m/s ({self.stroke:g} m at "
            f"{self.frequency:g} Hz); shorten the gait's durations or walk slower"
        )

    def check(self):
        """Yield a Problem for each inconsistency of voltages, durations, strokes, overlap and speed."""
        low, level, high = self.release_voltage, self.threshold_voltage, self.grip_voltage
        if not low < high:
            yield Problem("grip_voltage", high, f"must be above release_voltage = {low:g} V")
            return
        if not low < level < high:
            yield Problem("threshold_voltage", level, f"must lie between {low:g} and {high:g} V (release and grip)")
            return
        if not low <= self.initial_voltage <= high:
            yield Problem("initial_voltage", self.initial_voltage, f"must lie within {low:g} … {high:g} V")
        for name in ("release", "grip"):
            value = getattr(self, name)
            if value < self.clamp_settling:
                remedy = f"shorter than the clamp's settling: must be ≥ clamp_settling = {self.clamp_settling:g} s"
                yield Problem(name, value, remedy)
        if not self.overlap < min(self.release, self.grip):
            yield Problem("overlap", self.overlap, f"must be below {min(self.release, self.grip):g} s (either ramp)")
        elif self.closed_margin < self.clamp_settling:
            remedy = (
                f"both clamps are closed for only {self.closed_margin:g} s: must be at least "
                f"clamp_settling = {self.clamp_settling:g} s, or both would be open for a moment; reduce "
                "the overlap"
            )
            yield Problem("overlap", self.overlap, remedy)
        if not self.lowest_extension < self.highest_extension:
            remedy = f"must be above lowest_extension = {self.lowest_extension:g} m"
            yield Problem("highest_extension", self.highest_extension, remedy)
        elif refused := self.refuse_speed(self.walking_speed):
            yield Problem("walking_speed", self.walking_speed, refused)


#: Number of bins of the error for each spline.
BINS_PER_SPLINE = 4
#: Weight of the change of the coefficients, and weight of the curvature of the correction, both relative to the mean of
#: the diagonal of MᵀM.
CHANGE_WEIGHT = 1.0e-3
CURVATURE_WEIGHT = 1.0e-2
#: Largest deviations of the motor from the learning's model. GAIN_RANGE: relative deviation of the ratio of the
#: slider's to the extender's motion; GRIP_RANGE: deviation of the instant at which a clamp grips or releases, as a
#: fraction of the clamp's ramp; SWING_RANGE: relative deviation of the slider's natural frequency.
GAIN_RANGE = 0.1
GRIP_RANGE = 0.02
SWING_RANGE = 0.05
#: Number of integration steps of the slider's oscillation in each bin.
STEPS_PER_BIN = 8
#: Tolerance for rounding errors of an eigenvalue of 1: modes that the learning cannot observe have the eigenvalue 1.
ROUNDING = 1.0e-9


class Offset(NamedTuple):
    """Deviations of a motor from the model: factor on its motion, fraction of a clamp's ramp, factor on frequency."""

    gain: float = 1.0
    grip: float = 0.0
    swing: float = 1.0


NOMINAL = Offset()


@dataclass(frozen=True)
class WalkParameters(Parameters):
    """Continuous walking as a function of the phase of the cycle, with a learned correction."""

    continuous: bool = parameter(
        False,
        read_only=True,
        description="true: walk at a speed without pauses; extender and clamps are functions of the phase of the cycle",
    )
    step: float = parameter(
        6.0e-6, unit="m", low=1.0e-12, high=1.0, read_only=True, description="length of a cycle of continuous walking"
    )
    blend: float = parameter(
        0.4,
        low=0.05,
        high=0.5,
        read_only=True,
        description="fraction of the carrying motion in which the speed rises, and equal fraction in which it falls; "
        "in between, the speed is constant",
    )
    lead: float = parameter(
        0.0,
        unit="s",
        low=0.0,
        high=1.0,
        read_only=True,
        description="delay of drive and sensor, by which the outputs lead the path, in addition to half a sample",
    )
    clamp_lead: float = parameter(
        0.0,
        unit="s",
        low=0.0,
        high=1.0,
        read_only=True,
        description="delay of the clamps' forces behind their voltages, by which the clamps lead the extender",
    )
    quick_clamps: bool = parameter(
        False,
        read_only=True,
        description="true: the clamp ramps have the gait's durations at any speed, and the clamps touch the slider at "
        "the same phase as with false; false: the ramps take a fixed fraction of the cycle",
    )
    learning: bool = parameter(
        False, read_only=True, description="true: learn from the start; the services ~/learn and ~/freeze change it"
    )
    gain: float = parameter(
        0.5, low=0.0, high=2.0, read_only=True, description="fraction of the error that one cycle removes"
    )
    bound: float = parameter(
        1.0e-6, unit="m", low=0.0, high=1.0, read_only=True, description="largest coefficient of the correction"
    )
    splines: int = parameter(
        32, low=8, high=128, read_only=True, description="number of splines of the correction over the phase"
    )
    learning_speed: float = parameter(
        1.0e-4,
        unit="m/s",
        low=1.0e-12,
        high=1.0,
        read_only=True,
        description="speed at which the correction is learned (within 2 %); at other speeds it is only applied",
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
        description="natural frequency of the slider on the extender, sqrt(stiffness/mass)/2π; 0: rigid",
    )
    swing_damping: float = parameter(
        0.03, low=1.0e-4, high=0.9, read_only=True, description="damping ratio of this oscillation"
    )
    resonance: float = parameter(
        0.0,
        unit="Hz",
        low=0.0,
        high=1.0e6,
        read_only=True,
        description="natural frequency of the extender itself; 0: it follows its command at once",
    )
    resonance_damping: float = parameter(
        0.03, low=1.0e-4, high=0.9, read_only=True, description="damping ratio of this resonance"
    )
    file: str = parameter(
        "",
        read_only=True,
        description="file of an initial correction, as ~/save writes it; empty: none",
        place="files",
    )
    save_file: str = parameter(
        "", read_only=True, description="file that the service ~/save writes; empty: none", place="files"
    )

    def fastest(self, gait: GaitParameters) -> float:
        """Return the highest speed [m/s]: one step per period of the gait."""
        return self.step / gait.period

    def gait_problems(self, gait: GaitParameters):
        """Yield a Problem for each inconsistency with the gait, and if the learning would not converge."""
        if not self.continuous:
            return
        if gait.overlap > 0.0:
            yield Problem("gait.overlap", gait.overlap, "must be 0 with walk.continuous, which has no overlap")
        spare = 0.5 * (gait.stroke - self.step)
        if not self.bound <= spare * (1.0 + 1e-9):
            remedy = (
                f"the correction would leave the gait's extensions: bound = {self.bound:g} m must be at "
                f"most {spare:.3g} m, half of stroke − step with stroke = {gait.stroke:g} m"
            )
            yield Problem("walk.step", self.step, remedy)
        if self.learning_speed > self.fastest(gait) * (1.0 + 1e-9):
            remedy = (
                f"must be at most {self.fastest(gait):g} m/s, the highest speed of continuous walking, or "
                "nothing would be learned"
            )
            yield Problem("walk.learning_speed", self.learning_speed, remedy)
        if abs(gait.walking_speed) > self.fastest(gait) * (1.0 + 1e-9):
            remedy = (
                f"must be at most {self.fastest(gait):g} m/s, the highest speed of continuous walking: "
                "one walk.step per period of the gait"
            )
            yield Problem("gait.walking_speed", gait.walking_speed, remedy)
        if gait.overlap == 0.0 and self.gain > 0.0:
            worst = max(contraction(self, gait, direction) for direction in (1, -1))
            if worst > 1.0 + ROUNDING:
                remedy = (
                    f"would not converge at walk.learning_speed = {self.learning_speed:g} m/s: on a motor "
                    f"whose motion deviates by {100 * GAIN_RANGE:g} %, each cycle multiplies an error by "
                    f"{worst:.3g}; lower the gain or the speed"
                )
                yield Problem("walk.gain", self.gain, remedy)


def phase_bounds(gait: GaitParameters, direction: int) -> np.ndarray:
    """Return the phases at which the processes of a cycle end, shape (8,), in the order of the layout.

    ``direction`` is 1 forward (the extender extends while it carries), −1 backward.
    """
    carrying, returning = (gait.extend, gait.contract)[::direction]
    durations = (0.5 * returning, gait.settle, gait.grip, gait.release, carrying, gait.settle, gait.grip, gait.release)
    total, found = 0.0, []
    for duration in durations:
        total += duration
        found.append(total / gait.period)
    return np.array(found)


def contacts(walk: WalkParameters, gait: GaitParameters) -> tuple[float, float]:
    """Return the fractions of a clamp's closing and opening ramp at which the clamp touches and releases the slider."""
    span = gait.grip_voltage - gait.release_voltage
    level, linear = (walk.touch_voltage - gait.release_voltage) / span, gait.clamp_ramp == "linear"
    return crossing(linear, level), crossing(linear, 1.0 - level)


def basis(phases, splines: int, second: bool = False) -> np.ndarray:
    """Return the periodic cubic B-splines at ``phases``, or their second derivatives, shape (N, splines)."""
    s = np.mod(np.asarray(phases, dtype=float), 1.0) * splines
    first = np.minimum(s.astype(int), splines - 1)
    u = s - first
    v = 1.0 - u
    values = np.zeros((len(s), splines))
    parts = v * v * v, 3 * u * u * u - 6 * u * u + 4, 3 * v * v * v - 6 * v * v + 4, u * u * u
    if second:
        parts = tuple(6.0 * splines**2 * part for part in (v, 3.0 * u - 2.0, 3.0 * v - 2.0, u))
    for offset, part in zip((-1, 0, 1, 2), parts, strict=True):
        values[np.arange(len(s)), (first + offset) % splines] += part / 6.0
    return values


def _swing_steps(walk: WalkParameters, dt: float) -> tuple[float, float, float, float]:
    """Return A (by rows) of the slider's oscillation over ``dt`` [s]; states: displacement from the tip, velocity/ω."""
    omega = 2.0 * math.pi * walk.swing
    damping = walk.swing_damping
    root = math.sqrt(1.0 - damping * damping)
    fall, turned = elementary.exp(-damping * omega * dt), math.fmod(root * omega * dt, 2.0 * math.pi)
    even, odd = fall * elementary.cos(turned), fall * elementary.sin(turned) / root
    return even + damping * odd, odd, -odd, even - damping * odd


def response(walk: WalkParameters, gait: GaitParameters, direction: int, off: Offset = NOMINAL) -> np.ndarray:
    """Return M, shape (bins, splines): slider motion in each phase bin per unit of coefficient, at the learning speed.

    The motion is measured from the extension at which the front clamp grips. While the rear clamp is open the slider
    follows the extender and oscillates; when the rear clamp grips, the slider stands still.

    Parameters
    ----------
    walk : WalkParameters
    gait : GaitParameters
    direction : int
        1 forward, −1 backward.
    off : Offset
        Deviation of the motor from the model.
    """
    bounds = phase_bounds(gait, direction)
    touches, lets_go = contacts(walk, gait)
    grips = gait.grip * (touches + off.grip) / gait.period
    opens = gait.release * (lets_go - off.grip) / gait.period
    front, rear = bounds[at.CLOSE_FRONT] + grips, bounds[at.CLOSE_REAR] + grips
    released = bounds[at.OPEN_REAR] + opens
    count = BINS_PER_SPLINE * walk.splines * STEPS_PER_BIN
    phases = (np.arange(count) + 0.5) / count
    wanted = basis(phases, walk.splines) - basis([front], walk.splines)
    moved = np.zeros_like(wanted)
    swinging = walk.swing > 0.0
    if swinging:
        rate, lead = walk.learning_speed / walk.step, inertia(walk.swing)
        lead = lead if walk.resonance > 0.0 else 0.0
        late = phases - 2.0 * walk.swing_damping * math.sqrt(lead) * rate
        wanted += lead * rate**2 * basis(late, walk.splines, second=True)
        dt = 1.0 / rate / count
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
def learning_matrices(walk: WalkParameters, gait: GaitParameters, direction: int) -> tuple[np.ndarray, np.ndarray]:
    """Return L, shape (splines, bins), and K, shape (splines, splines), computed in a fixed order of arithmetic."""
    moved = response(walk, gait, direction)
    squares = product(moved.T, moved)
    curvature = -2.0 * np.eye(walk.splines)
    curvature += np.roll(np.eye(walk.splines), 1, axis=0) + np.roll(np.eye(walk.splines), -1, axis=0)
    mean = float(np.add.accumulate(np.diagonal(squares))[-1]) / walk.splines
    change = mean * CHANGE_WEIGHT * np.eye(walk.splines)
    smooth = mean * CURVATURE_WEIGHT * product(curvature.T, curvature)
    found = solve(squares + change + smooth, np.hstack([moved.T, smooth]))
    return found[:, : len(moved)], found[:, len(moved) :]


@functools.cache
def contraction(walk: WalkParameters, gait: GaitParameters, direction: int) -> float:
    """Return the factor on the error in each cycle, for the worst motor: the spectral radius of I − γ (L M + K).

    The motors deviate from the model by ± :data:`GAIN_RANGE`, ± :data:`GRIP_RANGE` and ± :data:`SWING_RANGE`, in all
    combinations.
    """
    (learned, kept), worst = learning_matrices(walk, gait, direction), 0.0
    for gain in (1.0 - GAIN_RANGE, 1.0 + GAIN_RANGE):
        for grip in (-GRIP_RANGE, GRIP_RANGE):
            for swing in (1.0 - SWING_RANGE, 1.0 + SWING_RANGE):
                moved = response(walk, gait, direction, Offset(gain, grip, swing))
                rates = np.linalg.eigvals(product(learned, moved) + kept)
                worst = max(worst, float(np.max(np.abs(1.0 - walk.gain * rates))))
    return worst


@dataclass(frozen=True)
class FineParameters(Parameters):
    """Fine positioning: the front clamp holds the slider, and the controller measures the position of the slider."""

    enabled: bool = parameter(
        True, read_only=True, description="true: finish a move with the extender in closed loop; false: with steps only"
    )
    tolerance: float = parameter(
        10.0e-9,
        unit="m",
        low=1.0e-12,
        high=1.0,
        read_only=True,
        description="smoothed distance to the setpoint within which the motor has arrived",
    )
    speed: float = parameter(
        1.0e-3, unit="m/s", low=1.0e-12, high=1.0, read_only=True, description="highest speed of the reference"
    )
    time: float = parameter(
        2.0e-3,
        unit="s",
        low=1.0e-6,
        high=100.0,
        read_only=True,
        description="time constant of the reference's critically damped approach",
    )
    timeout: float = parameter(
        0.5,
        unit="s",
        low=1.0e-3,
        high=1.0e4,
        read_only=True,
        description="time outside of the tolerance after which the motor grips again and repeats fine positioning",
    )
    smoothing_time: float = parameter(
        5.0e-3,
        unit="s",
        low=0.0,
        high=100.0,
        read_only=True,
        description="time constant of the smoothing of the distance to the setpoint and of the slip",
    )


def _model(default: float, which: str, unit: str = ""):
    return parameter(default, unit=unit, low=-2.0, high=2.0, read_only=True, description=which)


@dataclass(frozen=True)
class LearningParameters(Parameters):
    """Learned step length: motion of the slider = gain · extension + offset, for each direction."""

    enabled: bool = parameter(True, read_only=True, description="true: learn the step length from the measured steps")
    forgetting: float = parameter(
        0.98,
        low=0.5,
        high=1.0,
        read_only=True,
        description="forgetting factor of the recursive least squares, per step",
    )
    forward_gain: float = _model(1.0, "initial gain, forward")
    forward_offset: float = _model(0.0, "initial offset, forward; negative: a load pulls back", "m")
    backward_gain: float = _model(1.0, "initial gain, backward")
    backward_offset: float = _model(0.0, "initial offset, backward; positive along the motion", "m")
    load_deflection: float = _model(0.0, "initial deflection of the extender by the load", "m")


@dataclass(frozen=True)
class GuardParameters(Parameters):
    """Limits beyond which the sequencer reports an error."""

    still_steps: int = parameter(
        5,
        low=1,
        high=1000,
        read_only=True,
        description="steps in a row without motion after which the motor stops with an error",
    )
    missed_part: float = parameter(
        0.5,
        low=0.1,
        high=0.99,
        read_only=True,
        description="fraction of the extension; a step that moves the slider by less counts as missed",
    )
    runaway: float = parameter(
        2.0e-6,
        unit="m",
        low=1.0e-12,
        high=1.0,
        read_only=True,
        description="motion of a held slider, or excess motion of a step, that counts as an error",
    )
    slip: float = parameter(
        1.0e-6,
        unit="m",
        low=1.0e-12,
        high=1.0,
        read_only=True,
        description="slip of the front clamp in fine positioning after which the motor grips again",
    )
    drift: float = parameter(
        2.0e-8,
        unit="m/s",
        low=0.0,
        high=1.0,
        read_only=True,
        description="speed below which slip of the front clamp counts as drift of the sensors or creep",
    )
    sensor_timeout: float = parameter(
        1.0e-3,
        unit="s",
        low=0.0,
        high=10.0,
        read_only=True,
        description="time without a finite measurement after which both clamps close",
    )


@dataclass(frozen=True)
class ScheduleParameters(Parameters):
    """Setpoints over time, for runs without a user."""

    values: tuple[float, ...] = parameter((), unit="m", read_only=True, description="setpoints; empty: none")
    times: tuple[float, ...] = parameter(
        (), unit="s", low=0.0, read_only=True, description="times of the setpoints, in rising order"
    )
    duration: float = parameter(0.0, unit="s", low=0.0, read_only=True, description="length of a run; 0: not stated")

    def check(self):
        """Yield a Problem if the numbers of times and values differ, or if the times do not increase."""
        if len(self.times) != len(self.values):
            yield Problem("times", self.times, f"must be {len(self.values)} numbers, one for each of values")
        elif any(later <= earlier for earlier, later in zip(self.times, self.times[1:], strict=False)):
            yield Problem("times", self.times, "must increase from one to the next")


@dataclass(frozen=True)
class InchwormSequencerParameters(Parameters):
    """Parameters of the inchworm sequencer."""

    minimum: float = parameter(-5.0e-3, description="lowest setpoint", unit="m", read_only=True)
    maximum: float = parameter(5.0e-3, description="highest setpoint", unit="m", read_only=True)
    initial_setpoint: float = parameter(
        0.0, description="setpoint until the first one is received", unit="m", read_only=True
    )
    home_position: float = parameter(0.0, description="setpoint of the service home", unit="m", read_only=True)
    resting_extension: float = parameter(
        0.0, description="extension after release, with the front clamp open", unit="m", read_only=True
    )
    gait: GaitParameters = group(GaitParameters)
    fine: FineParameters = group(FineParameters)
    learning: LearningParameters = group(LearningParameters)
    guard: GuardParameters = group(GuardParameters)
    walk: WalkParameters = group(WalkParameters)
    setpoints: ScheduleParameters = group(ScheduleParameters)

    def check(self):
        """Yield a Problem for an empty travel, configured setpoints outside of it, or walking that does not fit."""
        if not self.minimum < self.maximum:
            yield Problem("maximum", self.maximum, f"must be > minimum = {self.minimum:g} m")
            return
        places = [("initial_setpoint", self.initial_setpoint), ("home_position", self.home_position)]
        places += [("setpoints.values", value) for value in self.setpoints.values]
        for name, value in places:
            if not self.minimum <= value <= self.maximum:
                remedy = f"outside of the travel, allowed: {self.minimum:g} … {self.maximum:g} m"
                yield Problem(name, value, remedy)
        yield from self.walk.gait_problems(self.gait)

    def refuse_speed(self, speed: float) -> str | None:
        """Return why the motor cannot walk at ``speed`` [m/s], with the highest possible speed; None if it can."""
        fastest = self.walk.fastest(self.gait)
        if not self.walk.continuous or abs(speed) <= fastest * (1.0 + 1e-9):
            return self.gait.refuse_speed(speed)
        return (
            f"speed {speed:g} m/s refused: continuous walking reaches {fastest:g} m/s ({self.walk.step:g} m at "
            f"{self.gait.frequency:g} Hz); lengthen walk.step, shorten the gait's durations or walk slower"
        )
