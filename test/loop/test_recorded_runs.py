# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Recorded runs: short offline runs that together use every kind and option of the loop; every signal has its old bits.

The other tests compare with physics, within tolerances; this one notices any change of a result, also in rare branches.
All processors give the same bits (``test_same_bits.py``), so a digest of each signal is enough. The runs are not
compiled, and are in a process of their own.

Renew results that change on purpose in the commit that changes them, and write the change into the changelog::

    python test/loop/test_recorded_runs.py --renew

The command also prints which signals changed.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
from coupled_stages import configured
from loop_support import LEARNS
from loop_support import TRIANGLE as TAUGHT

from hysteresis_ros.control.controller import DESIGNS, ControllerParameters
from hysteresis_ros.control.coupling import disk_margins, relative_gain_array, singular_values, static_decoupling
from hysteresis_ros.control.learning import Learned, write_learned
from hysteresis_ros.control.linearisation import whole_loop
from hysteresis_ros.control.margins import margins_of
from hysteresis_ros.control.uncertainty import Uncertainty, drawn_plants
from hysteresis_ros.designs.gains import design_gains
from hysteresis_ros.loop.axis import Axis, Change
from hysteresis_ros.loop.axis_array import AxisArray, parameters_of_each
from hysteresis_ros.loop.faults import FAULTS
from hysteresis_ros.loop.parameters import NODE_PARAMETERS, part
from hysteresis_ros.loop.quiet import Quiet
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import mismatched, simulate
from hysteresis_ros.loop.stage_parameters import StageNodeParameters, StageParameters
from hysteresis_ros.loop.stage_response import (
    damped_response,
    loop_bandwidths,
    path_bandwidths,
    stage_loop,
    stage_response,
)
from hysteresis_ros.loop.stage_simulation import coupling_errors, displacements_between, simulate_stage, with_scan
from hysteresis_ros.models import elementary, linear_algebra
from hysteresis_ros.models.declaration import Deviation
from hysteresis_ros.models.hysteresis import MODELS
from hysteresis_ros.references.moves import Noise, NoiseMeter, Readiness, Settling
from hysteresis_ros.references.recipes import RECIPES, recipe
from hysteresis_ros.references.scan import ScanLimits, frame_marks, largest_frame_rate, line_marks, pixel_marks
from hysteresis_ros.references.scans import parsed_scan
from hysteresis_ros.signals import ACTUATOR

RECORDED = pathlib.Path(__file__).with_name("recorded_runs.json")
PLANT, SOURCE, MOTOR = "plant_simulator", "reference_generator", "inchworm_sequencer"
CONTROLLER, COMPENSATOR = "motion_controller", "hysteresis_compensator"
FAILED = "failed with"
Signals = Mapping[str, np.ndarray]

#: Choices that the offline runs of simulated axes do not read; those of cameras, whose images depend on the processor;
#: and those of parts that other runs use elsewhere: a motor's clamps have the blocks of its extender.
NOT_OF_THE_LOOP = (
    r".*\.(time_mode|measurement_reliability|setpoint_reliability)|displacement_camera\..*|recorder\..*"
    r"|plant_simulator\.(type|driver|gcs\..*|triggers\..*|calibration\..*|inchworm\..*_clamp\.hysteresis\..*)"
    r"|inchworm_sequencer\.triggers\.each"
)
#: Beginnings of the names of runs that are repeated on another processor.
FEW = ("kim2009", "xy_scanner", "scan", "waveform multisine", "sliding_mode", "damping", "adaptation", "a path")

#: Values of parameters with choices, by ``node.parameter``, that the runs so far have used.
used: dict[str, set[str]] = {}


def note(node: str, parameters) -> None:
    """Note the values of a node's parameters that have choices."""
    values = parameters.to_mapping()
    for row in type(parameters).table():
        if row.choices and row.name in values:
            used.setdefault(f"{node}.{row.name}", set()).add(values[row.name])


def axis_of(name: str, nodes: Mapping[str, Mapping[str, Any]], seed: int | None = None):
    """Return the parameters of an axis; with a seed its plant differs from its models."""
    configuration = configured(name, **nodes)
    axis = single_axis(configuration if seed is None else mismatched(configuration, 0.1, seed))
    for node in NODE_PARAMETERS:
        if getattr(axis, node) is not None:
            note(node, getattr(axis, node))
    return axis


