# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The comparison of Auwal et al. 2017 (section 5, B6): PID and inverse, as printed and under realistic conditions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.control.controller import ControllerParameters, controller_block
from hysteresis_ros.control.laws.pid import pid_state_space
from hysteresis_ros.control.linearisation import margins
from hysteresis_ros.control.margins import close, plant_state_space
from hysteresis_ros.designs.gains import criterion_of
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.identification.restarted_nelder_mead import SimplexSettings, restarted_nelder_mead
from hysteresis_ros.laboratory.papers.auwal2017 import axis as auwal
from hysteresis_ros.laboratory.papers.auwal2017.model import PUBLISHED_BOUC_WEN
from hysteresis_ros.laboratory.papers.claims import Claim
from hysteresis_ros.laboratory.papers.runs import SAMPLE_TIME, worst
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import part
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.hysteresis.bouc_wen import BoucWenHysteresis
from hysteresis_ros.models.linear import StateSpace
from hysteresis_ros.recordings.dataset import Recording

ASSUMED = (auwal.TRIANGLE, auwal.SAMPLED, auwal.CORRECTED, auwal.UNLIMITED)
#: Additional assumptions of some control schemes.
FURTHER = {"none": (auwal.GAIN,), "pid": (auwal.FILTERED,), "combined": (auwal.FILTERED,)}


@dataclass(frozen=True, eq=False)
class Tuning:
    """PID gains by Nelder-Mead from the paper's initial guess."""

    trajectory: np.ndarray  #: shape (iterations + 1, 3); K_P, K_I and K_D after each iteration, model units.
    costs: np.ndarray  #: shape (iterations + 1,); IAE after each iteration [m s].
    published: float  #: IAE with the paper's gains [m s].
    published_peak: float  #: published_peak, peak: Sensitivity peaks on G2 with the paper's and with the tuned gains.
    peak: float


def tune(configuration: Configuration, iterations: int = auwal.TUNING_ITERATIONS) -> Tuning:
    """Tune the PID on the paper's triangle and plant, offline as in the paper."""
    parameters = single_axis(auwal.driven(auwal.at_rate(configuration, auwal.SLOW_RATE), "pid"))
    control = part(parameters.motion_controller, ControllerParameters)
    axis = Axis(parameters)
    setpoints = np.zeros(axis.default_samples())
    sample_time = 1.0 / axis.sample_rate

    def with_gains(gains) -> ControllerParameters:
        Kp, Ki, Kd = (float(gain) for gain in gains)
        return replace(control, pid=replace(control.pid, Kp=Kp, Ki=Ki, Kd=Kd))

    def cost(gains) -> float:
        try:
            axis.controller.install(controller_block(with_gains(gains), sample_time))
        except ParameterError:
            return np.inf  # not stable
        axis.reset()
        signals = axis.run(setpoints)
        return criterion_of("iae", signals["reference"] - signals["displacement"], sample_time)

    run = restarted_nelder_mead(
        cost, auwal.PID_GUESS, settings=SimplexSettings(iterations=iterations, tolerance=1e-6)
    ).runs[0]
    peaks = (
        margins(with_gains(gains), sample_time).sensitivity_peak for gains in (auwal.PID_GAINS, run.trajectory[-1])
    )
    return Tuning(run.trajectory, run.costs, cost(auwal.PID_GAINS), *peaks)


def tuning_claims(found: Tuning) -> list[Claim]:
    """Return the rows of the PID's tuning."""
    group = "Tuning of the PID by Nelder-Mead (section 4.1, table III)"
    assumed = (auwal.TRIANGLE, auwal.CORRECTED, auwal.UNLIMITED, auwal.FILTERED, "sampled at 100 Hz")
    gains = ", ".join(f"{value:.4g}" for value in found.trajectory[-1])
    return [
        Claim(
            "tuning.guess",
            group,
            "IAE with the paper's initial guess",
            float(found.costs[0]),
            "m*s",
            assumptions=assumed,
        ),
        Claim(
            "tuning.published",
            group,
            "IAE with the paper's gains: less than with the guess",
            found.published,
            "m*s",
            paper=auwal.IAE["pid"],
            high=float(found.costs[0]),
            assumptions=assumed,
        ),
        Claim(
            "tuning.found",
            group,
            f"IAE after {auwal.TUNING_ITERATIONS} iterations from the paper's guess",
            float(found.costs[-1]),
            "m*s",
            paper=auwal.IAE["pid"],
            high=found.published,
            assumptions=assumed,
            reason=f"the gains found here are {gains}; without noise, limits and delay the simplex approaches the "
            "stability limit, so the paper's gains are not the optimum of the paper's criterion",
        ),
        Claim(
            "tuning.published.peak",
            group,
            "sensitivity peak with the paper's gains",
            found.published_peak,
            "1",
            assumptions=assumed,
        ),
        Claim(
            "tuning.found.peak", group, "sensitivity peak with the gains found", found.peak, "1", assumptions=assumed
        ),
    ]


