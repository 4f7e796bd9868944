# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Offline simulation and repetition of runs; plants that deviate from their models or drift; modes of the parts.

In a random plant these quantities are multiplied by independent factors 1 + m u, where m is the mismatch and u is
uniform in ±1: the gain, the loop width of the hysteresis (each model declares the parameters that determine it, and may
declare more factors), the time scale of the linear dynamics, and the rate of the creep. The models of compensator and
controller do not change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.control.uncertainty import slowed
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem, RecordingError
from hysteresis_ros.loop.axis import STEPS, Axis, Change
from hysteresis_ros.loop.device import fused_plant_of
from hysteresis_ros.loop.parameters import AxisParameters, PlantNodeParameters
from hysteresis_ros.loop.quiet import QUIET, Quiet
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.tick import BEFORE
from hysteresis_ros.loop.watch import MODE_NAMES, RUNNING
from hysteresis_ros.models.declaration import Deviation
from hysteresis_ros.recordings.dataset import SIMULATED, Recording, note_output, output_tolerance, requests_per_sample

#: Largest allowed mismatch; even with it, every random parameter keeps its sign with a margin.
LARGEST = 0.5


def mismatched(configuration: Configuration, mismatch: float, seed: int) -> Configuration:
    """Return the configuration with a random plant close to the configured plant."""
    if not 0.0 <= mismatch <= LARGEST:
        raise ParameterError([Problem("mismatch", mismatch, f"must be within 0 … {LARGEST:g}")])
    if seed < 0:
        raise ParameterError([Problem("seed", seed, "must be 0 or more")])
    plant = single_axis(configuration).plant_simulator
    random = np.random.default_rng(seed)

    def factor(count=None):
        return 1.0 + mismatch * random.uniform(-1.0, 1.0, count)

    # drawn in a fixed order, so that a seed gives the same factors for every model
    gain, opening, slowness, creeping = factor(), factor(), factor(), factor()
    changed = deviating(plant, Deviation(gain, opening, factor), slowness, creeping)
    return configuration.override("plant_simulator", **changed)


def deviating(
    plant: PlantNodeParameters, deviation: Deviation, slowness: float = 1.0, creeping: float = 1.0
) -> dict[str, Any]:
    """Return the parameters that change if the plant deviates from the given one, with their new values."""
    model, configured = plant.hysteresis.model, plant.hysteresis.chosen.to_mapping()
    drawn = model.deviated(plant.hysteresis.chosen, deviation).to_mapping()
    changed = {
        f"hysteresis.{model.name}.{name}": value for name, value in drawn.items() if value != configured.get(name)
    }
    if slowness != 1.0:
        changed |= {f"dynamics.{name}": value for name, value in slowed(plant.dynamics, slowness).items()}
    if plant.creep.type == "logarithmic":
        changed["creep.logarithmic.rate"] = plant.creep.logarithmic.rate * creeping
    elif plant.creep.type == "operators":
        changed["creep.operators.weights"] = (np.array(plant.creep.operators.weights) * creeping).tolist()
    return changed


#: Largest change of a factor in one step.
STEP = 1e-3


def drifting(parameters: AxisParameters, samples: int, gain: float = 0.0, opening: float = 0.0) -> list[Change]:
    """Return the changes with which the plant of an axis drifts linearly over a run.

    The displacement does not jump at a step of the drift, because a change of gain leaves the present displacement
    unchanged.
    """
    plant = parameters.plant_simulator
    for name, value in (("gain", gain), ("opening", opening)):
        if not abs(value) <= LARGEST:
            raise ParameterError([Problem(f"drift {name}", value, f"must be within -{LARGEST:g} … {LARGEST:g}")])
    if plant.type == "inchworm" or plant.driver:
        what = "a device" if plant.driver else "an inchworm motor"
        raise ParameterError([Problem("drift", what, "requires a simulated actuator")])
    model, chosen = plant.hysteresis.model, plant.hysteresis.chosen
    steps = math.ceil(round(max(abs(gain), abs(opening)) / STEP, 9))
    changes = []
    for number in range(1, steps + 1):
        share = number / steps
        deviation = Deviation(1.0 + share * gain, 1.0 + share * opening, lambda count=None: np.ones(count or ()))
        drifted = model.deviated(chosen, deviation).to_mapping()
        changed = {
            f"hysteresis.{model.name}.{name}": value
            for name, value in drifted.items()
            if value != getattr(chosen, name, value)
        }
        changes.append(Change(round(share * samples) - 1, "plant_simulator", "retune", changed))
    return changes