def levels(values: Sequence[float] | None, samples: int) -> np.ndarray | None:
    """Return setpoints [m] that stand for equal times."""
    return None if values is None else np.repeat(values, -(-samples // len(values)))[:samples]


def marked(places: Sequence[int] | Mapping[int, float], samples: int, rest: float = 0.0) -> np.ndarray | None:
    """Return an input of a run: ``rest``, but 1 or a given value at some samples."""
    found = np.full(samples, rest)
    for place, value in (places if isinstance(places, Mapping) else dict.fromkeys(places, 1.0)).items():
        found[place] = value
    return found if places else None


def run(
    name: str = "kim2009",
    samples: int = 240,
    *,
    setpoints: Sequence[float] | None = None,
    changes: Sequence[tuple] = (),
    quiet: Sequence[tuple] = (),
    drift: tuple[float, float] = (0.0, 0.0),
    skipped: Sequence[int] = (),
    pulses: Sequence[int] = (),
    requests: Mapping[int, float] | None = None,
    speeds: Mapping[int, float] | None = None,
    seed: int | None = None,
    **nodes,
) -> Callable[[], Signals]:
    """Return a function that simulates an axis with other parameters by node, and returns its signals."""

    def simulated() -> Signals:
        axis = axis_of(name, nodes, seed)
        rate = axis.plant_simulator.sample_rate
        recording = simulate(
            axis,
            duration=samples / rate,
            setpoints=levels(setpoints, samples),
            changes=[Change(*change) for change in changes],
            quiet=[Quiet(first / rate, count / rate, *more) for first, count, *more in quiet],
            drift=drift,
            skipped=marked(skipped, samples),
            pulses=marked(pulses, samples),
            requests=marked(requests or {}, samples),
            speeds=marked(speeds or {}, samples, np.nan),
            describe=False,
        )
        return {"time": recording.time, **recording.signals}

    return simulated


def stage(
    name: str = "xy_scanner",
    samples: int = 120,
    *,
    setpoints: Mapping[str, Sequence[float]] | None = None,
    changes: Mapping[str, Sequence[tuple]] | None = None,
    skipped: Sequence[int] = (),
    pulses: Mapping[str, Sequence[int]] | None = None,
    scan: tuple[str, str] | None = None,
    **nodes,
) -> Callable[[], Signals]:
    """Return a function that simulates a stage with other parameters by node, and returns its signals."""

    def simulated() -> Signals:
        configuration = configured(name, **nodes)
        if scan is not None:
            configuration = with_scan(configuration, scan[0], scan[1].split())
        parameters = StageParameters.from_configuration(configuration)
        note("stage", parameters.stage)
        recording = simulate_stage(
            parameters,
            duration=samples / parameters.sample_rate,
            setpoints={axis: levels(some, samples) for axis, some in (setpoints or {}).items()},
            changes={axis: [Change(*change) for change in some] for axis, some in (changes or {}).items()},
            skipped=marked(skipped, samples),
            pulses={axis: marked(some, samples) for axis, some in (pulses or {}).items()},
        )
        return {"time": recording.time, **recording.signals}

    return simulated


def array(name: str, samples: int, setpoints: Sequence[float], each: Mapping[str, Sequence], **nodes):
    """Return a function that simulates an array of axes, and returns its signals."""

    def simulated() -> Signals:
        axes = parameters_of_each(axis_of(name, nodes), len(next(iter(each.values()))), each)
        found = AxisArray(axes, 1).run(levels(setpoints, samples), signals=[one.name for one in ACTUATOR.row])
        return {one.name: found[one.name] for one in ACTUATOR.row}

    return simulated


def repeated(name: str, samples: int, **nodes) -> Callable[[], Signals]:
    """Return a function that repeats a run with the answers of its plant as those of a device."""

    def simulated() -> Signals:
        first = run(name, samples, **nodes)()
        device = {**nodes, PLANT: {**nodes.get(PLANT, {}), "driver": "simulated"}}
        wanted = "measured", "plant_voltage", "tripped", "force"
        answers = {signal: first[signal] for signal in wanted}
        made = simulate(axis_of(name, device), setpoints=first["setpoint"], answers=answers, describe=False)
        return made.signals

    return simulated


def figures(function: Callable[..., Mapping[str, Any]], *given) -> Callable[[], Signals]:
    """Return a function that returns numbers, rounded to 1e-6 of the largest in an array: they use other libraries."""

    def rounded() -> Signals:
        found = {}
        for name, values in function(*given).items():
            array = np.atleast_1d(np.asarray(values))
            array = np.concatenate([array.real.ravel(), array.imag.ravel()]) if np.iscomplexobj(array) else array
            array = array.astype(float).ravel()
            largest = np.max(np.abs(array[np.isfinite(array)]), initial=0.0) or 1.0
            # the sum leaves no negative zeros
            found[name] = np.append(np.round(array / largest, 6) + 0.0, float(f"{largest:.6g}"))
        return found

    return rounded


def numbers(nested: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Return the numbers of nested dictionaries, by their path."""
    found = {}
    for name, value in nested.items():
        if isinstance(value, Mapping):
            found |= numbers(value, f"{path}{name}.")
        elif np.asarray(value).dtype.kind in "bif" and np.size(value):
            found[f"{path}{name}"] = value
    return found


def design_figures() -> dict[str, Any]:
    """Return the parameters that each design finds for the shipped sliding mode controller's axis."""
    axis, found = axis_of("kim2009", {}), {}
    for name in DESIGNS:
        wanted = {"pid": 30.0, "super_twisting": 30.0}.get(name)
        design = design_gains(axis.motion_controller, name, 1.0 / axis.plant_simulator.sample_rate, wanted)
        found |= numbers(asdict(design.parameters), f"{name}.")
    return found


def margin_figures() -> dict[str, Any]:
    """Return the margins of shipped controllers, for the model and for plants near it."""
    found: dict[str, Any] = {}
    for name in ("stage700", "fleming2010", "kim2009"):
        axis = axis_of(name, {})
        step = 1.0 / axis.plant_simulator.sample_rate
        loop = whole_loop(part(axis.motion_controller, ControllerParameters), step)
        margins = margins_of(*loop, step)
        found |= {f"{name}.{item}": getattr(margins, item) for item in MARGINS}
        possible = drawn_plants(axis.motion_controller.model.dynamics, step, Uncertainty(gain=0.1, draws=3))
        found |= {f"{name}.{k}": np.sort_complex(one.plant.poles) for k, one in enumerate(possible)}
    return found


def stage_figures() -> dict[str, Any]:
    """Return margins, responses and coupling of a stage."""
    given = StageParameters.from_configuration(with_scan(configured("xy_scanner"), "raster", RASTER.split()))
    angles, gain = np.array([0.01, 0.1, 1.0]), np.array([[1.0, 0.04], [0.1, 0.8]])
    margins = disk_margins(stage_loop(given), 1.0 / given.sample_rate)
    found: dict[str, Any] = {
        "response": stage_response(given, angles),
        "damped": damped_response(given, angles),
        "bandwidths": loop_bandwidths(given),
        "of paths": path_bandwidths(given),
        "decoupling": static_decoupling(gain),
        "relative gains": relative_gain_array(gain),
        "singular values": singular_values(gain[None]),
    }
    for place, margin in enumerate((*margins.loops, margins.together)):
        found[f"margins {place}"] = np.round([*margin.gains, margin.phase_margin], 4)
    for error in coupling_errors(given, 0.006):
        found[f"{error.scanning} moves {error.held}"] = [error.rms, error.peak, error.scanned]
    time, between = displacements_between(given, simulate_stage(given, duration=0.006))
    return found | {"instants": time, "between the samples": between}


def mirror_figures() -> dict[str, Any]:
    """Return margins and responses of a stage with hysteresis inside its structure."""
    given = StageParameters.from_configuration(configured("steering_mirror"))
    margins = disk_margins(stage_loop(given), 1.0 / given.sample_rate)
    return {
        "response": stage_response(given, np.array([0.01, 0.1, 1.0])),
        "large gain": given.stage.large_gain(),
        "margins": np.round([one.gain_margin for one in margins.loops], 4),
    }


def forecast_figures() -> dict[str, Any]:
    """Return the drift of a quiet hold after a step, and how long it stays within tolerances."""
    axis = Axis(axis_of("picma_stage", QUIET))
    axis.run(np.repeat([0.0, 20e-6], 50))
    forecast = axis.forecast()
    return {
        "creep": [forecast.creep(duration) for duration in (0.1, 1.0, 20.0)],
        "longest": [forecast.longest(tolerance) for tolerance in (1e-8, 3e-8, 1e-7, 1.0)],
    }


def scan_figures(name: str) -> dict[str, Any]:
    """Return path, bounds, passes and marks of a scan."""
    scan = parsed_scan(name.split()[0], SCANS[name].split())
    time = np.linspace(0.0, scan.period, 60)
    found: dict[str, Any] = {f"order {order}": scan.derivative(time, order) for order in range(4)}
    found |= {f"bounds {order}": scan.peak(order) for order in range(4)}
    passes, clock = scan.passes, scan.clock(time)
    found |= {f"passes {item}": getattr(passes, item) for item in ("begin", "duration", "line", "direction")}
    found |= {f"clock {item}": getattr(clock, item) for item in ("frame", "line", "pixel", "direction")}
    for marks in (frame_marks, line_marks, pixel_marks):
        made = marks(scan, time)
        found |= {f"{marks.__name__} {item}": getattr(made, item) for item in ("time", "frame", "line", "direction")}
    limits = ScanLimits(velocity=(1e-3, 1e-3), acceleration=(2.0, 2.0), jerk=(4e3, 4e3))
    found |= {"extent": scan.extent(), "gap": scan.gap, "constant": scan.constant_share, "size": scan.size}
    return found | {"fastest": largest_frame_rate(scan, limits), "bandwidth": scan.bandwidth}


def move_figures() -> dict[str, Any]:
    """Return when moves settle and are ready, and the measured noise."""
    made = run(samples=300, setpoints=JUMPS, **merged(HOLD, {PLANT: {"sensor__noise": 2e-8}}))()
    settling, meter = Settling(2e-7, 0.005, 1.0 / 3000.0), NoiseMeter(0.01, 1.0 / 3000.0)
    readiness = Readiness(3e-7, 0.004, Noise(2e-8, 1e-8), 1.0 / 3000.0)
    settled, ready, noise = [], [], []
    for k, (setpoint, reference, measured) in enumerate(
        zip(made["setpoint"], made["reference"], made["measured"], strict=True)
    ):
        if setpoint != made["setpoint"][k - 1]:
            readiness.restart()
        measured = np.nan if k in (140, 141, 180) else measured
        settled.append(settling.look(setpoint, reference, measured, k > 280))
        ready.append((readiness.look(setpoint, measured), readiness.since))
        meter.take(np.array([reference]), np.array([measured]))
        noise.append((meter.sensor, meter.noise().displacement))
    return {"settled": settled, "ready": ready, "noise": noise}


def recipe_figures() -> dict[str, Any]:
    """Return the voltages of each excitation."""
    found: dict[str, Any] = {}
    for name in RECIPES:
        made = recipe(name, 0.0, 100.0, 500.0)
        found |= numbers(made.waveform, f"{name}.")
        found[f"{name} duration"] = made.duration
        found |= {} if made.samples is None else {f"{name} samples": made.samples}
    return found


def algebra_figures() -> dict[str, Any]:
    """Return results of linear algebra and of elementary functions."""
    A = np.array([[0.5, 0.1, 0.0, 0.2], [0.3, 0.4, -0.6, 0.0], [0.0, 0.7, 0.6, 0.1], [0.1, 0.0, 0.3, 0.3]])
    B = np.array([[0.3, 0.0], [1.1, 0.2], [0.7, -1.0], [0.2, 0.4]])
    x = np.linspace(-6.0, 6.0, 101).tolist()
    found: dict[str, Any] = {
        "exponential": linear_algebra.exponential(A),
        "eigenvalues": np.sort_complex(linear_algebra.eigenvalues(A)),
        "riccati": linear_algebra.riccati(A, B, np.eye(4), np.eye(2)),
        "inverse": linear_algebra.inverse(A),
        "power": linear_algebra.power(A, 5),
        "balance": linear_algebra.balance(A * np.array([1.0, 1e3, 1.0, 1e-3])),
    }
    for name in ("sin", "cos", "exp", "expm1", "tanh"):
        found[name] = [getattr(elementary, name)(value) for value in x]
    found |= {"log": [elementary.log(7.0 + value) for value in x], "pow": [elementary.pow(7.0 + v, 1.3) for v in x]}
    return found | {"log1p": [elementary.log1p(0.1 * value) for value in x]}


def modelled(kind: str, inverse: str, **own) -> dict[str, dict]:
    """Return nodes whose plant has a hysteresis model; that of the compensator differs by a few per cent."""
    model = MODELS[kind]
    given = type(model.example).from_mapping({**model.example.to_mapping(), **own})
    other = model.deviated(given, Deviation(1.04, 1.1, lambda count=None: np.full(count or (), 1.02)))
    nodes = {}
    for node, values in ((PLANT, given), (COMPENSATOR, other)):
        nodes[node] = {"hysteresis__type": kind}
        nodes[node] |= {f"hysteresis__{kind}__{name}": value for name, value in values.to_mapping().items()}
    nodes[COMPENSATOR]["inverse__type"] = inverse
    return {**nodes, CONTROLLER: {"type": "open_loop"}, SOURCE: LOOPS}


def merged(*some: Mapping[str, Mapping]) -> dict[str, dict]:
    """Return nodes with all given parameters; later ones replace earlier ones."""
    found: dict[str, dict] = {}
    for nodes in some:
        for node, values in nodes.items():
            found[node] = found.get(node, {}) | dict(values)
    return found


def wave(kind: str, **own) -> dict[str, dict]:
    """Return the node of a reference generator with a waveform about 5 µm."""
    values = {"type": kind, "amplitude": 4e-6, "frequency": 40.0, **own}
    return {SOURCE: {"initial_setpoint": 5e-6, **{f"waveform__{name}": value for name, value in values.items()}}}


def limited(velocity: float = 4e-4, acceleration: float = 0.02, jerk: float = 2.0, **own) -> dict[str, Any]:
    """Return parameters of an approach with limits."""
    found = {"maximum_velocity": velocity, "maximum_acceleration": acceleration, "maximum_jerk": jerk, **own}
    return {f"approach__{name}": value for name, value in found.items()}


RASTER = "width=10um depth=4um lines=3 flyback=1 frame_rate=15Hz"
MARGINS = (
    "gain_margin phase_margin delay_margin gain_crossovers sensitivity_peak complementary_peak bandwidth noise_gain"
)
MARGINS = MARGINS.split()
HOLD = {SOURCE: {"waveform__type": "hold"}}
JUMPS = (1e-6, 9e-6, 4e-6)
#: Nested loops of the hysteresis, beyond both ends of a model's range.
LOOPS = {
    "initial_setpoint": 5e-6,
    "waveform__type": "decaying_sine",
    "waveform__amplitude": 5e-6,
    "waveform__frequency": 30.0,
    "waveform__polarity": "symmetric",
    "waveform__decaying_sine__decay_time": 0.05,
}
TRIANGLE = {"waveform__type": "triangle", "waveform__frequency": 50.0, "waveform__amplitude": 8e-6}
#: As for a device: short time-outs, and slow ways to the safe values.
GUARDED = {
    CONTROLLER: {"measurement_timeout": 0.004, "safe_slew_rate": 1e-3, "handover_time": 0.01},
    COMPENSATOR: {"command_timeout": 0.004, "safe_slew_rate": 2e4, "handover_time": 0.01, "safe_voltage": 3.0},
    PLANT: {"voltage_timeout": 0.003, "safe_slew_rate": 1.5e4, "late_limit": 0, "safe_voltage": 5.0},
}
OBSERVED = {"kalman__gain": "riccati", "kalman__L": []}
IFF = {
    "damping__type": "iff",
    "damping__iff__gain": 6.52e-5,
    "damping__iff__leak": 1360.0,
    "damping__iff__high_pass": 1360.0,
    "pid__Kp": 0.0532177,
    "pid__Ki": 1722.55,
    "pid__Kd": 9.72554e-5,
}
BARE = {SOURCE: {f"approach__maximum_{name}": 0.0 for name in ("velocity", "acceleration", "jerk")}}
GRID = {"triggers__start": 2e-6, "triggers__step": 0.5e-6, "triggers__stop": 7e-6}
SCANS = {
    "raster": "width=6um depth=4um lines=4 flyback=2 frame_rate=20Hz rotation=10deg slow=ramped pixels=8",
    "raster of one way": "width=6um depth=4um lines=4 flyback=2 line_rate=100Hz pattern=bidirectional pixels=5",
    "raster of traces": "width=6um depth=4um lines=3 flyback=2 frame_rate=25Hz pattern=trace pixels=5 turn=0.4",
    "spiral": "diameter=6um turns=4 frame_rate=20Hz centre_x=1um",
    "spiral of constant speed": "diameter=6um turns=4 frame_rate=20Hz law=clv core=0.7",
    "lissajous": "width=6um depth=4um lines=7 frame_rate=20Hz centre_y=-1um",
    "cycloid": "width=6um diameter=2um lines=5 frame_rate=20Hz",
    "rosette": "diameter=6um lines=7 frame_rate=20Hz",
}
WALK = {
    "walk__continuous": True,
    "walk__swing": 456.0,
    "walk__resonance": 635.0,
    "walk__clamp_lead": 2e-4,
    "walk__lead": 1e-4,
    "walk__quick_clamps": True,
    "walk__learning_speed": 2e-4,
}
COMPLIANT = {"inchworm__slider__damping": 0.03, "inchworm__slider__substeps": 0}
COMPLIANT |= {f"inchworm__{clamp}_clamp__compliance": 2e-8 for clamp in ("front", "rear")}
COMPLIANT |= {f"inchworm__{clamp}_clamp__kick": 1e-9 for clamp in ("front", "rear")}
NOISE = {"sensor__noise": 5e-9, "sensor__resolution": 1e-9, "sensor__offset": 2e-8, "sensor__seed": 7}
DAMPED = {
    "irc": {"irc__k": 1136.0, "irc__feedthrough": -2.5},
    "ppf": {"ppf__frequencies": (900.0,), "ppf__damping": (0.4,), "ppf__gains": (0.2,)},
    "notch": {"notch__frequencies": (700.0, 2100.0), "notch__damping": (0.01, 0.1), "notch__width": (0.5, 0.4)},
}
POINTS = {"times": (0.02, 0.03), "positions": (3e-6, 5e-6), "velocities": (6e-5, 0.0)}
PRELOAD = {"preload__force": 2.0, "preload__A1": 1e-7, "preload__B1": -2.4e-7, "preload__B2": 3e-9}
OPERATORS = {
    "creep__type": "operators",
    "creep__operators__weights": (0.02, 0.03),
    "creep__operators__time_constants": (0.004, 0.03),
}
#: Two layers of a Duhem model's network.
NETWORKS = (1.5, 1.2, 0.3, -0.4, 0.5, 0.4, 0.02), (1.0, -1.0, 0.9, 0.9, 0.05, 0.05, 0.8)
SHAPED = {"shape": "network", "f_network": NETWORKS[0], "g_network": NETWORKS[1]}
INVERSE_DUHEM = {
    COMPENSATOR: {
        f"inverse__duhem__{name}": value
        for name, value in {
            **MODELS["duhem"].example.to_mapping(),
            "alpha": 4e5,
            "input_high": 1e-5,
            "output_high": 100.0,
        }.items()
    }
}
INTEGRAL = {
    "sliding_mode__tracking": "integral",
    "sliding_mode__S": [],
    "sliding_mode__poles": (0.6, 0.6, 0.5),
    "sliding_mode__poles_imaginary": (0.1, -0.1, 0.0),
}
TWISTING = {"super_twisting__gains": "given", "super_twisting__discretisation": "explicit"}
TWISTING |= {"super_twisting__k1": 0.02, "super_twisting__k2": 1.5}
SLOW = {"pid__Kp": 0.0, "pid__Ki": 200.0, "pid__Kd": 0.0}
SMALL = {"pid__output_minimum": -4e-6, "pid__output_maximum": 5e-6}
LAG = {"A": (0.686131723,), "B": (0.313868277,), "C": (1.0,), "sample_time": 0.005}
ADAPTING = {
    PLANT: {"sensor__noise": 5e-9},
    COMPENSATOR: {
        "adaptation__type": "recursive",
        "adaptation__memory": 8.0,
        "adaptation__rate": 0.2,
        "adaptation__slow": 0.05,
        **{f"adaptation__dynamics__{name}": value for name, value in LAG.items()},
        "hysteresis__prandtl_ishlinskii__offset": 2e-7,
    },
    SOURCE: {
        "initial_setpoint": 20e-6,
        "waveform__type": "triangle",
        "waveform__amplitude": 12e-6,
        "waveform__frequency": 1.0,
    },
    CONTROLLER: {"type": "open_loop"},
}
QUIET = {
    SOURCE: {"waveform__type": "hold", "initial_setpoint": 20e-6},
    PLANT: {"sensor__noise": 3e-9},
}
STEPS = {"triggers__start": 0.0, "triggers__step": 1e-6, "triggers__stop": 1e-5}
AT_REST = {MOTOR: {"setpoints__times": [], "setpoints__values": []}}
#: A feedforward of the stage without symmetry.
FED = {
    "stage": {
        "feedforward__preview": 2,
        "feedforward__weights": (
            *(0.01, -0.03, 0.04, -0.02),
            *(0.02, 0.01, -0.05, 0.02),
            *(-0.01, 0.02, 0.03, -0.04),
            *(0.03, -0.02, 0.01, -0.02),
        ),
    },
    CONTROLLER: {"feedforward__type": "static", "feedforward__preview": 2},
}


def of_damping(kind: str) -> dict[str, Any]:
    """Return the parameters of a damping."""
    return {f"damping__{name}": value for name, value in DAMPED[kind].items()}


def of_axes(nodes: Mapping[str, Mapping], axes: str = "xy") -> dict[str, dict]:
    """Return nodes of some axes of a stage."""
    return {f"{axis}__{node}": dict(values) for axis in axes for node, values in nodes.items()}


NODES = (PLANT, SOURCE, CONTROLLER, COMPENSATOR)
SHORT = {
    CONTROLLER: {"measurement_timeout": 0.0015, "safe_slew_rate": 1e-2, "handover_time": 2e-3},
    COMPENSATOR: {"command_timeout": 0.0015, "safe_slew_rate": 2e4, "handover_time": 2e-3},
    PLANT: {"voltage_timeout": 0.001, "safe_slew_rate": 1.5e4},
}


#: All runs by their names; each part of the loop has its runs together.
RUNS: dict[str, Callable[[], Signals]] = {
    # shipped configurations as they are
    "kim2009": run(),
    "auwal2017": run("auwal2017", setpoints=(2e-6, 0.0)),
    "wang2014": run("wang2014", 60),
    "wang2014_duhem": run("wang2014_duhem", 60),
    "wang2014_linear": run("wang2014_linear", 60),
    "picma_stage": run("picma_stage"),
    "stage700": run("stage700", setpoints=(2e-6, 9e-6)),
    "fleming2010": run("fleming2010"),
    "inchworm_travel": run("inchworm_travel", 400, setpoints=(0.0, 2e-6)),
    "xy_scanner": stage(samples=300),
    "steering_mirror": stage("steering_mirror"),
    # hysteresis and inverses
    "bouc_wen": run(**modelled("bouc_wen", "general")),
    "bouc_wen squared": run(samples=120, **modelled("bouc_wen", "multiplicative", exponent=2.0, beta=3e5, gamma=-1e5)),
    "bouc_wen_mechanical": run(**modelled("bouc_wen_mechanical", "none", exponent=1.5, intersample="linear")),
    "bouc_wen_mechanical held": run(**modelled("bouc_wen_mechanical", "none", substeps=2)),
    "duhem of splines": run(**modelled("duhem", "general")),
    "duhem of networks": run(
        **modelled("duhem", "none", shape="network", f_network=NETWORKS[0], g_network=NETWORKS[1])
    ),
    "duhem as inverse": run(**merged(modelled("proportional", "duhem"), INVERSE_DUHEM)),
    "generalised_play": run(**modelled("generalised_play", "exact")),
    "generalised_play searched": run(**modelled("generalised_play", "general", falling_bend=0.1, offset=1e-7)),
    "polynomial": run(**modelled("polynomial", "exact")),
    "polynomial in steps": run(
        **merged(modelled("polynomial", "picard_steps"), {COMPENSATOR: {"inverse__picard_rate": 2e7}})
    ),
    "polynomial searched": run(**modelled("polynomial", "general")),
    "prandtl_ishlinskii": run(**modelled("prandtl_ishlinskii", "exact", offset=1e-7)),
    "prandtl_ishlinskii without zones": run(**modelled("prandtl_ishlinskii", "exact", thresholds=(), zone_weights=())),
    "preisach": run(**modelled("preisach", "general")),
    "preisach with a short memory": run(**modelled("preisach", "none", memory=4)),
    "proportional": run(**modelled("proportional", "exact")),
    **{
        f"{kind} beyond its range, with changes ({inverse})": run(
            samples=300,
            setpoints=(0.0, 12e-6, -2e-6, 14e-6, 3e-6, 10e-6),
            changes=[
                (100, PLANT, "retune", own),
                (150, COMPENSATOR, "retune", own),
                (210, COMPENSATOR, "retune", {name: 1.02 * value for name, value in own.items()}),
                (230, PLANT, "retune", {name: 1.02 * value for name, value in own.items()}),
            ],
            **merged(
                modelled(kind, inverse, **more),
                HOLD,
                {SOURCE: {"minimum": -2e-6, "initial_setpoint": 0.0, **limited(8e-4, 0.2, 0.0)}},
            ),
        )
        for kind, inverse, own, more in (
            ("bouc_wen", "general", {"hysteresis.bouc_wen.d_e": 1.5e-7}, {}),
            ("duhem", "none", {"hysteresis.duhem.output_high": 1.1e-5}, SHAPED),
            ("duhem", "general", {"hysteresis.duhem.output_high": 1.1e-5}, {}),
            ("generalised_play", "exact", {"hysteresis.generalised_play.slope": 8e-8}, {"voltage_high": 60.0}),
            ("polynomial", "exact", {"hysteresis.polynomial.scale": 1.04}, {"voltage_high": 70.0}),
            ("prandtl_ishlinskii", "exact", {"hysteresis.prandtl_ishlinskii.offset": 2e-7}, {}),
            ("preisach", "general", {"hysteresis.preisach.slope": 8e-8}, {"memory": 4}),
            ("proportional", "exact", {"hysteresis.proportional.gain": 1.1e-7}, {}),
        )
    },
    # creep, dynamics, sensors, limits
    "creep of operators": run(
        **merged(
            wave("square"), {node: OPERATORS for node in (PLANT, COMPENSATOR)}, {CONTROLLER: {"type": "open_loop"}}
        )
    ),
    "logarithmic creep": run("picma_stage", 160, setpoints=(0.0, 30e-6), **HOLD, seed=3),
    "delay of a fraction of a sample": run(
        "stage700", setpoints=JUMPS, **{PLANT: {"dynamics__delay": 1.3e-4, "sensor__noise": 0.0}}, **BARE
    ),
    "direct feedthrough": run(
        **merged(HOLD, {PLANT: {"dynamics__D": (0.2,)}, CONTROLLER: {"type": "open_loop"}}), setpoints=JUMPS
    ),
    "noise and resolution": run(**{PLANT: NOISE}, setpoints=JUMPS, **HOLD),
    "preload": run(
        **merged(
            HOLD, {PLANT: PRELOAD, CONTROLLER: {f"model__{name}": 1.1 * value for name, value in PRELOAD.items()}}
        ),
        setpoints=JUMPS,
        changes=[
            (80, CONTROLLER, "retune", {"model.preload.force": 3.0}),
            (160, PLANT, "retune", {"preload.force": 2.5}),
        ],
    ),
    "slew rate and few bits": run(
        setpoints=JUMPS,
        **merged(HOLD, {node: {"limits__slew_rate": 2e4, "limits__bits": 8} for node in (PLANT, COMPENSATOR)}),
    ),
    "limits of plant and compensator differ": run(
        setpoints=(0.0, 12e-6, 0.0),
        **merged(
            HOLD, {PLANT: {"limits__maximum": 90.0, "limits__minimum": -5.0}, COMPENSATOR: {"limits__maximum": 100.0}}
        ),
    ),
    "drift and mismatch": run(seed=5, drift=(0.01, 0.02), setpoints=JUMPS, **HOLD),
    "drift of other models": run("picma_stage", 120, seed=2, drift=(-0.01, 0.01)),
    # controllers and observers
    **{
        f"{kind} with {disturbance}": run(
            setpoints=JUMPS,
            seed=4,
            **merged(
                HOLD,
                {
                    CONTROLLER: {
                        **OBSERVED,
                        "type": kind,
                        "kalman__disturbance": disturbance,
                        "kalman__form": form,
                        **own,
                    }
                },
            ),
        )
        for kind, disturbance, form, own in (
            ("sliding_mode", "constant", "predictor", {"sliding_mode__eta": 0.01}),
            ("sliding_mode", "ramp", "current", {"sliding_mode__hyperplane": "lq", "sliding_mode__S": []}),
            ("sliding_mode", "periodic", "predictor", {"kalman__disturbance_harmonics": 2}),
            ("sliding_mode", "none", "current", INTEGRAL | {"sliding_mode__hyperplane": "poles"}),
            ("integral_sliding_mode", "none", "current", {"sliding_mode__rejection_pole": 0.6}),
            ("super_twisting", "none", "current", {"super_twisting__bound": 2.0}),
            ("super_twisting", "constant", "predictor", TWISTING),
        )
    },
    **{
        f"an observer of a {disturbance} disturbance starts again": run(
            setpoints=JUMPS,
            seed=4,
            changes=[(60, CONTROLLER, "stop"), (90, CONTROLLER, "start"), (150, CONTROLLER, "reset")],
            **merged(
                HOLD,
                GUARDED,
                {CONTROLLER: {**OBSERVED, "kalman__disturbance": disturbance, "kalman__form": form}},
            ),
        )
        for disturbance, form in (("constant", "current"), ("ramp", "predictor"), ("periodic", "current"))
    },
    "an integral sliding mode starts again": run(
        setpoints=JUMPS,
        changes=[(60, CONTROLLER, "stop"), (90, CONTROLLER, "start"), (150, CONTROLLER, "reset")],
        **merged(HOLD, GUARDED, {CONTROLLER: {**OBSERVED, **INTEGRAL, "sliding_mode__hyperplane": "poles"}}),
    ),
    "pid": run(
        "stage700", setpoints=JUMPS, **BARE, **{CONTROLLER: {"pid__setpoint_weight": 0.7, "pid__roll_off": 2e4}}
    ),
    "pid that winds up": run(
        "fleming2010",
        setpoints=(0.0, 10e-6, -10e-6),
        **merged(HOLD, {CONTROLLER: {"pid__anti_windup": "none", "pid__derivative_weight": 0.5, **SMALL}}),
    ),
    "pid that clamps": run(
        "fleming2010",
        setpoints=(0.0, 10e-6, -10e-6),
        **merged(
            HOLD, {CONTROLLER: {"pid__anti_windup": "clamping", "command_maximum": 4e-6, "command_minimum": -5e-6}}
        ),
    ),
    "pid that calculates back": run(
        "fleming2010",
        setpoints=(0.0, 10e-6, -10e-6),
        **merged(HOLD, {CONTROLLER: {"pid__anti_windup": "back_calculation", "pid__tracking_time": 1e-3, **SMALL}}),
    ),
    **{
        f"damping by {kind}": run(
            "stage700",
            setpoints=JUMPS,
            **merged(BARE, {CONTROLLER: {"damping__type": kind, **SLOW, **of_damping(kind)}}),
        )
        for kind in ("irc", "ppf", "notch")
    },
    "damping by iff": run("stage700", setpoints=JUMPS, **merged(BARE, {CONTROLLER: IFF})),
    "static feedforward": run(
        "stage700", setpoints=JUMPS, **{CONTROLLER: {"feedforward__type": "static", "feedforward__preview": 3}}
    ),
    "inverse of the dynamics": run(
        "stage700",
        **merged(
            wave("sine", frequency=300.0),
            {CONTROLLER: {"feedforward__type": "inverse_dynamics", "feedforward__preview": 13}},
        ),
    ),
    "feedforward by velocity": run(
        "stage700", **merged(wave("sine", frequency=30.0), {CONTROLLER: {"feedforward__type": "velocity"}})
    ),
    # learning
    "repetitive learning": run(samples=200, **{SOURCE: TAUGHT, CONTROLLER: LEARNS}),
    "learning by inversion": run(
        samples=200,
        **{
            SOURCE: TAUGHT,
            CONTROLLER: LEARNS
            | {"learning__type": "inversion", "learning__averaging": 2.0, "learning__least_gain": 0.3},
        },
    ),
    "norm-optimal learning with late samples": run(
        samples=240,
        skipped=(70, 71, 150),
        **{
            SOURCE: TAUGHT,
            CONTROLLER: LEARNS
            | {"learning__type": "norm_optimal", "learning__recovery": 2e-3, "learning__late_recovery": 1e-3},
        },
    ),
    "a correction from a file": run(
        samples=120,
        changes=[(40, CONTROLLER, "forget"), (90, CONTROLLER, "learn")],
        **{SOURCE: TAUGHT, CONTROLLER: LEARNS | {"learning__active": False, "learning__file": "learned.yaml"}},
    ),
    "a correction of coupled axes": run(
        samples=90,
        **{SOURCE: TAUGHT, CONTROLLER: LEARNS | {"learning__type": "coupled", "learning__file": "learned.yaml"}},
    ),
    "learning that stops, forgets and meets limits": run(
        samples=420,
        changes=[
            (100, CONTROLLER, "freeze"),
            (140, CONTROLLER, "learn"),
            (200, CONTROLLER, "retune", {"learning.gain": 0.5, "learning.maximum": 1e-7}),
            (260, CONTROLLER, "forget"),
            (300, CONTROLLER, "stop"),
            (340, CONTROLLER, "start"),
        ],
        **{
            SOURCE: TAUGHT,
            CONTROLLER: LEARNS | {"learning__recovery": 1e-3},
            COMPENSATOR: {"limits__slew_rate": 3e4},
            "every": {"faults": ["nan:0.025:0.003"]},
        },
    ),
    # adaptation
    "adaptation": run("picma_stage", 400, seed=6, **ADAPTING),
    "adaptation with wrong and missing measurements": run(
        "picma_stage",
        300,
        seed=6,
        **merged(
            ADAPTING,
            {
                PLANT: {"sensor__offset": 1e-4, "overtravel": -1.0},
                COMPENSATOR: {"adaptation__factors": (1.1,) * 20, "limits__maximum": 2.9},
                "every": {"faults": ["nan:0.5:0.1", "lost_command:0.8:0.5"]},
            },
        ),
        skipped=(60, 61, 62, 150),
        changes=[(200, COMPENSATOR, "stop"), (220, COMPENSATOR, "start"), (250, COMPENSATOR, "reset")],
    ),
    "adaptation with changes": run(
        "picma_stage",
        300,
        seed=6,
        changes=[(100, COMPENSATOR, "freeze"), (160, COMPENSATOR, "resume"), (240, COMPENSATOR, "forget")],
        **merged(ADAPTING, {COMPENSATOR: {"adaptation__offset": "measured", "creep__type": "none"}}),
    ),
    # quiet holds
    "quiet hold": run("picma_stage", quiet=[(60, 80)], setpoints=(20e-6, 24e-6), **QUIET),
    "quiet hold extended": run("picma_stage", quiet=[(60, 60), (130, 50, 1e-6)], setpoints=(20e-6, 24e-6), **QUIET),
    "quiet hold during a move, cut short": run(
        "picma_stage",
        quiet=[(70, 100)],
        setpoints=(20e-6, 30e-6, 30e-6),
        changes=[(130, CONTROLLER, "quiet", {"duration": 0.0})],
        **merged(QUIET, {SOURCE: limited(2e-4, 4e-3, 0.0)}),
    ),
    "quiet hold by a pulse, with missing measurements": run(
        "picma_stage",
        setpoints=(20e-6,),
        pulses=(40, 180),
        **merged(
            QUIET,
            {CONTROLLER: {"quiet__on_trigger": 0.4}, "every": {"time_mode": "fused", "faults": ["stale:0.6:0.1"]}},
        ),
    ),
    "quiet hold that a stop ends": run(
        "picma_stage",
        quiet=[(40, 150)],
        setpoints=(20e-6,),
        changes=[(110, CONTROLLER, "stop"), (150, CONTROLLER, "start")],
        **QUIET,
    ),
    # triggers
    "triggers of a grid": run(samples=180, **{SOURCE: TRIANGLE | GRID, PLANT: NOISE}),
    "triggers up": run(samples=180, **{SOURCE: TRIANGLE | GRID | {"triggers__direction": "up"}}),
    "triggers down, at a limited rate": run(
        samples=180, **{SOURCE: TRIANGLE | GRID | {"triggers__direction": "down", "triggers__rate": 1700.0}}
    ),
    "triggers at positions, some lost": run(
        samples=180,
        **{
            SOURCE: TRIANGLE
            | {
                "triggers__positions": (1e-6, 1.3e-6, 4e-6),
                "triggers__down_positions": (3e-6,),
                "triggers__rearm": 2e-7,
            },
            "every": {"faults": ["nan:0.015:0.005"]},
        },
    ),
    "triggers at times": run(
        samples=120, **{SOURCE: TRIANGLE | {"triggers__times": (0.0, 0.0101, 0.0105, 0.02)}}, skipped=(31, 60)
    ),
    "a pulse starts": run(
        pulses=(60, 150), **{SOURCE: TRIANGLE | {"triggers__input__action": "start", "triggers__times": (0.001, 0.004)}}
    ),
    "a pulse holds": run(
        pulses=(60,),
        changes=[(120, SOURCE, "start")],
        **{SOURCE: TRIANGLE | {"triggers__input__action": "hold"}},
    ),
    "pulses step": run(
        pulses=(20, 40, 60, 80, 100, 120),
        setpoints=(2e-6, 8e-6),
        **merged(HOLD, {SOURCE: {"triggers__input__action": "step", "triggers__input__distance": 2.4e-6}}),
    ),
    **{
        f"triggers at each {level} of a scan": run(
            samples=200,
            **merged(
                wave("scan", scan__kind="raster", scan__values=SCANS["raster"].split(), scan__clock=level),
                {SOURCE: {"triggers__each": level}},
            ),
        )
        for level in ("frame", "line", "pixel")
    },
    # references
    **{
        f"waveform {name}": run(samples=160, **wave(name.split()[0], **own))
        for name, own in {
            "chirp": {"chirp__final_frequency": 200.0, "chirp__duration": 0.03, "phase": 0.3},
            "chirp of growing steps": {
                "chirp__final_frequency": 200.0,
                "chirp__duration": 0.04,
                "chirp__sweep": "logarithmic",
                "cycles": 1,
            },
            "decaying_sine": {"decaying_sine__decay_time": 0.02, "cycles": 2},
            "decreasing_triangle": {"cycles": 3, "polarity": "symmetric"},
            "file": {"file__path": "samples.csv", "file__sample_time": 1.0 / 3000.0, "cycles": 2},
            "file of slower samples": {
                "file__path": "samples.csv",
                "file__sample_time": 0.001,
                "file__column": "other",
            },
            "hold": {},
            "multisine": {"multisine__last_harmonic": 5, "polarity": "symmetric"},
            "multisine of odd harmonics": {
                "multisine__phases": "random",
                "multisine__harmonic_step": 2,
                "multisine__last_harmonic": 9,
                "frequency": 25.0,
                "polarity": "symmetric",
            },
            "sine": {"phase": 0.7, "offset": 5e-7, "cycles": 1},
            "square": {"square__duty": 0.3},
            "square that ends": {"cycles": 1, "polarity": "symmetric"},
            "staircase": {"staircase__steps": 3},
            "staircase that ends": {"staircase__steps": 2, "cycles": 1, "polarity": "symmetric"},
            "steps that end": {"steps__values": (0.0, 3e-6), "steps__times": (0.005, 0.01), "cycles": 1},
            "multisine that ends": {"multisine__last_harmonic": 4, "polarity": "symmetric", "cycles": 1},
            "triangle that ends": {"cycles": 1, "offset": 5e-7},
            "steps": {"steps__values": (0.0, 3e-6, -2e-6), "steps__times": (0.005, 0.01, 0.02), "steps__period": 0.03},
            "triangle": {"polarity": "symmetric", "phase": 1.0},
        }.items()
    },
    **{
        f"scan {name}": run(
            samples=200,
            **wave("scan", scan__kind=name.split()[0], scan__values=values.split(), scan__clock="line", cycles=1),
        )
        for name, values in SCANS.items()
    },
    "scan y, frames": run(
        samples=160,
        **wave(
            "scan",
            scan__kind="lissajous",
            scan__values=SCANS["lissajous"].split(),
            scan__coordinate="y",
            scan__clock="frame",
        ),
    ),
    "scan z of a tilted plane": run(
        samples=160,
        **wave(
            "scan",
            scan__kind="raster",
            scan__values=(SCANS["raster"] + " axes=3 slope_x=0.1 slope_y=-0.2 height=1um").split(),
            scan__coordinate="z",
            scan__clock="none",
        ),
    ),
    "approach from rest": run(
        samples=300, setpoints=(6e-6, 6e-6, 2e-6), **merged(HOLD, {SOURCE: limited(from_rest=True)})
    ),
    "approach with limited acceleration": run(
        samples=300, setpoints=(0.0, 9e-6, 3e-6, 8e-6), **merged(HOLD, {SOURCE: limited(8e-4, 0.05, 0.0)})
    ),
    "approach of steps": run(
        samples=300,
        **merged(
            wave("steps", steps__values=(0.0, 4e-6, -1e-6), steps__times=(0.0, 0.01, 0.04)),
            {SOURCE: limited(steps=True, jerk=5.0)},
        ),
    ),
    "approach from rest without limits": run(
        samples=300,
        setpoints=(5e-6, 4e-6),
        pulses=(150,),
        **merged(
            {SOURCE: TRIANGLE | {"waveform__amplitude": 2e-6, "initial_setpoint": 5e-6}},
            {SOURCE: {"approach__from_rest": True, "approach__start_time": 0.02, "triggers__input__action": "start"}},
        ),
    ),
    **{
        f"shaper {kind}": run(
            samples=160,
            setpoints=JUMPS,
            **merged(HOLD, {SOURCE: {"shaping__type": kind, "shaping__frequency": 635.0, "shaping__damping": 0.1}}),
        )
        for kind in ("zv", "zvd")
    },
    "trajectories": run(
        samples=500,
        setpoints=(0.0, 0.0, 0.0, 1e-6, 1e-6),
        changes=[
            (20, SOURCE, "follow", POINTS),
            (150, SOURCE, "follow", {"times": (0.02, 0.03), "positions": (2e-6, 3e-6), "velocities": (1e-4, 0.0)}),
            (
                280,
                SOURCE,
                "follow",
                {"times": (0.1,), "positions": (9e-6,), "velocities": (0.0,), "accelerations": (0.0,)},
            ),
            (380, SOURCE, "follow", POINTS),
            (410, SOURCE, "hold"),
        ],
        **merged(HOLD, {SOURCE: limited(8e-4, 0.2, 0.0)}),
    ),
    "trajectories without limits": run(
        samples=400,
        changes=[
            (20, SOURCE, "follow", POINTS),
            (100, SOURCE, "stop"),
            (140, SOURCE, "start"),
            (200, SOURCE, "follow", POINTS),
            (240, PLANT, "halt"),
            (300, PLANT, "start"),
            (340, SOURCE, "begin_at", {"position": 4e-6}),
        ],
        **HOLD,
    ),
    # faults, missing and late values
    **{
        f"fault {name}": run(
            samples=200,
            setpoints=(2e-6, 7e-6),
            **merged(HOLD, GUARDED, {"every": {"faults": [f"{name}:0.02:0.005", f"{name}:0.0305:0.0102"]}}),
        )
        for name in FAULTS
        if name not in ("lost_grip", "lost_force")
    },
    "fault lost_force": run(
        "stage700",
        setpoints=JUMPS,
        **merged(
            BARE,
            {CONTROLLER: IFF | {"measurement_timeout": 1e-3, "safe_slew_rate": 1e-3}},
            {"every": {"faults": ["lost_force:0.003:0.003", "late:0.008:0.002:3", "spike:0.0095:0.001:2e-6"]}},
        ),
    ),
    "fault lost_grip": run(
        "inchworm_travel",
        500,
        setpoints=(0.0, 2e-5, 2e-5),
        **{
            "every": {"faults": ["lost_grip:0.025:0.01:0.02", "stale:0.042:0.003"]},
            MOTOR: {"setpoints__times": [], "setpoints__values": []},
        },
    ),
    "faults at the first sample": run(
        samples=120,
        setpoints=(5e-6,),
        **merged(
            HOLD, GUARDED, {"every": {"faults": ["stale:0:0.003", "unanswered:0.001:0.02", "lost_voltage:0:0.002"]}}
        ),
    ),
    "measurements from a spiking, freezing sensor": run(
        samples=300,
        setpoints=(2e-6, 7e-6),
        **merged(
            HOLD,
            GUARDED,
            {
                CONTROLLER: {"spike_limit": 5e-7, "spike_samples": 2, "frozen_samples": 3},
                PLANT: NOISE | {"overtravel": -1.0},
                "every": {"faults": ["frozen:0.02:0.004", "offset:0.04:0.02:2e-6", "spike:0.07:0.01:9e-7"]},
            },
        ),
    ),
    "skipped samples": run(
        skipped=(50, 51, 80, 81, 82, 83, 84, 85, 86, 87, 88, 89, 90), setpoints=JUMPS, **merged(HOLD, GUARDED)
    ),
    "an observer predicts through missing measurements": run(
        setpoints=JUMPS,
        **merged(
            HOLD,
            GUARDED,
            {CONTROLLER: {**OBSERVED, "kalman__disturbance": "constant"}, "every": {"faults": ["drop:0.01:0.06:0.5"]}},
        ),
    ),
    # trips
    "a trip by too many late voltages in a row": run(
        setpoints=JUMPS,
        changes=[(160, PLANT, "start")],
        **merged(HOLD, GUARDED, {PLANT: {"late_limit": 5}, "every": {"faults": ["lost_voltage:0.03:0.002"]}}),
    ),
    "as many late voltages as are allowed": run(
        setpoints=JUMPS,
        **merged(HOLD, GUARDED, {PLANT: {"late_limit": 6}, "every": {"faults": ["lost_voltage:0.03:0.002"]}}),
    ),
    "a trip by late voltages within a second": run(
        setpoints=JUMPS,
        changes=[(200, PLANT, "start")],
        **merged(HOLD, GUARDED, {PLANT: {"late_limit": 12}, "every": {"faults": ["late_voltage:0.01:0.05:0.6"]}}),
    ),
    **{
        f"a trip by overtravel {way}": run(
            setpoints=jumps,
            changes=[(160, PLANT, "start")],
            **merged(HOLD, GUARDED, {CONTROLLER: {"type": "open_loop"}, PLANT: {"overtravel": 1e-6}}),
        )
        for way, jumps in {"above": (1e-6, 11e-6, 11e-6), "below": (11e-6, 0.0, 0.0)}.items()
    },
    "emergency stop": run(
        setpoints=JUMPS,
        changes=[
            (60, PLANT, "halt"),
            (120, PLANT, "start"),
            (200, PLANT, "reset"),
            (205, SOURCE, "reset"),
            (206, CONTROLLER, "reset"),
            (207, COMPENSATOR, "reset"),
        ],
        **merged(HOLD, GUARDED),
    ),
    **{
        f"pulses that {action} while the axis is stopped": run(
            pulses=(20, 70, 100, 150),
            setpoints=(2e-6, 3e-6),
            changes=[(60, PLANT, "halt"), (120, PLANT, "start")],
            **merged(
                {SOURCE: TRIANGLE | {"waveform__amplitude": 5e-6, "triggers__input__action": action, **own}}, GUARDED
            ),
        )
        for action, own in (("start", {}), ("hold", {}), ("step", {"triggers__input__distance": 1e-6}))
    },
    # stops and changes
    "stops of all parts": run(
        samples=400,
        setpoints=(4e-6, 4e-6, 6e-6, 2e-6),
        changes=[
            (60, CONTROLLER, "stop"),
            (110, CONTROLLER, "start"),
            (160, COMPENSATOR, "stop"),
            (220, COMPENSATOR, "start"),
            (260, SOURCE, "stop"),
            (330, SOURCE, "start"),
        ],
        **merged(HOLD, GUARDED),
    ),
    "stops of a pid with damping": run(
        "stage700",
        400,
        setpoints=(4e-6, 9e-6),
        changes=[
            (60, CONTROLLER, "stop"),
            (150, CONTROLLER, "start"),
            (260, COMPENSATOR, "stop"),
            (300, COMPENSATOR, "start"),
        ],
        **merged(
            BARE,
            {
                CONTROLLER: {"safe_slew_rate": 1e-3, "handover_time": 2e-3},
                COMPENSATOR: {"handover_time": 2e-3, "safe_slew_rate": 3e4},
            },
        ),
    ),
    "changes while it runs": run(
        samples=480,
        setpoints=(0.0, 4e-6, 6e-6, 3e-6),
        changes=[
            (60, CONTROLLER, "retune", {"sliding_mode.phi": 0.9, "handover_time": 0.02}),
            (100, COMPENSATOR, "retune", {"hysteresis.polynomial.scale": 1.03}),
            (140, CONTROLLER, "retune", {"type": "open_loop"}),
            (200, CONTROLLER, "retune", {"type": "pid", "pid.Ki": 100.0}),
            (260, CONTROLLER, "retune", {"type": "super_twisting"}),
            (300, CONTROLLER, "retune", {"type": "integral_sliding_mode"}),
            (360, CONTROLLER, "retune", {"type": "sliding_mode"}),
            (400, PLANT, "retune", {"hysteresis.polynomial.scale": 0.98, "sensor.noise": 1e-9}),
            (430, COMPENSATOR, "retune", {"limits.maximum": 40.0, "safe_voltage": 20.0, "handover_time": 0.01}),
        ],
        **HOLD,
    ),
    "changes of a pid and its damping": run(
        "stage700",
        400,
        setpoints=JUMPS,
        changes=[
            (60, CONTROLLER, "retune", {"pid.Kp": 0.01, "handover_time": 2e-3}),
            (120, CONTROLLER, "retune", {"damping.irc.k": 900.0}),
            (180, CONTROLLER, "retune", {"damping.type": "none", "pid.Kp": 0.0, "pid.Ki": 20.0, "pid.Kd": 0.0}),
            (240, COMPENSATOR, "retune", {"hysteresis.prandtl_ishlinskii.offset": 1e-7, "safe_slew_rate": 1e4}),
            (260, CONTROLLER, "stop"),
            (300, CONTROLLER, "retune", {"type": "open_loop"}),
            (320, CONTROLLER, "start"),
            (360, SOURCE, "stop"),
            (365, SOURCE, "retune", {"waveform.type": "sine", "waveform.amplitude": 1e-6, "waveform.frequency": 500.0}),
            (370, SOURCE, "start"),
        ],
        **BARE,
    ),
    "changes within a sample": run(
        setpoints=JUMPS,
        changes=[
            (50, PLANT, "halt", {}, "measured"),
            (90, PLANT, "start", {}, "measured"),
            (120, CONTROLLER, "retune", {"sliding_mode.phi": 0.8}, "answered"),
            (120, CONTROLLER, "stop", {}, "answered"),
            (150, CONTROLLER, "start"),
        ],
        **HOLD,
    ),
    "a device's answers": repeated("kim2009", 200, **GUARDED),
    # motors
    "steps of a motor": run("inchworm_travel", 1400, setpoints=(0.0, 2.4e-5, 2.4e-5, -3e-6), **AT_REST),
    "a motor with a load": run(
        "inchworm_travel",
        900,
        setpoints=(2e-5,),
        seed=1,
        **merged(
            AT_REST,
            {
                PLANT: {
                    "inchworm__slider__external_force": -2.0,
                    "inchworm__front_clamp__wear": 0.8,
                    "inchworm__rear_clamp__lag__type": "second_order",
                    "inchworm__rear_clamp__lag__second_order__frequency": 1400.0,
                    "inchworm__rear_clamp__lag__second_order__damping": 0.7,
                    "inchworm__slider__inclination": 0.1,
                    "inchworm__front_clamp__lag__type": "second_order",
                    "inchworm__front_clamp__lag__second_order__frequency": 1500.0,
                    "inchworm__front_clamp__lag__second_order__damping": 0.6,
                },
                MOTOR: {"gait__overlap": 5e-4, "gait__clamp_ramp": "linear", "fine__smoothing_time": 1e-3},
            },
        ),
    ),
    "a motor of compliant clamps": run(
        "inchworm_travel", 400, setpoints=(2e-5,), **merged(AT_REST, {PLANT: COMPLIANT})
    ),
    "a motor that slips": run(
        "inchworm_travel",
        900,
        setpoints=(3e-5,),
        **merged(
            AT_REST,
            {
                PLANT: {
                    "inchworm__front_clamp__static_friction": 1e-6,
                    "inchworm__front_clamp__kinetic_friction": 1e-6,
                },
                MOTOR: {"guard__still_steps": 2},
            },
        ),
    ),
    "a motor that slips while it positions": run(
        "inchworm_travel",
        700,
        setpoints=(1e-6, 1.5e-6, 1.05e-5),
        **merged(
            AT_REST,
            {
                PLANT: {"inchworm__slider__external_force": -3.0},
                MOTOR: {"guard__slip": 2e-8, "guard__drift": 0.0, "fine__tolerance": 1e-9, "fine__timeout": 0.01},
                "every": {"faults": ["lost_grip:0.03:0.02:0.3"]},
            },
        ),
    ),
    "a motor that runs away": run(
        "inchworm_travel",
        500,
        setpoints=(0.0,),
        **merged(AT_REST, {MOTOR: {"guard__runaway": 1e-6}, "every": {"faults": ["offset:0.02:0.01:5e-6"]}}),
    ),
    "a motor that positions at other extensions": run(
        "inchworm_travel",
        900,
        setpoints=(-5e-7, 4e-7, 3e-7, -2e-6, 9e-6),
        **merged(
            AT_REST,
            {
                MOTOR: {
                    "gait__fine_margin": 1e-7,
                    "resting_extension": 3e-6,
                    "learning__enabled": False,
                    "fine__smoothing_time": 1e-3,
                    "guard__sensor_timeout": 0.0,
                }
            },
        ),
    ),
    "a motor that only steps": run(
        "inchworm_travel",
        900,
        setpoints=(1.9e-5,),
        requests={700: 4.0, 850: 1.0},
        **merged(AT_REST, {MOTOR: {"fine__enabled": False, "gait__walking_speed": 2e-4, "gait__settle": 5e-4}}),
    ),
    "a motor that steps at a speed": run(
        "inchworm_travel", 900, setpoints=(0.0,), speeds={20: -1.5e-4, 500: 1e-4, 800: 0.0}, **AT_REST
    ),
    "a motor that is stopped, homed and started": run(
        "inchworm_travel",
        1000,
        setpoints=(-2e-5,),
        requests={150: 2.0, 300: 1.0, 500: 3.0, 800: 2.0, 900: 4.0},
        **AT_REST,
    ),
    "a motor with faults": run(
        "inchworm_travel",
        800,
        setpoints=(2e-5,),
        changes=[
            (300, PLANT, "halt"),
            (400, PLANT, "start"),
            (650, PLANT, "retune", {"inchworm.rear_clamp.wear": 0.9}),
        ],
        skipped=(120, 121),
        **merged(
            AT_REST,
            GUARDED,
            {
                PLANT: {"safe_voltage": 0.0},
                COMPENSATOR: {"safe_voltage": 0.0},
                "every": {"faults": ["stale:0.015:0.004", "lost_voltage:0.055:0.005"]},
            },
        ),
    ),
    **{
        f"a motor with triggers {way}": run(
            "inchworm_travel",
            500,
            setpoints=(1.2e-5, 2e-6),
            **merged(AT_REST, {MOTOR: {**STEPS, "triggers__direction": way}}),
        )
        for way in ("both", "up", "down")
    },
    "a motor that pulses step": run(
        "inchworm_travel",
        500,
        setpoints=(0.0,),
        pulses=(100, 250),
        **merged(AT_REST, {MOTOR: {"triggers__input__action": "step", "triggers__input__distance": 6e-7}}),
    ),
    **{
        f"pulses that {action} a motor while it is stopped": run(
            "inchworm_travel",
            400,
            pulses=(70, 150, 200, 330),
            setpoints=(1.5e-5,),
            changes=[(120, PLANT, "halt"), (250, PLANT, "start")],
            **merged(AT_REST, {MOTOR: {"triggers__input__action": action}}),
        )
        for action in ("start", "hold")
    },
    "a motor that walks on and learns": run(
        "inchworm_travel",
        1500,
        setpoints=(0.0,),
        speeds={50: 2e-4},
        requests={400: 5.0, 1200: 6.0},
        **merged(AT_REST, {MOTOR: WALK}),
    ),
    "a motor that walks back and forth": run(
        "inchworm_travel",
        1500,
        setpoints=(0.0, 0.0, 2e-5),
        speeds={50: -3e-4, 500: 2e-4, 800: 0.0},
        seed=2,
        **merged(
            AT_REST,
            {
                MOTOR: WALK
                | {"walk__quick_clamps": False, "walk__resonance": 0.0, "walk__swing": 0.0, "walk__learning": True}
            },
        ),
    ),
    # stages
    "a stage with lost sensors": stage(
        samples=240,
        setpoints={"x": (20e-6, 24e-6), "y": (20e-6, 17e-6, 20e-6)},
        **merged(of_axes(SHORT), of_axes({node: {"faults": ["stale:0.008:0.004"]} for node in NODES}, "y")),
    ),
    "a stage in which one axis stops": stage(
        samples=300,
        setpoints={"x": (20e-6, 24e-6), "y": (20e-6, 17e-6, 20e-6)},
        changes={
            "x": [(60, PLANT, "halt"), (120, PLANT, "start"), (200, CONTROLLER, "stop"), (240, CONTROLLER, "start")],
            "y": [(120, PLANT, "start"), (150, CONTROLLER, "retune", {"pid.Ki": 1000.0}), (270, PLANT, "reset")],
        },
        skipped=(20, 21),
        **merged(of_axes(SHORT), {"stage": {"sensor_matrix": (1.0, 0.02, -0.03, 0.98)}}),
    ),
    "a stage without decoupling": stage(
        samples=200, setpoints={"x": (20e-6, 25e-6)}, **merged(BARE, {"stage": {"decoupling": []}})
    ),
    "a stage at its limits": stage(
        setpoints={"x": (20e-6, 40e-6), "y": (20e-6, 2e-6)},
        **merged(BARE, HOLD, of_axes({SOURCE: {"waveform__type": "hold"}}, "x")),
    ),
    "a stage with its own feedforward": stage(
        samples=200,
        changes={"y": [(80, CONTROLLER, "stop"), (120, CONTROLLER, "start"), (160, CONTROLLER, "reset")]},
        setpoints={"y": (20e-6, 21e-6)},
        **merged(FED, BARE),
    ),
    "a raster of a stage": stage(
        samples=500,
        scan=("raster", "width=10um depth=4um lines=3 flyback=1 frame_rate=25Hz rotation=10deg slow=ramped pixels=4"),
        **{"stage": {"scan__clock": "pixel", "scan__periods": 1}, "x__reference_generator": {"triggers__each": "line"}},
    ),
    "a spiral of a stage": stage(
        samples=200,
        scan=("spiral", "diameter=6um turns=4 frame_rate=60Hz"),
        **{"stage": {"scan__clock": "none", "scan__axes": ["y", "x"]}},
    ),
    "a path of a stage": stage(
        samples=200,
        scan=("file", "path=path.csv frame_rate=50Hz way_back=0.2"),
        **{"stage": {"scan__clock": "frame"}},
    ),
    "a mirror that tilts": stage(
        "steering_mirror",
        setpoints={"s1": (0.0, 3e-7), "s2": (0.0, -2e-7), "s3": (1e-7,)},
        changes={"s2": [(60, CONTROLLER, "retune", {"pid.Ki": 90.0})]},
        **BARE,
    ),
    # figures of designs, margins, scans and moves: not runs, but results that runs and users rely on
    "figures of designs": figures(design_figures),
    "figures of margins": figures(margin_figures),
    "figures of a stage": figures(stage_figures),
    **{f"figures of a {name}": figures(scan_figures, name) for name in SCANS},
    "figures of a mirror": figures(mirror_figures),
    "figures of forecasts": figures(forecast_figures),
    "figures of moves": figures(move_figures),
    "figures of recipes": figures(recipe_figures),
    "figures of linear algebra": figures(algebra_figures),
    # arrays
    "an array": array(
        "kim2009",
        60,
        JUMPS,
        {"plant_simulator.sensor.seed": (1, 2), "plant_simulator.sensor.noise": (1e-9, 2e-9)},
        **HOLD,
    ),
    "an array of axes with other gains": array(
        "stage700",
        60,
        JUMPS,
        {"motion_controller.pid.Ki": (1900.0, 1500.0), "plant_simulator.sensor.offset": (0.0, 1e-8)},
    ),
}


def digest(values: np.ndarray) -> str:
    """Return a digest of the bits of a signal; every NaN counts as the same NaN, because its bits vary."""
    values = np.asarray(values, dtype=float)
    return hashlib.sha256(np.where(np.isnan(values), np.nan, values).tobytes()).hexdigest()[:10]


def write_files() -> None:
    """Write the files that some runs read into the present folder."""
    angle = 2.0 * np.pi * np.arange(30) / 30
    pathlib.Path("samples.csv").write_text(
        "reference [um],other [um]\n" + "\n".join(f"{k % 7 * 0.3:.3f},{k % 5 * 0.5:.3f}" for k in range(40)) + "\n"
    )
    pathlib.Path("path.csv").write_text(
        "time [s],x [um],y [um]\n"
        + "\n".join(f"{k * 0.001:.3f},{k % 9 * 0.2:.2f},{k * 0.1:.2f}" for k in range(20))
        + "\n"
    )
    correction = np.round(1e-7 * np.sin(angle), 12)
    write_learned("learned.yaml", Learned(0.01, 1.0 / 3000.0, correction, np.round(2e-6 * np.cos(angle), 12)))


def digests(names: Sequence[str] = tuple(RUNS)) -> dict[str, dict[str, Any]]:
    """Return the number of samples of each run, and the digest of each signal that is not 0 in all samples."""
    found: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        write_files()
        for name in names:
            try:
                made = RUNS[name]()
            except Exception as error:
                found[name] = {FAILED: f"{type(error).__name__}: {error}"}
                continue
            found[name] = {"samples": len(next(iter(made.values())))}
            found[name] |= {signal: digest(values) for signal, values in sorted(made.items()) if np.any(values)}
    return found


def interpreted(names: Sequence[str] = tuple(RUNS), **environment: str) -> dict[str, Any]:
    """Return the digests of these runs, and the used choices, from a process without compiled kernels."""
    own = {**os.environ, "NUMBA_DISABLE_JIT": "1", "OPENBLAS_NUM_THREADS": "1", **environment}
    command = [sys.executable, __file__, "--print", *names]
    done = subprocess.run(command, env=own, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def changed(recorded: Mapping[str, Mapping], made: Mapping[str, Mapping]) -> list[str]:
    """Return a line for each run that differs from the recorded one, with its signals that differ."""
    lines = []
    for name in sorted({*recorded, *made}):
        old, new = recorded.get(name, {}), made.get(name, {})
        signals = [signal for signal in sorted({*old, *new}) if old.get(signal) != new.get(signal)]
        if FAILED in new:
            lines.append(f"{name}: {new[FAILED]}")
        elif not old or not new:
            lines.append(f"{name}: {'not recorded yet' if new else 'no longer a run'}")
        elif signals:
            lines.append(f"{name} ({new['samples']} samples): {', '.join(signals)}")
    return lines


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    return interpreted()


@pytest.mark.slow
def test_every_run_has_its_recorded_bits(made):
    differing = changed(json.loads(RECORDED.read_text(encoding="utf-8")), made["runs"])
    assert not differing, "results changed; if on purpose, renew the file (see the module):\n" + "\n".join(differing)


@pytest.mark.slow
def test_other_processors_give_the_recorded_bits():
    from processors_support import PROCESSORS  # the path of the tests is pytest's

    few = [name for name in RUNS if name.startswith(FEW)]
    recorded = json.loads(RECORDED.read_text(encoding="utf-8"))
    other = interpreted(few, **PROCESSORS["Prescott, nothing fused"])["runs"]
    assert not changed({name: recorded[name] for name in few}, other)


@pytest.mark.slow
def test_the_runs_use_every_choice_of_every_parameter(made):
    parameters = {**NODE_PARAMETERS, "stage": StageNodeParameters}
    missing = {
        f"{node}.{row.name}": sorted(unused)
        for node, kind in parameters.items()
        for row in kind.table()
        if row.choices
        and not re.fullmatch(NOT_OF_THE_LOOP, f"{node}.{row.name}")
        and (unused := set(row.choices) - set(made["used"].get(f"{node}.{row.name}", ())))
    }
    assert not missing, "add runs with these choices"


def main() -> None:
    """Print the digests of runs, or renew the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--renew", action="store_true", help="renew the file and print what changed")
    parser.add_argument("--print", nargs="*", metavar="RUN", help="print the digests of these runs, by default of all")
    given = parser.parse_args()
    warnings.filterwarnings("ignore")
    if given.renew:
        made = interpreted()["runs"]
        recorded = json.loads(RECORDED.read_text(encoding="utf-8")) if RECORDED.exists() else {}
        lines = [f"{json.dumps(name)}: {json.dumps(made[name])}" for name in sorted(made)]
        RECORDED.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
        print("\n".join(changed(recorded, made)) or "nothing changed")
        return
    made = digests(given.print or tuple(RUNS))
    json.dump({"runs": made, "used": {name: sorted(values) for name, values in used.items()}}, sys.stdout)


if __name__ == "__main__":
    main()
