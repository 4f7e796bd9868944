# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A whole offline run as a recording: what ``hysteresis simulate`` writes and what ``--verify`` compares with."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hysteresis_ros.errors import ConfigurationError, RecordingError
from hysteresis_ros.loop.axis import STEPS, Axis, Change
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.loop.compiled_plant import fused_plant_of
from hysteresis_ros.loop.tick import BEFORE
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.output import note_output, output_tolerance
from hysteresis_ros.recordings.replay import requests_per_sample
from hysteresis_ros.simulation.drift import drifting


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
    answers: dict | None = None,
    describe: bool = True,
    finished: Callable[[Axis], None] | None = None,
) -> Recording:
    """Run an axis offline from rest.

    Parameters
    ----------
    parameters : AxisParameters
        The axis.
    duration : float, optional
        Length [s]; by default that of ``setpoints``, the parameter ``samples`` or the waveform.
    setpoints : array_like, shape (N,), optional
        Setpoint in force at each sample [m]; the last one holds. ``initial_setpoint`` by default.
    requests, speeds : array_like, shape (N,), optional
        What was asked of an inchworm at each sample, see :meth:`Axis.run`; nothing after the last one.
    changes : sequence of Change, optional
        What changes while the axis runs.
    drift : (float, float), optional
        By which part gain and opening of the plant's hysteresis change over the run besides.
    skipped : array_like, shape (N,), optional
        1 at each sample whose time was missed, see :meth:`Axis.run`; none after the last one.
    answers : dict of str to array_like, shape (N,), optional
        What a device measured in the simulated plant's place, see :meth:`Axis.run`; nothing after the last sample.
    describe : bool
        Put the text of the configuration into the metadata; writing it takes longer than a short run.
    finished : callable, optional
        Called with the axis after its last sample.

    Raises
    ------
    ConfigurationError
        Neither the configuration nor the arguments say how long the run is.
    ParameterError
        The plant cannot drift so.
    """
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
    given = {name: _padded(values, samples, rest) for name, (values, rest) in asked.items() if values is not None}
    if answers:
        given["answers"] = {name: _padded(values, samples, np.nan) for name, values in answers.items()}
    if any(drift):
        changes = [*changes, *drifting(parameters, samples, *drift)]
    signals = axis.run(setpoints, changes=changes, **given)
    if finished is not None:
        finished(axis)
    nodes = (parameters.plant_simulator, parameters.hysteresis_compensator)
    tolerance = output_tolerance(*(node.to_mapping() for node in nodes))
    note_output(signals, signals["plant_voltage"], signals["plant_mode"], tolerance)
    metadata = {
        "configuration": parameters.configuration_text() if describe else "",
        "namespace": parameters.namespace,
        "source": "offline simulation",
        "joint": parameters.plant_simulator.joint,
    }
    return Recording(signals.pop("time"), signals, {}, metadata)


def _padded(values, samples: int, rest: float) -> np.ndarray:
    """Return the first values, followed by ``rest`` up to the number of samples."""
    values = np.asarray(values, dtype=float)[:samples]
    return np.concatenate([values, np.full(samples - len(values), rest)])


#: What the log of a run may say of each node.
LOGGED = {
    "plant_simulator": ("start", "halt", "reset", "retune", "home"),
    "reference_generator": ("start", "stop", "hold", "follow", "begin_at", "reset", "retune"),
    "inchworm_sequencer": ("reset", "retune"),
    "motion_controller": ("start", "stop", "reset", "retune", "learn", "freeze", "forget"),
    "hysteresis_compensator": ("start", "stop", "reset", "retune", "freeze", "resume", "forget"),
    "displacement_camera": ("reset", "retune"),
}


def changes_of(recorded: Recording) -> list[Change]:
    """Return what people changed while a recorded run was made.

    Parameters
    ----------
    recorded : Recording
        Of any axis.

    Raises
    ------
    RecordingError
        An entry of the log is not one of a change.
    """
    found = []
    for entry in recorded.metadata.get("changes", ()):
        try:
            changed = {name: _value(value) for name, value in entry["parameters"].items()}
            after = entry.get("after", BEFORE)
            found.append(Change(int(entry["sample"]), entry["node"], entry["action"], changed, after))
            if after not in STEPS or entry["action"] not in LOGGED.get(entry["node"], ()):
                raise ValueError(entry)
        except (AttributeError, KeyError, TypeError, ValueError):
            raise RecordingError(f"changes: {entry!r} is no entry of a log of changes") from None
    return found


def _value(value):
    return tuple(value) if isinstance(value, list) else value


def differences(recorded: Recording, parameters: AxisParameters) -> dict[str, int]:
    """Compare a recorded run, in lockstep or fused, with its offline twin, bit for bit.

    What a device measured is not computed again, but everything that followed from it.

    Returns
    -------
    dict of str to int
        Number of differing samples of each signal that differs; empty when all agree.
    """
    given = requests_per_sample(recorded) | {"skipped": recorded.signals.get("skipped")}
    if parameters.plant_simulator.driver:
        nothing = {"measured": 0.0, "tripped": 0.0, "force": np.nan}
        absent = {name: np.full(len(recorded), value) for name, value in nothing.items()}
        given["answers"] = {name: recorded.signals.get(name, values) for name, values in absent.items()}
    twin = simulate(parameters, setpoints=recorded.signals["setpoint"], changes=changes_of(recorded), **given)
    columns = {"time": (recorded.time, twin.time)}
    # nobody knows where a device really is
    unknown = {"displacement"} if parameters.plant_simulator.driver else set()
    if parameters.displacement_camera is not None:
        unknown = {"measured"}  # the plant's; what the controller took stands in for it in a recording
    known = {name: values for name, values in recorded.signals.items() if name in twin and name not in unknown}
    columns |= {name: (values, twin.signals[name]) for name, values in known.items()}
    found = {}
    for name, (ours, theirs) in columns.items():
        count = int(np.count_nonzero(np.asarray(ours).view(np.int64) != np.asarray(theirs).view(np.int64)))
        if count:
            found[name] = count
    return found
