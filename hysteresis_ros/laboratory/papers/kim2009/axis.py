# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The axis of Kim, Kim & Park 2009: published values, assumptions, and the conditions of each experiment."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.laboratory.papers.runs import run
from hysteresis_ros.recordings.dataset import Recording

# Published values, SI units.
STEP = 1.0  # V before the amplifier
STEP_TIME = 0.4  # s
UNCONTROLLED_PEAK = (3.7e-6, 3.8e-6)  # m, section 4.2 and figure 12
HALF_DIGIT = 0.05e-6  # m, half a unit of the last digit of these two peaks
UNCONTROLLED_SETTLING = 0.5  # s
CONTROLLED_PEAK = 2.25e-6  # m
CONTROLLED_SETTLING = 0.02  # s
RESIDUAL = 0.25e-6  # m, residual displacement at 0 V without compensator
RESONANCE = 635.0  # Hz
LINEAR_GAIN = (0.5130, -1.6069, 1.1001)
OBSERVER_GAIN = (0.0040, 0.5771, 0.3558)
TRIANGLE_FREQUENCY = 2.0  # Hz
PRELOAD = 5.88  # N
STIFFNESS = 0.41e6  # N/m
PRELOAD_VOLTAGE = 20.0  # V at the stack

# Computed for the assumed plant.
POLES = (-0.700, -0.122, 0.930)
NOISE_RATIO = 0.685  # q/r
DC_GAIN = 2.05e-6  # m per V before the amplifier
#: Loop width of the branches to 120 V after Picard steps, % of the stroke: R g → steps → width.
WIDTHS = {1.0: {0: 15.0, 1: 8.2, 3: 1.7, 6: 0.26}, 1.12: {1: 9.3, 3: 1.8, 6: 0.10}}

# Assumed here; the amplifier's gain is the value in config/kim2009.yaml.
AMPLIFIER = 20.0
MAXIMUM_VOLTAGE = 120.0
SLOW_FREQUENCY = 0.05  # Hz: the lag of the dynamics is less than 0.01 % of the stroke
DISTURBANCE_VARIANCE = 0.01  # V² per sample
FAST_VARIANCE = 1.0
MISMATCH = 0.05
NOISE = 5e-9  # m rms
GAIN_TOLERANCE = 2e-4
GOOD_RESIDUAL = 0.01e-6  # m: assumed meaning of "completely removed"

MODEL = "A, B, C at 3 kHz: one of many realisations that give S, the linear gain and L; the paper prints none of them"
LAW = "Φ = 0.93, δ = 0.01; the steady-state target as reference, because the law as printed only regulates to zero"
STACK = (
    "hysteresis: gain 0.1025 µm/V, residual at 0 V 0.0125 µm per volt of the peak, loop width 15 % at 120 V; "
    "minor-loop rule"
)
AMPLIFIED = "amplifier gain 20, limits −30 … 120 V"
SETTLED = "settling: within 2 % of the step around the final value; the longest settling time of all steps"
FULL_STROKE = "triangle from 0 to the displacement at 120 V on the virgin curve (fig. 13 gives no number in the text)"
REACHED = (
    "triangle to 95 % of the displacement at 120 V, which a compensator with 5 % lower coefficients can just reach"
)
RATE = "R g = 1, and 1.12 from the printed R = 0.5475 with 2.05 µm/V"
CLEAN = "“completely removed” taken as less than 0.01 µm"
CLOSED = "“closed” taken as less than 0.01 % of the stroke"
COMPLIANCE = "W linear in the preload: A1 = B2 = 0, B1 = −1/(0.41 N/µm)"
ESTIMATOR = (
    "Kalman gain from the Riccati equation, q/r = 0.685, variance of the disturbance's change 0.01 V² per sample"
)
VIBRATING = "“remains” taken as more than 2 % of the step"
REAL = "compensator's coefficients off by ±5 % (the worse result is shown), sensor noise 5 nm rms, 16-bit converters"


def ideal(configuration: Configuration) -> Configuration:
    """Return the axis with converters of unlimited resolution; plant and compensator already share one model."""
    return configuration.override("plant_simulator", limits__bits=0).override("hysteresis_compensator", limits__bits=0)


def real(configuration: Configuration, mismatch: float) -> Configuration:
    """Return the axis with noise, 16-bit converters and the compensator's coefficients off by ``mismatch``."""
    noisy = configuration.override("plant_simulator", limits__bits=16, sensor__noise=NOISE)
    return noisy.override("hysteresis_compensator", limits__bits=16, hysteresis__polynomial__scale=1.0 + mismatch)