def simulate(
    parameters: AxisParameters,
    *,
    duration: float | None = None,
    setpoints=None,
    requests=None,
    speeds=None,
    changes: Sequence[Change] = (),
    drift: tuple[float, float] = (0.0, 0.0),
    skipped=None,
    pulses=None,
    answers: dict | None = None,
    quiet: Sequence[Quiet] = (),
    describe: bool = True,
    finished: Callable[[Axis], None] | None = None,
) -> Recording:
    """Run an axis offline from rest for ``duration`` [s], with ``setpoints`` [m] and quiet holds."""
    if duration is not None:
        parameters = parameters.with_duration(duration)
    plant = fused_plant_of(parameters.plant_simulator, linked=False) if answers else None
    axis = Axis(parameters, plant)
    if duration is not None:
        samples = parameters.plant_simulator.samples
    else:
        samples = len(setpoints) if setpoints is not None else axis.default_samples()
    if samples < 1:
        raise ConfigurationError("the configuration has no end (samples: 0, endless waveform): give --duration S")
    setpoints = axis.default_setpoints(samples) if setpoints is None else _padded(setpoints, samples, setpoints[-1])
    asked = {"requests": (requests, 0.0), "speeds": (speeds, np.nan), "skipped": (skipped, 0.0)}
    asked |= {"pulses": (pulses, 0.0)}
    given: dict[str, Any] = {
        name: _padded(values, samples, rest) for name, (values, rest) in asked.items() if values is not None
    }
    if answers:
        given["answers"] = {name: _padded(values, samples, np.nan) for name, values in answers.items()}
    for one in quiet:
        sample = round(one.start * axis.sample_rate)
        if sample >= samples:
            end = f"must be before the end of the run, {samples / axis.sample_rate:g} s"
            raise ParameterError([Problem("quiet: start", one.start, end, "s")])
        changes = [*changes, Change(sample, "motion_controller", QUIET, one.parameters)]
    if any(drift):
        changes = [*changes, *drifting(parameters, samples, *drift)]
    signals = axis.run(setpoints, changes=changes, **given)
    if finished is not None:
        finished(axis)
    nodes = (parameters.plant_simulator, parameters.hysteresis_compensator)
    tolerance = output_tolerance(*(node.to_mapping() for node in nodes))
    note_output(signals, signals["plant_voltage"], signals["plant_mode"], tolerance)
    return Recording(signals.pop("time"), signals, {}, run_metadata(parameters, describe))


def run_metadata(parameters: AxisParameters, describe: bool = True) -> dict[str, Any]:
    """Return the metadata of an offline run of an axis; with ``describe``, also the configuration of the axis."""
    return {
        "configuration": parameters.configuration_text() if describe else "",
        "namespace": parameters.namespace,
        "source": SIMULATED,
        "joint": parameters.plant_simulator.joint,
    }


def _padded(values, samples: int, rest: float) -> np.ndarray:
    """Return the first ``samples`` values; if there are fewer, append ``rest``."""
    values = np.asarray(values, dtype=float)[:samples]
    return np.concatenate([values, np.full(samples - len(values), rest)])


#: Actions of each node in the log of a run.
LOGGED = {
    "plant_simulator": ("start", "halt", "reset", "retune", "home"),
    "reference_generator": ("start", "stop", "hold", "follow", "begin_at", "reset", "retune"),
    "inchworm_sequencer": ("reset", "retune"),
    "motion_controller": ("start", "stop", "reset", "retune", "learn", "freeze", "forget", "quiet"),
    "hysteresis_compensator": ("start", "stop", "reset", "retune", "freeze", "resume", "forget"),
    "displacement_camera": ("reset", "retune"),
}