def paper_runs(configuration: Configuration) -> dict[str, Recording]:
    """Return runs of the paper's triangle: the paper's three control schemes, and their combination."""
    ways = ("none", "pid", "inverse", "combined")
    return {method: auwal.run_triangle(auwal.driven(configuration, method)) for method in ways}


def comparison_claims(runs: dict[str, Recording]) -> list[Claim]:
    """Return the rows of the paper's table of IAE, and of better controllers."""
    group = "Hysteresis minimisation (section 5, last table)"
    found = {method: auwal.iae(run) for method, run in runs.items()}
    claims = []
    for method, published in auwal.IAE.items():
        band: dict[str, Any] = dict(low=0.99 * published, high=1.01 * published)
        words = f"{auwal.METHODS[method]}: IAE"
        assumed = (*ASSUMED, *FURTHER.get(method, ()))
        claims.append(
            Claim(f"iae.{method}", group, words, found[method], "m*s", paper=published, assumptions=assumed, **band)
        )
    for method, published in auwal.REDUCTION.items():
        band = dict(low=published - 0.1, high=published + 0.1)
        words = f"{auwal.METHODS[method]}: reduction of the IAE"
        value = auwal.reduction(found[method], found["none"])
        assumed = (*ASSUMED, *FURTHER.get(method, ()))
        claims.append(
            Claim(f"reduction.{method}", group, words, value, "%", paper=published, assumptions=assumed, **band)
        )
    for method in ("pid", "inverse"):
        claims.append(
            Claim(
                f"voltage.{method}",
                group,
                f"{auwal.METHODS[method]}: lowest voltage",
                float(np.min(runs[method]["voltage"])),
                "V",
                paper=-24.0,
                derived=True,
                low=-25.0,
                high=-23.5,
                assumptions=(*ASSUMED, *FURTHER.get(method, ())),
                reason="the data sheet of the stack allows 0 … 150 V, but the paper's results need a voltage outside "
                "this range",
            )
        )
        highest = float(np.max(runs[method]["voltage"]))
        words = f"{auwal.METHODS[method]}: highest voltage"
        claims.append(Claim(f"voltage.{method}.highest", group, words, highest, "V", assumptions=ASSUMED))
    better = min(found["pid"], found["inverse"])
    claims.append(
        Claim(
            "iae.combined",
            group,
            f"{auwal.METHODS['combined']}: IAE",
            found["combined"],
            "m*s",
            high=better,
            assumptions=(*ASSUMED, *FURTHER["combined"]),
            reason="the tolerance is the better of the paper's two results; the inverse makes the plant linear, the "
            "reference itself is the feedforward, and the paper's PID only has to remove the lag",
        )
    )
    return claims


WAYS = ("pid", "inverse", "combined")
ALL = ("none", *WAYS)
BASE = (auwal.CORRECTED, auwal.FILTERED, auwal.RATES)
HALF = 0.5
FAST = {0.5: 3, 1.0: 5}  # Hz: cycles
FINE = (7e-6, 0.2e-6)  # m: middle and height of the sine of 10 Hz
BETTER = "the tolerance of the combination is the better of the paper's two results under the same condition"