def real_opening(configuration: Configuration, mismatch: float) -> Configuration:
    """Return the axis of :func:`real`, but with an error ``mismatch`` only of the loop width in the compensator."""
    model = configuration.node("hysteresis_compensator")
    changed = {}
    for branch in ("rising", "falling"):
        constant, linear, quadratic = model[f"hysteresis.polynomial.{branch}_C1"]
        changed[f"hysteresis__polynomial__{branch}_C1"] = [constant, linear * (1.0 + mismatch), quadratic]
        bend = [value * (1.0 + mismatch) for value in model[f"hysteresis.polynomial.{branch}_C2"]]
        changed[f"hysteresis__polynomial__{branch}_C2"] = bend
    return real(configuration, 0.0).override("hysteresis_compensator", **changed)


def without_hysteresis(configuration: Configuration) -> Configuration:
    """Return the axis with a plant and a compensator of constant gain."""
    gain = configuration.node("plant_simulator")["hysteresis.polynomial.virgin"][1]
    values = dict(hysteresis__type="proportional", hysteresis__proportional__gain=gain)
    return configuration.override("plant_simulator", **values).override("hysteresis_compensator", **values)


def without_dynamics(configuration: Configuration) -> Configuration:
    """Return the axis with a plant that consists of its hysteresis element alone."""
    none = dict(dynamics__A=[], dynamics__B=[], dynamics__C=[], dynamics__output_scale=1.0)
    return configuration.override("plant_simulator", **none)


def uncompensated(configuration: Configuration) -> Configuration:
    """Return the axis with a compensator that only divides by its gain."""
    return configuration.override("hysteresis_compensator", inverse__type="none")


def picard(configuration: Configuration, steps: int, rate_times_gain: float) -> Configuration:
    """Return the axis with Picard steps (eq. 16)."""
    rate = rate_times_gain / configuration.node("hysteresis_compensator")["hysteresis.polynomial.virgin"][1]
    values = dict(inverse__type="picard_steps", inverse__picard_steps=steps, inverse__picard_rate=rate)
    return configuration.override("hysteresis_compensator", **values)


def open_loop(configuration: Configuration) -> Configuration:
    """Return the axis whose controller passes the reference through."""
    return configuration.override("motion_controller", type="open_loop")


def estimating(configuration: Configuration, variance: float = DISTURBANCE_VARIANCE) -> Configuration:
    """Return the axis whose Kalman filter estimates a disturbance of the command, a random walk.

    Units: ``variance`` [V²], of the disturbance's change per sample.
    """
    values = dict(kalman__gain="riccati", kalman__q=NOISE_RATIO, kalman__r=1.0)
    disturbed = dict(kalman__disturbance="constant", kalman__q_disturbance=variance)
    return configuration.override("motion_controller", **values, **disturbed)


def preloaded(configuration: Configuration) -> Configuration:
    """Return the axis under the paper's preload, known to the controller."""
    loaded = configuration.override("plant_simulator", preload__force=PRELOAD)
    return loaded.override("motion_controller", model__preload__force=PRELOAD)


def run_steps(configuration: Configuration, hold: float = STEP_TIME, size: float = STEP, cycles: int = 2) -> Recording:
    """Return a run of ``cycles`` pairs of steps, to the displacement at ``size`` [V] and back, ``hold`` s each."""
    times = [hold * (0.5 + i) for i in range(2 * cycles)]
    values = dict(waveform__type="steps", waveform__steps__values=[DC_GAIN * size, 0.0] * cycles)
    moved = configuration.override("reference_generator", **values, waveform__steps__times=times)
    return run(moved, (2 * cycles + 0.5) * hold)


def run_cycles(
    configuration: Configuration, waveform: str, stroke: float, frequency: float, cycles: int = 2
) -> Recording:
    """Return an open-loop run of ``cycles`` cycles of ``waveform`` from 0 to ``stroke`` [m]."""
    values = dict(waveform__type=waveform, waveform__frequency=frequency, maximum=1.1 * stroke)
    values |= dict(waveform__cycles=cycles)
    if waveform == "sine":
        values |= dict(waveform__offset=0.5 * stroke, waveform__amplitude=0.5 * stroke, waveform__phase=-0.5 * np.pi)
    else:
        values |= dict(waveform__amplitude=stroke)
    moved = open_loop(configuration).override("reference_generator", **values)
    return run(moved, cycles / frequency)


def off_both_ways(change, configuration: Configuration, mismatch: float = MISMATCH) -> list[Configuration]:
    """Return ``change(configuration, mismatch)`` for a model off by −``mismatch`` and by +``mismatch``."""
    return [change(configuration, sign * mismatch) for sign in (-1.0, 1.0)]


def both_ways(values, mismatch: float = MISMATCH) -> dict[str, float]:
    """Return the two values of :func:`off_both_ways` by name."""
    return {f"{sign}{100.0 * mismatch:g} %": value for sign, value in zip("−+", values, strict=True)}
