# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Offline runs of a stage: recordings, displacements between their samples, and coupling errors between the axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hysteresis_ros.configuration import STAGE, Configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.axis import Change
from hysteresis_ros.loop.device import fused_plant_of
from hysteresis_ros.loop.simulation import answers_of, changes_of, unequal
from hysteresis_ros.loop.stage import Stage
from hysteresis_ros.loop.stage_parameters import HAMMERSTEIN, StageParameters
from hysteresis_ros.loop.stage_response import check_scan
from hysteresis_ros.models.linear import StateSpace
from hysteresis_ros.recordings.dataset import SIMULATED, Recording, note_output, output_tolerance

#: Number of instants within each sample at which displacements are computed.
INSTANTS = 5
#: A structure is integrated between samples only if the condition number of its eigenvectors is below this.
WORST_CONDITION = 1e10


def simulate_stage(
    parameters: StageParameters,
    *,
    duration: float | None = None,
    setpoints: Mapping[str, ArrayLike] | None = None,
    changes: Mapping[str, Sequence[Change]] | None = None,
    skipped: np.ndarray | None = None,
    pulses: Mapping[str, np.ndarray] | None = None,
    answers: Mapping[str, Mapping[str, np.ndarray]] | None = None,
) -> Recording:
    """Run a stage offline from rest, for ``duration`` [s] and with ``setpoints`` [m] by the names of its axes.

    Axes without setpoints keep their configured setpoint. ``answers`` are the answers of each axis' device in the
    recorded run; without answers all plants are simulated, even those with a driver. The signals of the recording are
    ``x/displacement`` …; :meth:`.Recording.axis` returns the signals of one axis.
    """
    if duration is not None:
        parameters = parameters.with_duration(duration)
    stage = repeated_stage(parameters) if answers else Stage(parameters)
    given = {parameters.names[parameters.place(name)]: values for name, values in (setpoints or {}).items()}
    lists = {name: np.atleast_1d(np.asarray(values, dtype=float)) for name, values in given.items()}
    if duration is not None:
        samples = parameters.axes[0].plant_simulator.samples
    else:
        samples = max((len(values) for values in lists.values()), default=0) or stage.default_samples()
    if samples < 1:
        raise ConfigurationError("the run has no end (samples: 0, endless waveforms): give --duration S")
    padded = {
        name: np.concatenate([values[:samples], np.full(max(samples - len(values), 0), values[-1])])
        for name, values in lists.items()
    }
    found = stage.run(stage.default_setpoints(samples) | padded, changes, skipped, pulses, answers)
    axes: dict[str, Recording] = {}
    for name, axis in zip(parameters.names, parameters.axes, strict=True):
        signals = found[name]
        nodes = (axis.plant_simulator, axis.hysteresis_compensator)
        tolerance = output_tolerance(*(node.to_mapping() for node in nodes))
        note_output(signals, signals["plant_voltage"], signals["plant_mode"], tolerance)
        axes[name] = Recording(signals.pop("time"), signals)
    metadata = {
        "configuration": parameters.configuration_text(),
        "namespace": parameters.namespace,
        "source": SIMULATED,
        "stage": f"{parameters.namespace}/{STAGE}",
    }
    return Recording.of_axes(axes, metadata)


def repeated_stage(parameters: StageParameters) -> Stage:
    """Return a stage that repeats its devices' answers; the recorded measurements are already degrees of freedom."""
    direct = replace(parameters, stage=replace(parameters.stage, sensor_matrix=()))
    ranges = zip(parameters.axes, parameters.travel(), strict=True)
    return Stage(direct, [fused_plant_of(axis.plant_simulator, False, travel) for axis, travel in ranges])


def stage_differences(recorded: Recording, parameters: StageParameters) -> dict[str, int]:
    """Compare a recorded run of a stage, in lockstep or fused, with its offline twin, bit for bit.

    See :func:`differences`.
    """
    axes = {name: recorded.axis(name) for name in parameters.names}
    driven = parameters.is_driven and not recorded.is_simulated
    twin = simulate_stage(
        parameters,
        answers={name: answers_of(one) for name, one in axes.items()} if driven else None,
        setpoints={name: one["setpoint"] for name, one in axes.items()},
        changes={name: changes_of(one) for name, one in axes.items()},
        skipped=axes[parameters.names[0]].signals.get("skipped"),
        pulses={name: one["trigger_in"] for name, one in axes.items() if one.has("trigger_in")},
    )
    # the true displacement of a device is unknown
    return unequal(recorded, twin, {f"{name}/displacement" for name in axes} if driven else ())


def with_scan(configuration: Configuration, kind: str, values: Sequence[str]) -> Configuration:
    """Return the configuration of a stage that follows a scan; ``values`` are the scan's parameters, ``NAME=VALUE``."""
    if configuration.stage is None:
        raise ConfigurationError(
            f"{configuration.source}: a scan moves several axes, and this file has no section '/{STAGE}' that couples "
            "them: choose a stage such as xy_scanner, or --reference for a single axis"
        )
    entry = f"{configuration.stage}/{STAGE}", {"scan.kind": kind, "scan.values": list(values)}
    return replace(configuration, entries=(*configuration.entries, entry))