def limit_claims(configuration: Configuration) -> tuple[list[Claim], dict[str, Recording]]:
    """Return the rows of the paper's triangle within 0 … 150 V, and the runs for a plot."""
    group = "Realistic conditions: the paper's triangle within 0 … 150 V"
    slow = auwal.limited(auwal.at_rate(configuration, auwal.SLOW_RATE), *auwal.ALLOWED)
    runs = {method: auwal.run_triangle(auwal.driven(slow, method)) for method in ALL}
    found = {method: auwal.iae(run) for method, run in runs.items()}
    assumed = (auwal.TRIANGLE, auwal.DATA_SHEET_LIMITS, *BASE)
    words = f"{auwal.METHODS['none']}: IAE"
    claims = [Claim("limited.none", group, words, found["none"], "m*s", assumptions=(*assumed, auwal.GAIN))]
    for method in ("pid", "inverse"):
        expected = auwal.LIMITED_IAE[method]
        band: dict[str, Any] = dict(low=0.97 * expected, high=1.03 * expected)
        words = f"{auwal.METHODS[method]}: IAE"
        claims.append(
            Claim(
                f"limited.{method}",
                group,
                words,
                found[method],
                "m*s",
                paper=expected,
                derived=True,
                assumptions=assumed,
                **band,
            )
        )
    better = min(found["pid"], found["inverse"])
    words = f"{auwal.METHODS['combined']}: IAE"
    claims.append(
        Claim(
            "limited.combined", group, words, found["combined"], "m*s", high=better, assumptions=assumed, reason=BETTER
        )
    )
    claims.append(
        Claim(
            "limited.unavoidable",
            group,
            "IAE of the residual displacement at 0 V, for any controller",
            unavoidable(),
            "m*s",
            assumptions=assumed,
            reason="after the loop's upper end, the stack at 0 V remains 3 µm from its start; only a negative voltage "
            "moves it back, so no controller can remove most of the error in these rows",
        )
    )
    return claims, runs


def unavoidable() -> float:
    """Return the integral of the error [m s] while the falling reference is below the displacement that 0 V leaves."""
    element = BoucWenHysteresis(PUBLISHED_BOUC_WEN, SAMPLE_TIME)
    rise = np.linspace(0.0, auwal.ALLOWED[1], 15001)
    peak = float(np.interp(auwal.HEIGHT, element.simulate(rise), rise))
    element.reset()
    left = float(element.simulate([peak, 0.0])[-1])
    return 0.5 * left**2 / (2.0 * auwal.HEIGHT / auwal.PERIOD)


def mismatch_claims(configuration: Configuration) -> list[Claim]:
    """Return the rows of a compensator with wrong parameters."""
    group = "Realistic conditions: errors in the compensator's model, the paper's triangle, no limits"
    slow = auwal.at_rate(configuration, auwal.SLOW_RATE)
    without = auwal.iae(auwal.run_triangle(auwal.driven(slow, "none")))
    assumed = (auwal.TRIANGLE, auwal.UNLIMITED.split(",")[0], *BASE)
    symbols = {"d_e": "d_e", "alpha": "α"}
    claims = []
    for name, size in (("d_e", 0.01), ("d_e", 0.05), ("alpha", 0.05)):
        found = {}
        for method in ("inverse", "combined"):
            changed = {f"{sign}{100.0 * size:g} %": value * size for sign, value in (("−", -1.0), ("+", 1.0))}
            runs = {
                words: auwal.run_triangle(auwal.driven(auwal.off(slow, name, value), method))
                for words, value in changed.items()
            }
            found[method] = {words: auwal.reduction(auwal.iae(run), without) for words, run in runs.items()}
        low, high = auwal.OFF.get((name, size), (None, None))
        expected: dict[str, Any] = dict(paper=f"{low:g} … {high:g}", derived=True, low=low, high=high) if low else {}
        words = f"{symbols[name]} off by ±{100.0 * size:g} %: reduction of the IAE"
        for method, values in found.items():
            least = min(values.values())
            limits = expected if method == "inverse" else dict(low=min(found["inverse"].values()), reason=BETTER)
            claims.append(
                Claim(
                    f"off.{name}_{100.0 * size:g}.{method}",
                    group,
                    f"{auwal.METHODS[method]}, {words}",
                    least,
                    "%",
                    assumptions=assumed,
                    details=values,
                    **limits,
                )
            )
    return claims


