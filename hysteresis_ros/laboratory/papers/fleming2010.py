# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The claims in the abstract of Fleming, Aphale & Moheimani 2010 (integral resonant control), on an assumed scanner.

Only the abstract was available. Values of the scanner and gains that the abstract does not give are assumed.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Configuration, load_configuration, parse_configuration
from hysteresis_ros.control.controller import ControllerParameters, ModelParameters
from hysteresis_ros.control.damping.inner_loop import DampingParameters, closing
from hysteresis_ros.control.laws.pid import PidParameters
from hysteresis_ros.control.linearisation import linear_loop
from hysteresis_ros.control.margins import Margins, close, margins_of, plant_state_space
from hysteresis_ros.designs.damping import damping_plants, design_damping
from hysteresis_ros.designs.gains import design_gains
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.laboratory.papers.claims import (
    Claim,
    Reproduction,
    errors_comparison,
    responses_comparison,
    traces_comparison,
)
from hysteresis_ros.laboratory.papers.runs import run
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.linear import LinearParameters, zero_order_hold
from hysteresis_ros.recordings.dataset import Recording

# Published values in the abstract.
INTEGRAL_BANDWIDTH = 15.0  # bandwidth with integral control [Hz]
INTEGRAL_MARGIN = 2.0  # gain margin with integral control [dB]
BANDWIDTH = 490.0  # bandwidth with damping and tracking [Hz]
MARGIN = 7.0  # gain margin with damping and tracking [dB]
RESONANCE = 934.0  # [Hz]
LOWERED = 140.0  # resonance with added mass, with the same gains [Hz]
TIMES = 10.0  # "greater than 10 times"
LINES = 31.0  # lines per second of the images

#: Damping ratio of a single resonance for which integral control has the published bandwidth and gain margin.
DAMPING = INTEGRAL_BANDWIDTH / (2.0 * RESONANCE * 10.0 ** (-INTEGRAL_MARGIN / 20.0))

# Assumed here.
FEEDTHROUGH = -2.0
STEPS = 24

MODEL = (
    "one linear resonance of 934 Hz only; its damping, 0.0101, follows from integral control of 15 Hz with 2 dB; only "
    "the abstract of the paper was available, which gives no model"
)
FAST = "100 kHz, no delay: close to the analogue controller of the abstract"
GAINS = (
    "D_f = −2 (6 dB for the inner loop), k for the largest damping, tracking gain for 7 dB; the abstract gives no gains"
)
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
    own: dict[str, Any] = {"pid": PidParameters(Ki=float(gain))}  # parameters that the law declares
    return ControllerParameters(type="pid", model=ModelParameters(dynamics=dynamics), **own)


def tracking(gain: float, k: float, dynamics: LinearParameters) -> ControllerParameters:
    """Return damping and tracking as in the paper: an integrator in front of C₂(s) = −k/(s − k D_f).

    In this package the output of the law is added after C₂, so the law must also contain the pole of C₂.
    The law, ``gain`` k/(γ s (s + N)) with N = −k D_f and γ = 1 + 1/D_f, is a PID with derivative filter N.

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
    """Return the k [1/s] with the largest damping of the resonance, from the roots of the characteristic polynomial.

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
    """Return integral control (margin 2 dB), damping and tracking (7 dB), and a variant stable down to 140 Hz."""
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


TITLE = "Fleming, Aphale & Moheimani 2010, integral resonant control of a scanner: claims of the abstract"
LOOPS = "Bandwidth, margins, robustness (abstract)"
SCANS = "Triangle of 31 Hz, 5 µm (the abstract's images: 31 lines a second)"
HONEST = "By `hysteresis design`, 20 kHz, one sample of delay, resonance ±10 %"
#: Controllers of :func:`designed` whose runs are plotted, with their labels.
RUNS = {"integral": "integral control", "tracking": "damping and tracking"}
PERIODS = 4
SLOW_RATE = 20e3

STIFF = (
    "with these gains the crossover of the tracking loop is above 140 Hz, and a resonance of 140 Hz is not damped "
    "enough; the row below shows a stable design. The paper's own model and gains were not available"
)


def reproduce(configuration: Configuration | None = None) -> Reproduction:
    """Repeat the experiments of the abstract and check every claim."""
    configuration = load_configuration("fleming2010") if configuration is None else configuration
    controllers = designed(configuration)
    runs = {name: _scan(configuration, controllers[name]) for name in RUNS}
    claims = [*_loop_claims(controllers), *_scan_claims(runs), *_honest_claims()]
    return Reproduction("fleming2010", TITLE, tuple(claims), runs, configuration.original)


