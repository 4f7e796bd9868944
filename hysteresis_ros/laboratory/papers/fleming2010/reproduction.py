# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The claims in the abstract of Fleming, Aphale & Moheimani 2010 (integral resonant control), on an assumed scanner."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.configuration import Configuration, load_configuration, parse_configuration
from hysteresis_ros.control.controller import ControllerParameters, ModelParameters
from hysteresis_ros.control.damping.inner_loop import closing
from hysteresis_ros.control.linearisation import linear_loop
from hysteresis_ros.control.margins import close, margins_of
from hysteresis_ros.designs.damping import damping_plants, design_damping
from hysteresis_ros.designs.gains import design_gains
from hysteresis_ros.laboratory.papers.claims import (
    Claim,
    Reproduction,
    errors_comparison,
    responses_comparison,
    traces_comparison,
)
from hysteresis_ros.laboratory.papers.fleming2010 import axis as fleming
from hysteresis_ros.laboratory.papers.runs import run
from hysteresis_ros.recordings.dataset import Recording

TITLE = "Fleming, Aphale & Moheimani 2010, integral resonant control of a scanner: claims of the abstract"
LOOPS = "Bandwidth, margins, robustness (abstract)"
SCANS = "Triangle of 31 Hz, 5 µm (the abstract's images: 31 lines a second)"
HONEST = "By `hysteresis design`, 20 kHz, one sample of delay, resonance ±10 %"
#: Runs of the plots, by the controllers of :func:`~hysteresis_ros.laboratory.papers.fleming2010.axis.designed`.
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
    designed = fleming.designed(configuration)
    runs = {name: _scan(configuration, designed[name]) for name in RUNS}
    claims = [*_loop_claims(designed), *_scan_claims(runs), *_honest_claims()]
    return Reproduction("fleming2010", TITLE, tuple(claims), runs, configuration.text)


def figures(found: Reproduction) -> list:
    """Return the plots of a reproduction: captions and figures; needs Matplotlib."""
    designed = fleming.designed(parse_configuration(found.configuration, found.name))
    frequency = np.geomspace(1.0, 5e3, 1500)
    responses = {}
    for name, label in RUNS.items():
        T = designed[name].model.dynamics.sample_time
        closed = close(*linear_loop(designed[name], T))
        responses[label] = closed.response(np.exp(2j * np.pi * frequency * T))[:, 0, 0]
    runs = {label: found.runs[name] for name, label in RUNS.items()}
    errors = {label: (made.time, _error(made)) for label, made in runs.items()}
    last = (PERIODS - 1) / fleming.LINES
    return [
        ("From reference to displacement", responses_comparison(frequency, responses)),
        ("Triangle of 31 Hz: whole run, and the last period", traces_comparison(runs, (last, PERIODS / fleming.LINES))),
        ("Its errors", errors_comparison(errors)),
    ]


def _scan(configuration: Configuration, parameters: ControllerParameters) -> Recording:
    flat = parameters.to_mapping()
    chosen = {name: value for name, value in flat.items() if name.startswith(("type", "pid.", "damping.type"))}
    chosen |= {name: value for name, value in flat.items() if name.startswith("damping.irc.") and value != 0.0}
    return run(configuration.override("motion_controller", **chosen), PERIODS / fleming.LINES)


def _error(made: Recording) -> np.ndarray:
    return made["reference"] - made["displacement"]


def _loop_claims(designed) -> list[Claim]:
    alone, fast, calm = (fleming.judged(designed[name]) for name in ("integral", "tracking", "any mass"))
    heavy = fleming.judged(designed["tracking"], fleming.LOWERED)
    assumed = (fleming.MODEL, fleming.FAST)
    own = (*assumed, fleming.GAINS)
    printed = fleming.INTEGRAL_BANDWIDTH

    def row(name, quantity, measured, unit, given, **limits):
        return Claim(f"loop.{name}", LOOPS, quantity, measured, unit, paper=given, assumptions=own, **limits)

    return [
        replace(
            row("integral", "bandwidth of integral control with a gain margin of 2 dB", alone.bandwidth, "Hz", printed),
            low=0.98 * printed,
            high=1.02 * printed,
            assumptions=assumed,
            reason="by construction: the damping of the resonance was calculated from this value",
        ),
        row(
            "bandwidth",
            "bandwidth with damping, gain margin of 7 dB",
            fast.bandwidth,
            "Hz",
            fleming.BANDWIDTH,
            low=fleming.BANDWIDTH,
            reason="for a single resonance; other dynamics of the scanner are unknown",
        ),
        row("times", "relative to integral control", fast.bandwidth / alone.bandwidth, "1", "> 10", low=fleming.TIMES),
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
        last = made.time >= 1.0 / fleming.LINES
        return 100.0 * float(np.sqrt(np.mean(_error(made)[last] ** 2))) / float(np.ptp(made["reference"]))

    return [
        Claim(
            f"scan.{name}",
            SCANS,
            f"{label}: RMS error against the undelayed reference, % of the stroke",
            rms(name),
            "%",
            assumptions=(fleming.MODEL, fleming.FAST, fleming.GAINS),
        )
        for name, label in RUNS.items()
    ]


def _honest_claims() -> list[Claim]:
    T = 1.0 / SLOW_RATE
    dynamics = fleming.scanner(fleming.RESONANCE, T, T)
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
    assumed = (fleming.MODEL, fleming.SLOW)
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