def displacements_between(
    parameters: StageParameters, recording: Recording, stage: Stage | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return instants [s], shape (M,), at and between the samples of a run, and degrees of freedom [m], shape (n, M).

    The run starts from rest, with the simulated stage of the recording or with ``stage``, another stage at rest.
    Between samples the structure is integrated with held inputs, so the result equals the recording at the samples. If
    the model has no continuous equivalent, the samples are joined by straight lines; for hysteresis inside the
    structure, only the samples are known.
    """
    names, step = parameters.names, 1.0 / parameters.sample_rate
    sampled = np.array([recording[f"{name}/displacement"] for name in names])
    if parameters.stage.type != HAMMERSTEIN:
        return recording.time, sampled
    stage = stage or Stage(parameters)
    drives = np.empty((len(names), len(recording)))
    rest = np.array([plant.resting_drive for plant in stage.plants])
    for i, (name, plant) in enumerate(zip(names, stage.plants, strict=True)):
        one = plant.actuator
        crept = one.creep.simulate(one.hysteresis.simulate(recording[f"{name}/plant_voltage"]))
        drives[i] = one.dynamics.simulate(crept)
    places = np.arange(1, INSTANTS + 1) / INSTANTS
    found = continued(parameters.stage.structure.linear, rest, drives, places)
    if found is None:
        ends = np.append(sampled[:, 1:], sampled[:, -1:], axis=1)
        between = sampled[:, :, None] + (ends - sampled)[:, :, None] * places
    else:
        preloads = np.array([axis.plant_simulator.preload.offset for axis in parameters.axes])
        between = np.tensordot(parameters.stage.matrix("sensor_matrix"), found + preloads[:, None, None], 1)
    # the interval after the last sample is not part of the recording
    time = (recording.time[:-1, None] + places * step).ravel()
    between = between[:, :-1].reshape(len(names), -1)
    return np.append(recording.time[0], time), np.hstack([sampled[:, :1], between])


def continued(model: StateSpace, rest, inputs, places) -> np.ndarray | None:
    """Return the outputs at fractions of each sample with held inputs, shape (q, N, parts).

    The result is None if the model has no continuous equivalent.
    """
    import scipy.signal

    poles, vectors = (found.astype(complex) for found in np.linalg.eig(model.A))
    if not np.all((poles.imag != 0.0) | (poles.real > 0.0)) or np.linalg.cond(vectors) >= WORST_CONDITION:
        return None
    unit = np.linalg.solve(vectors, np.linalg.solve(np.eye(model.order) - model.A, model.B))
    driven = unit @ inputs
    states = np.empty(driven.shape, dtype=complex)
    for i, (pole, first) in enumerate(zip(poles, unit @ rest, strict=True)):
        after = scipy.signal.lfilter([1.0], [1.0, -pole], (1.0 - pole) * driven[i], zi=[pole * first])[0]
        states[i, 0], states[i, 1:] = first, after[:-1]
    out, through = model.C @ vectors, model.D @ inputs
    found = np.empty((len(model.C), inputs.shape[1], len(places)))
    for j, place in enumerate(places):
        left = poles[:, None] ** place
        found[:, :, j] = (out @ (left * states + (1.0 - left) * driven)).real + through
    return found


def chosen_stage(
    configuration: Configuration, faults: tuple[str, ...], namespace: str | None, asked: bool = False
) -> StageParameters:
    """Return the stage of a configuration, with faults in the axis that ``namespace`` names.

    ``asked``: the command also gives this axis a reference or triggers, so ``namespace`` is allowed without faults.
    """
    parameters = StageParameters.from_configuration(configuration)
    check_scan(parameters)
    if faults and namespace is None:
        raise ConfigurationError(f"a fault of a stage needs the name of its axis, one of {', '.join(parameters.names)}")
    if namespace is not None:
        parameters.place(namespace)  # refuses an unknown axis, whose reference or triggers would be ignored
    if namespace is not None and not faults and not asked:
        raise ConfigurationError(
            f"the axes of a stage ({', '.join(parameters.names)}) run together: --namespace only selects the "
            "axis of --fault, --reference and --trigger"
        )
    return parameters.with_faults(str(namespace), faults) if faults else parameters


@dataclass(frozen=True)
class CouplingError:
    """Error of an axis that holds its setpoint while another axis scans."""

    scanning: str  #: Name of the axis that follows its waveform.
    held: str  #: Name of the axis that holds its setpoint.
    rms: float  #: RMS of the motion that the scan causes in the held axis [m].
    peak: float  #: Largest motion that the scan causes in the held axis [m].
    scanned: float  #: Scanned displacement, peak to peak [m].

    @property
    def part(self) -> float:
        """Largest motion as a fraction of the scanned displacement, peak to peak; infinite if nothing moved."""
        return self.peak / self.scanned if self.scanned else math.inf


def coupling_errors(parameters: StageParameters, duration: float | None = None) -> list[CouplingError]:
    """Return how far a scan of each axis moves the other axes, in runs of ``duration`` [s] or as long as the waveforms.

    Every axis with a waveform scans in a run of its own while the other axes hold their setpoints. The true
    displacements of another run, in which all axes hold, are subtracted; so sensor noise, creep and approach to the
    setpoint, which are the same in both runs, cancel. The result is empty for a single axis, or if no axis has a
    waveform.
    """
    scanning = [name for name in parameters.names if parameters.waveform(name) != "hold"]
    found: list[CouplingError] = []
    if len(parameters.names) < 2 or not scanning:
        return found
    if duration is None:
        # the longest run of all axes, because the waveform of a single axis may be endless
        duration = Stage(parameters).default_samples() / parameters.sample_rate
    still = simulate_stage(parameters.scanning([]), duration=duration)
    for name in scanning:
        run = simulate_stage(parameters.scanning([name]), duration=duration)
        moved = {other: run[f"{other}/displacement"] - still[f"{other}/displacement"] for other in parameters.names}
        for held in parameters.names:
            if held != name:
                size = np.abs(moved[held])
                rms = float(np.sqrt(np.mean(size**2)))
                found.append(CouplingError(name, held, rms, float(np.max(size)), float(np.ptp(moved[name]))))
    return found