def figures(found: Reproduction) -> list:
    """Return the plots of a reproduction: captions and figures; needs Matplotlib."""
    controllers = designed(parse_configuration(found.configuration, found.name))
    frequency = np.geomspace(1.0, 5e3, 1500)
    responses = {}
    for name, label in RUNS.items():
        T = controllers[name].model.dynamics.sample_time
        closed = close(*linear_loop(controllers[name], T))
        responses[label] = closed.response(np.exp(2j * np.pi * frequency * T))[:, 0, 0]
    runs = {label: found.runs[name] for name, label in RUNS.items()}
    errors = {label: (made.time, _error(made)) for label, made in runs.items()}
    last = (PERIODS - 1) / LINES
    return [
        ("From reference to displacement", responses_comparison(frequency, responses)),
        ("Triangle of 31 Hz: whole run, and the last period", traces_comparison(runs, (last, PERIODS / LINES))),
        ("Its errors", errors_comparison(errors)),
    ]


def _scan(configuration: Configuration, parameters: ControllerParameters) -> Recording:
    flat = parameters.to_mapping()
    chosen = {name: value for name, value in flat.items() if name.startswith(("type", "pid.", "damping.type"))}
    chosen |= {name: value for name, value in flat.items() if name.startswith("damping.irc.") and value != 0.0}
    return run(configuration.override("motion_controller", **chosen), PERIODS / LINES)


def _error(made: Recording) -> np.ndarray:
    return made["reference"] - made["displacement"]


def _loop_claims(controllers) -> list[Claim]:
    alone, fast, calm = (judged(controllers[name]) for name in ("integral", "tracking", "any mass"))
    heavy = judged(controllers["tracking"], LOWERED)
    assumed = (MODEL, FAST)
    own = (*assumed, GAINS)
    printed = INTEGRAL_BANDWIDTH

    def row(name, quantity, measured, unit, given, **limits):
        return Claim(f"loop.{name}", LOOPS, quantity, measured, unit, paper=given, assumptions=own, **limits)

    return [
        replace(
            row("integral", "bandwidth of integral control with a gain margin of 2 dB", alone.bandwidth, "Hz", printed),
            low=0.98 * printed,
            high=1.02 * printed,
            assumptions=assumed,
            reason="holds by construction: the damping of the resonance was calculated from this value",
        ),
        row(
            "bandwidth",
            "bandwidth with damping, gain margin of 7 dB",
            fast.bandwidth,
            "Hz",
            BANDWIDTH,
            low=BANDWIDTH,
            reason="for a single resonance; other dynamics of the scanner are unknown",
        ),
        row("times", "relative to integral control", fast.bandwidth / alone.bandwidth, "1", "> 10", low=TIMES),
        row("peak", "sensitivity peak M_s with damping", fast.sensitivity_peak, "1", None, high=2.0),
        row(
            "lowered",
            "largest closed-loop pole with the resonance at 140 Hz, same gains",
            float(np.max(np.abs(heavy.poles))),
            "1",
            "stable",
            high=1.0 - 1e-9,
            reason=STIFF,
        ),
        row(
            "any_mass",
            "bandwidth at 934 Hz with the largest tracking gain that is stable from 934 to 140 Hz",
            calm.bandwidth,
            "Hz",
            None,
        ),
    ]


def _scan_claims(runs) -> list[Claim]:
    def rms(name):
        made = runs[name]
        last = made.time >= 1.0 / LINES
        return 100.0 * float(np.sqrt(np.mean(_error(made)[last] ** 2))) / float(np.ptp(made["reference"]))

    return [
        Claim(
            f"scan.{name}",
            SCANS,
            f"{label}: RMS error against the undelayed reference, % of the stroke",
            rms(name),
            "%",
            assumptions=(MODEL, FAST, GAINS),
        )
        for name, label in RUNS.items()
    ]


def _honest_claims() -> list[Claim]:
    T = 1.0 / SLOW_RATE
    dynamics = scanner(RESONANCE, T, T)
    plants = damping_plants(dynamics, T)
    plain = ControllerParameters(model=ModelParameters(dynamics=dynamics))
    damped = replace(plain, damping=design_damping("irc", dynamics, T, plants))
    found = {}
    for name, parameters in (("without", plain), ("with", damped)):
        around = closing(parameters.damping, dynamics, T)
        closed = tuple(one.closed(around) for one in plants)
        controller, _ = linear_loop(design_gains(parameters, "pid", T, plants=closed).parameters, T)
        found[name] = [margins_of(controller, one.plant, T) for one in closed]
    worst = {name: min(one.bandwidth for one in margins) for name, margins in found.items()}
    assumed = (MODEL, SLOW)
    peak = max(one.sensitivity_peak for margins in found.values() for one in margins)
    return [
        Claim("design.pid", HONEST, "PID alone: least bandwidth", worst["without"], "Hz", assumptions=assumed),
        Claim(
            "design.irc",
            HONEST,
            "PID with integral resonant control: least bandwidth",
            worst["with"],
            "Hz",
            low=5.0 * worst["without"],
            assumptions=assumed,
        ),
        Claim("design.peak", HONEST, "largest M_s of both", peak, "1", high=2.0, assumptions=assumed),
    ]