def condition_claims(configuration: Configuration) -> tuple[list[Claim], dict[str, Recording]]:
    """Return the rows of triangles of 0.1 Hz under each and under all conditions, and the runs under all conditions."""
    slow = auwal.limited(auwal.at_rate(configuration, auwal.SLOW_RATE), *auwal.NEGATIVE)
    digital = auwal.noisy(auwal.limited(slow, *auwal.NEGATIVE, bits=auwal.BITS), auwal.NOISE)
    everything = auwal.creeping(digital)
    group = f"Realistic conditions: triangles of {auwal.HONEST_FREQUENCY:g} Hz, mean absolute error"
    limits, noise, creep = (auwal.STACK_LIMITS,), (auwal.STACK_LIMITS, auwal.NOISY), (auwal.CREEPING,)
    period = 1.0 / auwal.HONEST_FREQUENCY
    claims = []
    for name, words, axis, further, shape in (
        ("limits", "limits alone", slow, limits, {}),
        ("half", "half the height", slow, limits, dict(height=HALF * auwal.HEIGHT)),
        ("cycles", "five cycles", slow, limits, dict(cycles=5)),
        ("noise", "noise and 16 bits", digital, noise, {}),
        ("creep", "creep", auwal.creeping(slow), limits + creep, {}),
    ):
        runs = {m: auwal.run_triangle(auwal.driven(axis, m), period=period, **shape) for m in WAYS}
        dithered = (
            "the derivative amplifies the noise to a dither of several volts, and the dither reduces the hysteresis"
        )
        fails = f"{dithered}, so the PID's error is smaller with noise; {BETTER}" if name == "noise" else ""
        claims += _ways(f"slow.{name}", group, words, runs, (*BASE, *further), fails)
    runs = {}
    errors: dict[str, dict[str, float]] = {method: {} for method in ALL}
    for sign, value in (("−", -0.05), ("+", 0.05)):
        mistaken = auwal.off(everything, "d_e", value)
        for method in ALL:
            runs[method] = auwal.run_triangle(auwal.driven(mistaken, method), period=period, cycles=2)
            errors[method][f"{sign}5 %"] = auwal.mean_error(runs[method])
    assumed = (*BASE, *noise, *creep, "d_e of the compensator off by ±5 % (the worse result is shown), two cycles")
    claims += _judged("slow.all", group, "all conditions together, d_e off by 5 %", errors, assumed)
    return claims, runs


def camera_claims(configuration: Configuration) -> list[Claim]:
    """Return the rows of an axis with the paper's camera as sensor."""
    group = "Realistic conditions: the camera in the loop, the paper's triangle"
    axis = auwal.noisy(auwal.at_rate(configuration, auwal.FRAME_RATE), auwal.CAMERA_NOISE)
    axis = auwal.limited(axis, *auwal.NEGATIVE)
    # the plant resonates at 1.28 Hz, so at the camera's rate only an integral controller is stable with a margin
    calm = dict(pid__Kp=0.0, pid__Ki=auwal.TABLE_1["K"], pid__Kd=0.0)
    feedforward = auwal.driven(axis, "combined").override("motion_controller", **calm)
    runs = {"pid": auwal.driven(axis, "pid"), "inverse": auwal.driven(axis, "inverse"), "combined": feedforward}
    found = {method: {"": auwal.mean_error(auwal.run_triangle(run))} for method, run in runs.items()}
    assumed = (auwal.TRIANGLE, auwal.CORRECTED, auwal.FILTERED, auwal.CAMERA, auwal.STACK_LIMITS)
    calmed = "the paper's gains are unstable with one frame of delay; an integral gain of 1/s replaces them"
    claims = _judged("camera", group, "mean absolute error", found, assumed, f"{calmed}; {BETTER}")
    for frames, high in ((0, None), (1, 1.0)):
        claims.append(
            Claim(
                f"camera.delay_{frames}",
                group,
                f"PID, images {frames} frames late: largest modulus of a pole, linear part alone",
                pole_modulus(axis, frames),
                "1",
                high=high,
                assumptions=assumed,
                reason="a modulus below 1 is stable: the gains tolerate the paper's camera only without delay"
                if frames
                else "",
            )
        )
    return claims


def pole_modulus(configuration: Configuration, delay: int = 0) -> float:
    """Return the largest pole modulus of the paper's PID with the linear part and ``delay`` samples of delay."""
    axis = single_axis(auwal.driven(configuration, "none"))
    control = part(axis.motion_controller, ControllerParameters)
    dynamics = axis.plant_simulator.dynamics
    scale = dynamics.resolved_input_scale / dynamics.output_scale
    controller = pid_state_space(control.pid, 1.0 / axis.plant_simulator.sample_rate).scaled(scale)
    plant = plant_state_space(dynamics)
    for _ in range(delay):
        A, n = plant.A, len(plant.A)
        A = np.block([[A, np.zeros((n, 1))], [plant.C, np.zeros((1, 1))]])
        plant = StateSpace(A, np.vstack([plant.B, [[0.0]]]), np.append(np.zeros(n), 1.0)[np.newaxis], plant.D)
    return float(np.max(np.abs(close(controller, plant).poles)))