def changes_of(recorded: Recording) -> list[Change]:
    """Return the changes that users made during a recorded run."""
    found = []
    for entry in recorded.metadata.get("changes", ()):
        try:
            changed = {name: _value(value) for name, value in entry["parameters"].items()}
            after = entry.get("after", BEFORE)
            found.append(Change(int(entry["sample"]), entry["node"], entry["action"], changed, after))
            if after not in STEPS or entry["action"] not in LOGGED.get(entry["node"], ()):
                raise ValueError(entry)
        except (AttributeError, KeyError, TypeError, ValueError):
            raise RecordingError(f"changes: {entry!r} is not an entry of a change log") from None
    return found


def _value(value):
    return tuple(value) if isinstance(value, list) else value


def answers_of(recorded: Recording) -> dict[str, np.ndarray]:
    """Return what the device of an axis answered in each sample of a recorded run."""
    nothing = {"measured": 0.0, "tripped": 0.0, "force": np.nan}
    absent = {name: np.full(len(recorded), value) for name, value in nothing.items()}
    absent["plant_voltage"] = recorded.signals["voltage"]
    return {name: recorded.signals.get(name, values) for name, values in absent.items()}


def differences(recorded: Recording, parameters: AxisParameters) -> dict[str, int]:
    """Compare a recorded run, in lockstep or fused, with its offline twin, bit for bit.

    Only the measurements of a device, and whether it could be made safe after a failure, are taken from the recording.
    Everything else is computed again; in an offline run this includes the simulated device.
    """
    given: dict[str, Any] = requests_per_sample(recorded) | {"skipped": recorded.signals.get("skipped")}
    given["pulses"] = recorded.signals.get("trigger_in")
    driven = bool(parameters.plant_simulator.driver) and not recorded.is_simulated
    if driven:
        given["answers"] = answers_of(recorded)
    twin = simulate(parameters, setpoints=recorded.signals["setpoint"], changes=changes_of(recorded), **given)
    # a device's true displacement is unknown
    unknown = {"displacement"} if driven else set()
    if parameters.displacement_camera is not None:
        unknown = {"measured"}  # the recorded signal is the controller's input, not the plant's output
    return unequal(recorded, twin, unknown)


def unequal(recorded: Recording, twin: Recording, unknown: Collection[str] = ()) -> dict[str, int]:
    """Return the number of samples that differ from the twin for each differing signal that is not in ``unknown``."""
    columns = {"time": (recorded.time, twin.time)}
    known = {name: values for name, values in recorded.signals.items() if name in twin and name not in unknown}
    columns |= {name: (values, twin.signals[name]) for name, values in known.items()}
    found = {}
    for name, (ours, theirs) in columns.items():
        count = int(np.count_nonzero(np.asarray(ours).view(np.int64) != np.asarray(theirs).view(np.int64)))
        if count:
            found[name] = count
    return found


#: Mode columns of a recording, and the part that each describes.
PARTS = {
    "source_mode": "source",
    "controller_mode": "controller",
    "compensator_mode": "compensator",
    "plant_mode": "plant",
}
#: Maximum number of lines per part; a random fault causes thousands of short intervals.
MOST_LINES = 8


def mode_lines(recording: Recording) -> list[str]:
    """Return a line for each interval in which a part was not in its normal mode."""
    lines = []
    for column, part in PARTS.items():
        if column not in recording:
            continue
        modes = recording[column]
        cuts = np.flatnonzero(np.diff(modes) != 0.0) + 1
        stretches = [s for s in np.split(np.arange(len(modes)), cuts) if len(s) and modes[s[0]] != RUNNING]
        for stretch in stretches[:MOST_LINES]:
            first, last = recording.time[stretch[0]], recording.time[stretch[-1]]
            name = MODE_NAMES[int(modes[stretch[0]])]
            lines.append(f"{part}: {name} from {first:.6g} to {last:.6g} s ({len(stretch)} samples)")
        if len(stretches) > MOST_LINES:
            counted = int(np.sum(modes != RUNNING))
            lines.append(f"{part}: … {len(stretches)} such intervals in all, {counted} samples")
    return lines or ["every part stayed in its normal mode"]
