# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Offline runs of a stage: a recording of all axes, and the error that scans of one axis cause in the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hysteresis_ros.configuration import STAGE, Configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.axis import Change
from hysteresis_ros.loop.stage import Stage
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.recordings.dataset import Recording, note_output, output_tolerance


def simulate_stage(
    parameters: StageParameters,
    *,
    duration: float | None = None,
    setpoints: Mapping[str, ArrayLike] | None = None,
    changes: Mapping[str, Sequence[Change]] | None = None,
) -> Recording:
    """Run a stage offline from rest, for ``duration`` [s] and with ``setpoints`` [m] by the names of its axes.

    Axes without setpoints have their configured one. The signals of the recording are ``x/displacement`` …;
    :meth:`.Recording.axis` gives those of one axis.
    """
    if duration is not None:
        parameters = parameters.with_duration(duration)
    stage = Stage(parameters)
    given = {parameters.names[parameters.place(name)]: values for name, values in (setpoints or {}).items()}
    lists = {name: np.atleast_1d(np.asarray(values, dtype=float)) for name, values in given.items()}
    if duration is not None:
        samples = parameters.axes[0].plant_simulator.samples
    else:
        samples = max((len(values) for values in lists.values()), default=0) or stage.default_samples()
    if samples < 1:
        raise ConfigurationError("the stage has no end (samples: 0, endless waveforms): give --duration S")
    padded = {
        name: np.concatenate([values[:samples], np.full(max(samples - len(values), 0), values[-1])])
        for name, values in lists.items()
    }
    found = stage.run(stage.default_setpoints(samples) | padded, changes)
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
        "source": "offline simulation",
        "stage": f"{parameters.namespace}/{STAGE}",
    }
    return Recording.of_axes(axes, metadata)


def chosen_stage(configuration: Configuration, faults: tuple[str, ...], namespace: str | None) -> StageParameters:
    """Return the stage of a configuration, with faults in the axis that ``namespace`` names."""
    parameters = StageParameters.from_configuration(configuration)
    if faults and namespace is None:
        raise ConfigurationError(f"faults of a stage need an axis: name one of {', '.join(parameters.names)}")
    if namespace is not None and not faults:
        raise ConfigurationError(
            f"the axes of a stage ({', '.join(parameters.names)}) run together: an axis is named for its faults only"
        )
    return parameters.with_faults(str(namespace), faults) if faults else parameters


@dataclass(frozen=True)
class CouplingError:
    """Error of an axis that holds its place while another one scans."""

    scanning: str  #: Name of the axis that follows its waveform.
    held: str  #: Name of the axis that holds its setpoint.
    rms: float  #: RMS of the motion that the scan causes in the held axis [m].
    peak: float  #: Largest such motion [m].
    scanned: float  #: Peak to peak of the scanned displacement [m].

    @property
    def part(self) -> float:
        """Largest motion as a part of the scanned displacement, peak to peak."""
        return self.peak / self.scanned


def coupling_errors(parameters: StageParameters, duration: float | None = None) -> list[CouplingError]:
    """Return how much a scan of each axis moves the others, in runs of ``duration`` [s] or of the waveforms' length.

    Every axis that has a waveform scans in a run of its own while the others hold their setpoints, and what the others
    do in a run in which all hold is subtracted. Both runs have the same noise of the sensors, which therefore does not
    count; nor do creep and the approach of the setpoint. The true displacements are compared. There are no errors
    where no axis has a waveform, or there is one axis.
    """
    scanning = [name for name in parameters.names if parameters.waveform(name) != "hold"]
    found: list[CouplingError] = []
    if len(parameters.names) < 2 or not scanning:
        return found
    if duration is None:
        # that of all axes together, because the waveform of one alone may be endless
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
