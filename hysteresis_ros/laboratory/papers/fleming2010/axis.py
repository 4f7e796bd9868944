# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The scanner of Fleming, Aphale & Moheimani 2010, as far as the abstract describes it, and its controllers."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.control.controller import ControllerParameters, ModelParameters
from hysteresis_ros.control.damping.inner_loop import DampingParameters, closing
from hysteresis_ros.control.laws.pid import PidParameters
from hysteresis_ros.control.linearisation import linear_loop
from hysteresis_ros.control.margins import Margins, margins_of, plant_state_space
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.linear import LinearParameters, zero_order_hold

# Published values in the abstract.
INTEGRAL_BANDWIDTH, INTEGRAL_MARGIN = 15.0, 2.0  # Hz, dB: integral control
BANDWIDTH, MARGIN = 490.0, 7.0  # Hz, dB: damping and tracking
RESONANCE, LOWERED = 934.0, 140.0  # Hz; the lower one with added mass and unchanged gains
TIMES = 10.0  # "greater than 10 times"
LINES = 31.0  # images at this many lines a second

#: Damping of a single resonance for which integral control has that bandwidth at that margin.
DAMPING = INTEGRAL_BANDWIDTH / (2.0 * RESONANCE * 10.0 ** (-INTEGRAL_MARGIN / 20.0))

# Assumed here.
FEEDTHROUGH = -2.0
STEPS = 24

MODEL = (
    "one linear resonance of 934 Hz only; its damping, 0.0101, follows from integral control of 15 Hz with 2 dB; only "
    "the abstract of the paper was available, which gives no model"
)
FAST = "100 kHz, no delay: close to the analogue controller of the abstract"
GAINS = "D_f = −2 (6 dB for the inner loop), k for the largest damping, tracking gain for 7 dB: the abstract gives none"
SLOW = "20 kHz with one sample of delay; gains by `hysteresis design`, resonance ±10 %, M_s ≤ 1.6 of the PID's loop"


def scanner(frequency: float, sample_time: float, delay: float = 0.0) -> LinearParameters:
    """Return the scanner with its resonance at a frequency.

    Units: ``frequency`` [Hz], ``sample_time`` [s], ``delay`` [s].
    """
    omega = 2.0 * np.pi * frequency
    A, B = zero_order_hold(
        [[0.0, 1.0], [-omega * omega, -2.0 * DAMPING * omega]], [[0.0], [omega * omega]], sample_time
    )
    matrices: dict[str, Any] = {"A": tuple(A.ravel().tolist()), "B": tuple(B[:, 0].tolist()), "C": (1.0, 0.0)}
    return LinearParameters(**matrices, sample_time=sample_time, delay=delay)


def integral(gain: float, dynamics: LinearParameters) -> ControllerParameters:
    """Return integral control.

    Units: ``gain`` [1/s].
    """
    own: dict[str, Any] = {"pid": PidParameters(Ki=float(gain))}  # a group that the law declares
    return ControllerParameters(type="pid", model=ModelParameters(dynamics=dynamics), **own)


def tracking(gain: float, k: float, dynamics: LinearParameters) -> ControllerParameters:
    """Return damping and tracking as in the paper: an integrator in front of C₂(s) = −k/(s − k D_f).

    Here the law's output enters after C₂, so the law must contain the pole of C₂ too. The law gain k/(γ s (s + N)) with
    N = −k D_f is a PID with derivative filter N.

    Units: ``gain`` [1/s], ``k`` [1/s].
    """
    N, forward = -k * FEEDTHROUGH, 1.0 + 1.0 / FEEDTHROUGH
    whole = float(gain * k / forward)
    own: dict[str, Any] = {"pid": PidParameters(Kp=-whole / N**2, Ki=whole / N, Kd=whole / N**3, derivative_filter=N)}
    damping = DampingParameters.from_mapping({"type": "irc", "irc.k": k, "irc.feedthrough": FEEDTHROUGH})
    return ControllerParameters(type="pid", model=ModelParameters(dynamics=dynamics), damping=damping, **own)


def judged(parameters: ControllerParameters, frequency: float = RESONANCE) -> Margins:
    """Return the margins of a controller with the resonance at another frequency.

    Units: ``frequency`` [Hz].
    """
    model = parameters.model.dynamics
    T = model.sample_time
    controller, _ = linear_loop(parameters, T)
    around = closing(parameters.damping, model, T)
    return margins_of(controller, around(plant_state_space(scanner(frequency, T, model.delay))), T)


def best_k(frequency: float = RESONANCE) -> float:
    """Return the k [1/s] with the largest damping of the resonance, by the roots of the characteristic polynomial.

    Units: ``frequency`` [Hz].
    """
    omega = 2.0 * np.pi * frequency

    def damping(k):
        polynomial = np.polymul([1.0, 2.0 * DAMPING * omega, omega**2], [1.0, -k * FEEDTHROUGH])
        roots = np.roots(np.polysub(polynomial, [k * omega**2]))
        return float(np.min(-roots.real / np.abs(roots)))

    found = np.geomspace(0.05, 5.0, 2000) * omega
    return float(f"{max(found, key=damping):.4g}")


def largest(good: Callable[[float], bool], low: float, high: float) -> float:
    """Return the largest gain that satisfies a condition."""
    for _ in range(STEPS):
        middle = float(np.sqrt(low * high))
        try:
            low, high = (middle, high) if good(middle) else (low, middle)
        except ParameterError:  # unstable on its own model
            high = middle
    return low


def designed(configuration: Configuration) -> dict[str, ControllerParameters]:
    """Return integral control with 2 dB, damping and tracking with 7 dB, and a variant stable down to 140 Hz."""
    return _designed(single_axis(configuration).motion_controller.model.dynamics)


@functools.lru_cache(maxsize=4)
def _designed(dynamics: LinearParameters) -> dict[str, ControllerParameters]:
    k = best_k()
    alone = largest(lambda gain: judged(integral(gain, dynamics)).gain_margin >= INTEGRAL_MARGIN, 1.0, 1e3)
    fast = largest(lambda gain: judged(tracking(gain, k, dynamics)).gain_margin >= MARGIN, 10.0, 1e4)
    calm = largest(lambda gain: judged(tracking(gain, k, dynamics), LOWERED).stable, 1.0, fast)
    return {
        "integral": integral(alone, dynamics),
        "tracking": tracking(fast, k, dynamics),
        "any mass": tracking(calm, k, dynamics),
    }