def frequency_claims(configuration: Configuration) -> list[Claim]:
    """Return the rows of triangles and sines of several frequencies."""
    group = "Realistic conditions: frequencies, mean absolute error"
    slow = auwal.limited(auwal.at_rate(configuration, auwal.SLOW_RATE), *auwal.NEGATIVE)
    fast = auwal.limited(auwal.at_rate(configuration, auwal.FAST_RATE), *auwal.NEGATIVE)
    assumed = (*BASE, auwal.STACK_LIMITS)
    resonant = (
        "near the resonance of 1.28 Hz the reference itself is a wrong feedforward, and the corners of a triangle "
        "need a voltage beyond the limits"
    )
    claims = []
    triangles: list[tuple[str, str, Configuration, dict[str, Any]]] = [
        ("0.02", "triangle of 0.02 Hz", slow, dict(period=50.0))
    ]
    for frequency, cycles in FAST.items():
        shape: dict[str, Any] = dict(period=1.0 / frequency, cycles=cycles)
        triangles.append((f"{frequency:g}", f"triangle of {frequency:g} Hz", fast, shape))
        if frequency == 1.0:
            half = dict(height=HALF * auwal.HEIGHT, **shape)
            triangles.append(("1.half", "triangle of 1 Hz, half the height", fast, half))
    for name, words, axis, shape in triangles:
        runs = {method: auwal.run_triangle(auwal.driven(axis, method), **shape) for method in WAYS}
        fails = resonant if name in ("1", "1.half") else ""
        claims += _ways(f"frequency.{name}", group, words, runs, assumed, fails)
    _, (_, damping, stiffness) = auwal.G2
    passed = abs(stiffness / complex(stiffness - (20.0 * np.pi) ** 2, 20.0 * np.pi * damping))
    claims.append(
        Claim(
            "frequency.10.passed",
            group,
            "fraction of a 10 Hz command that the dynamics pass",
            100.0 * passed,
            "%",
            assumptions=assumed,
            reason="a triangle of 10 Hz and full height needs commands of hundreds of µm, so it is refused before "
            "any motion",
        )
    )
    reason = (
        "near and above the resonance the reference itself is a wrong feedforward; for a smooth reference known one "
        "sample ahead, the dynamics can be inverted too (row dynamic); corners would need unlimited voltage"
    )
    ways = (*WAYS, "dynamic")
    middle, height = FINE
    for name, words, offset, amplitude, frequency, cycles in (
        ("sine.1", "sine of 1 Hz, full height", 0.5 * auwal.HEIGHT, 0.5 * auwal.HEIGHT, 1.0, 5),
        ("sine.10", "sine of 10 Hz, 0.2 µm high, settled", middle, 0.5 * height, 10.0, 60),
    ):
        errors = {}
        for method in ways:
            run = auwal.run_sine(auwal.driven(fast, method), offset, amplitude, frequency, cycles)
            settled = run.time >= (4.0 if name == "sine.10" else 0.0)
            errors[method] = {"": float(np.mean(np.abs(auwal.error(run)[settled])))}
        claims += _judged(f"frequency.{name}", group, words, errors, assumed, reason)
    return claims


def _ways(name: str, group: str, words: str, runs: dict[str, Recording], assumed, fails: str = "") -> list[Claim]:
    """Return one row for each control scheme."""
    errors = {method: {"": auwal.mean_error(run)} for method, run in runs.items()}
    return _judged(name, group, words, errors, assumed, fails)


def _judged(name: str, group: str, words: str, errors, assumed, reason: str = "") -> list[Claim]:
    """Return the rows; improved controllers must have smaller errors than the better of the paper's two controllers."""
    shown = {method: worst(list(values.values())) for method, values in errors.items()}
    better = min(shown["pid"], shown["inverse"])
    claims = []
    for method, value in shown.items():
        paper = method in ("none", "pid", "inverse")
        several = errors[method] if len(errors[method]) > 1 else {}
        claims.append(
            Claim(
                f"{name}.{method}",
                group,
                f"{words}: {auwal.METHODS[method]}",
                value,
                "m",
                high=None if paper else better,
                assumptions=tuple(assumed),
                reason="" if paper else (reason or BETTER),
                details=several,
            )
        )
    return claims
